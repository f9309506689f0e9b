"""The last-line filter: what it lets pass, what it cuts, and whether its promise holds in the planar world."""

import dataclasses

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from jaxlocomanip.outcome import clearances
from jaxlocomanip.planner import keeping, safety
from jaxlocomanip.planner.config import PlannerConfig
from jaxlocomanip.planner.estimation import ObjectEstimate, ObstacleEstimate
from jaxlocomanip.planner.room import bodies_of, standing_room
from jaxlocomanip.planner.shapes import shapes_of
from jaxlocomanip.planner.situation import Situation
from jaxlocomanip.worlds.interface import Push
from jaxlocomanip.worlds.planar import PlanarWorld


def pushing(force, rate):
    return Push(force, rate, jnp.zeros(3), jnp.zeros((), bool))


CONFIG, WORLD = PlannerConfig(), PlanarWorld()
TICK = CONFIG.horizon.tick
DISC = 0.25 * np.sqrt(2.0)  # radius of the disc that covers the object
SIDE = 0.25  # distance of its faces from its middle


@pytest.fixture
def scene(make_scenario):
    """A function: scenario with a long wall whose face is at x = `face`, on a slippery floor."""

    def make(face=2.0, friction=0.15, velocity=(0.0, 0.0)):
        wall = {"shape": "box", "size": [1.0, 8.0], "position": [face + 0.5, 3.0], "velocity": list(velocity)}
        return make_scenario(truth={"friction": friction}, goal={"pose": [-3.0, 3.0, 0.0]}, obstacles=[wall])

    return make


@jax.jit
def filtered(scenario, state, force, rate, config=CONFIG, held=True, acting=None, twist=None, most=70.0):
    """The filter with a perfect estimate (but for `twist`), believing in more friction than there is."""
    zero = jnp.zeros(3)
    obstacles = scenario.obstacles
    seen = ObstacleEstimate(obstacles.position, obstacles.velocity, jnp.zeros((obstacles.position.shape[0], 3)))
    body = dataclasses.replace(scenario.object.body, friction_force=jnp.asarray(30.0), friction_moment=jnp.asarray(6.0))
    estimate = ObjectEstimate(state.pose, state.twist if twist is None else twist, zero)
    proven = safety.least_friction(body, config)
    speed = jnp.max(jnp.abs(state.twist))
    shapes = shapes_of(scenario)
    gaps = keeping.gaps_of(estimate, state.offset, seen, shapes, config)
    room = standing_room(gaps, bodies_of(shapes, config))
    keep = keeping.room_to_keep(keeping.start(gaps), gaps, shapes.obstacle_dynamic, config.safety.margin)
    acting = jnp.zeros_like(force) if acting is None else acting
    situation = Situation(
        estimate, body, seen, state.offset, room, keep, acting, proven, speed < 0.02, speed, jnp.asarray(held)
    )
    return safety.safety_filter(force, rate, most * jnp.ones_like(force), situation, shapes, config)


def at(scenario, pose, twist=(0.0, 0.0, 0.0)):
    start = WORLD.start(scenario)
    pose, twist = jnp.asarray(pose, jnp.float32), jnp.asarray(twist, jnp.float32)
    return dataclasses.replace(start, pose=pose, twist=twist, offset=jnp.zeros_like(start.offset))


@jax.jit
def clearance(scenario, state):
    """Least signed distance of the true shapes of object and robots to the obstacles."""
    least = clearances(scenario, WORLD.view(state, scenario), scenario.obstacles.position)
    return jnp.minimum(least.object, least.robots)


def test_with_clear_space_the_input_passes_unchanged(scene):
    scenario, force, rate = scene(face=3.0), jnp.array([40.0, 20.0]), jnp.array([0.1, -0.05])
    sent = filtered(scenario, at(scenario, (0.0, 0.0, 0.0), (0.3, 0.1, 0.0)), force, rate)
    assert sent.choice == 0
    assert (sent.force == force).all() and (sent.offset_rate == rate).all()
    assert sent.room > 0.5


@pytest.mark.parametrize("gap", [0.002, 0.01])
def test_a_push_at_a_near_wall_is_cut(scene, gap):
    scenario = scene(face=DISC + CONFIG.safety.margin + gap)
    force = jnp.array([45.0, 0.0])
    sent = filtered(scenario, at(scenario, (0.0, 0.0, 0.0)), force, jnp.zeros(2))
    assert sent.choice > 0
    assert sent.force[0] < force[0]
    assert sent.room >= 0.0
    away = filtered(scenario, at(scenario, (-1.0, 0.0, 0.0)), force, jnp.zeros(2))
    assert away.choice == 0


def test_within_the_margin_a_team_at_rest_may_leave(scene):
    """A wall 4 mm from the robot behind the object: away from it any push passes, along it none does."""
    scenario = scene(face=4.0)
    guess = 6.0
    behind = at(scenario, (guess - clearance(scenario, at(scenario, (guess, 3.0, 0.0))) + 0.004, 3.0, 0.0))
    assert 0.0 < clearance(scenario, behind) < 0.005
    assert filtered(scenario, behind, jnp.array([30.0, 0.0]), jnp.zeros(2)).choice == 0
    assert filtered(scenario, behind, jnp.array([0.0, 30.0]), jnp.zeros(2)).choice > 0


def test_within_the_margin_nothing_comes_closer(scene):
    scenario = scene(face=SIDE + 0.004)
    near = at(scenario, (0.0, 0.0, 0.0))
    assert 0.0 < clearance(scenario, near) < CONFIG.safety.margin
    sent = filtered(scenario, near, jnp.array([45.0, 0.0]), jnp.zeros(2))
    assert sent.choice > 0 and sent.force[0] < 20.0


def test_what_moved_nothing_goes_on_until_another_push_is_safe(scene):
    """Dropped, a push near an obstacle would have to grow from nothing after every noisy plan."""
    scenario = scene(face=SIDE + 0.004)
    acting = jnp.array([12.0, 3.0])
    sent = filtered(
        scenario, at(scenario, (0.0, 0.0, 0.0)), jnp.array([60.0, 0.0]), jnp.zeros(2), acting=acting, most=12.0
    )
    assert sent.choice > 0
    assert (sent.force <= jnp.maximum(acting, 12.0)).all() and sent.force[0] > 0.9 * acting[0]


def test_velocity_of_an_object_that_lies_still_is_noise(scene):
    """Believed, a decimetre a second towards a wall that is near would keep the team for ever."""
    scenario = scene(face=SIDE + CONFIG.safety.margin + 0.001)
    here, force, noise = at(scenario, (0.0, 0.0, 0.0)), jnp.zeros(2), jnp.array([0.1, 0.0, 0.0])
    assert filtered(scenario, here, force, jnp.zeros(2), twist=noise).choice == 0
    moving = at(scenario, (0.0, 0.0, 0.0), (0.1, 0.0, 0.0))
    assert filtered(scenario, moving, force, jnp.zeros(2)).room < 0.0


def test_a_push_along_the_wall_passes(scene):
    scenario = scene(face=DISC + CONFIG.safety.margin + 0.01)
    sent = filtered(scenario, at(scenario, (0.0, 0.0, 0.0)), jnp.array([0.0, 40.0]), jnp.zeros(2))
    assert sent.choice == 0


def test_switched_off_it_does_nothing(scene):
    scenario = scene(face=DISC + 0.01)
    off = dataclasses.replace(CONFIG, safety=dataclasses.replace(CONFIG.safety, enabled=0.0))
    sent = filtered(scenario, at(scenario, (0.0, 0.0, 0.0)), jnp.array([45.0, 0.0]), jnp.zeros(2), off)
    assert sent.choice == 0 and sent.force[0] == 45.0


def test_without_a_safe_input_the_team_lets_go(scene):
    scenario = scene(face=DISC + CONFIG.safety.margin + 0.005)
    sent = filtered(scenario, at(scenario, (0.0, 0.0, 0.0), (0.8, 0.0, 0.0)), jnp.array([45.0, 30.0]), jnp.zeros(2))
    assert sent.room < 0.0
    assert sent.choice > 0 and sent.force[0] == 0.0


def test_an_approaching_obstacle_is_seen_coming(scene):
    scenario = scene(face=0.25 + 0.8, velocity=(-0.6, 0.0))
    still = scene(face=0.25 + 0.8)
    force = jnp.array([45.0, 0.0])
    assert filtered(still, at(still, (0.0, 0.0, 0.0)), force, jnp.zeros(2)).choice == 0
    assert filtered(scenario, at(scenario, (0.0, 0.0, 0.0)), force, jnp.zeros(2)).choice > 0


def test_a_team_on_its_way_past_an_obstacle_need_not_survive_a_stop(scene):
    scenario = scene(face=2.0, velocity=(-0.6, 0.0))
    here, force = at(scenario, (2.0 - 0.25 - 0.8, 0.0, 0.0)), jnp.array([0.0, 45.0])
    assert filtered(scenario, here, force, jnp.zeros(2), held=True).choice > 0
    assert filtered(scenario, here, force, jnp.zeros(2), held=False).choice == 0


@pytest.mark.parametrize("gap", [-0.1, -0.01, 0.01])
def test_what_cannot_be_avoided_finds_the_team_at_rest(scene, gap):
    """Whoever moves during a contact has moved into the obstacle."""
    scenario = scene(face=2.0, velocity=(-0.5, 0.0))
    here, force, rate = at(scenario, (2.0 - 0.25 - gap, 0.0, 0.0)), jnp.array([0.0, 45.0]), jnp.array([0.4, 0.4])
    for held in (False, True):
        sent = filtered(scenario, here, force, rate, held=held)
        assert (sent.force == 0.0).all() and (sent.offset_rate == 0.0).all()


def before_a_wall(seed, count, gap, speed):
    """Random poses [n, 3], twists [n, 3] and forces [n, 2] of an object at most `gap` m before a wall at x = 2."""
    rng = np.random.default_rng(seed)
    x = 2.0 - DISC - rng.uniform(0.0, gap, count)
    poses = np.stack([x, np.zeros(count), rng.uniform(-0.6, 0.6, count)], axis=1)
    twists = rng.uniform(-speed, speed, (count, 3)) * [1.0, 0.5, 1.5]
    return poses, twists, rng.uniform(0.0, 45.0, (count, 2))


@jax.jit
def let_go(scenario, state, sent):
    """Least clearance over one tick of the filtered input and then two seconds of nothing, and whether it rests."""

    def tick(state, force):
        after = WORLD.step(state, scenario, pushing(force, jnp.zeros_like(force)), 0.0, TICK)
        return after, clearance(scenario, after)

    pushes = jnp.zeros((100, 2)).at[0].set(sent.force)
    last, gaps = jax.lax.scan(tick, state, pushes)
    return jnp.minimum(jnp.min(gaps), clearance(scenario, state)), jnp.all(last.twist == 0.0)


@jax.jit
def promises(scenario, poses, twists, forces):
    """For random states [n] and inputs: what the filter sent, clearance at the start, and what came of it."""

    def one(pose, twist, force):
        state = at(scenario, pose, twist)
        sent = filtered(scenario, state, force, jnp.zeros(2))
        return sent, clearance(scenario, state), *let_go(scenario, state, sent)

    return jax.vmap(one)(poses, twists, forces)


def test_the_braking_promise_holds_in_the_planar_world(scene):
    """Whatever the filter calls safe ends at rest without contact, on a floor of friction 0.15."""
    poses, twists, forces = before_a_wall(seed=0, count=3000, gap=0.5, speed=1.0)
    twists[:, 0] = np.abs(twists[:, 0])
    sent, before, least, rests = promises(scene(face=2.0), *(jnp.asarray(v) for v in (poses, twists, forces)))
    promised = np.asarray((sent.room >= 0.0) & (before > 0.0))
    touched = promised & (np.asarray(least) <= 0.0)
    assert promised.sum() > 500 and (promised & (np.asarray(sent.choice) > 0)).sum() > 100
    assert np.asarray(rests).all()
    worst = np.argmin(np.where(touched, least, np.inf))
    assert not touched.any(), (touched.sum(), least[worst], poses[worst], twists[worst], sent.force[worst])


@jax.jit
def stops_before(scenario, poses, twists, forces, times):
    """For random states [n] and inputs: whether the filter let them pass, and the least clearance until rest."""

    def one(pose, twist, force):
        state = at(scenario, pose, twist)
        sent = filtered(scenario, state, force, jnp.zeros(2), held=False)

        def tick(state, given):
            force, time = given
            after = WORLD.step(state, scenario, pushing(force, jnp.zeros_like(force)), 0.0, TICK)
            least = clearances(scenario, WORLD.view(after, scenario), scenario.obstacles.at(time + TICK))
            least = jnp.minimum(least.object, least.robots)
            return after, jnp.where(jnp.any(after.twist != 0.0), least, jnp.inf)

        pushes = jnp.zeros((times.shape[0], 2)).at[0].set(sent.force)
        return sent, jnp.min(jax.lax.scan(tick, state, (pushes, times))[1])

    return jax.vmap(one)(poses, twists, forces)


def test_what_passes_stops_before_a_wall_that_comes_nearer(scene):
    """No contact while the object moves; what happens to a team at rest is not its doing."""
    poses, twists, forces = before_a_wall(seed=1, count=1000, gap=0.8, speed=0.8)
    scenario = scene(face=2.0, velocity=(-0.5, 0.0))
    times = jnp.arange(100) * TICK
    sent, least = stops_before(scenario, *(jnp.asarray(v) for v in (poses, twists, forces)), times)
    promised = np.asarray(sent.room >= 0.0)
    assert promised.sum() > 300 and (promised & (np.asarray(sent.choice) > 0)).sum() > 30
    assert (np.asarray(least)[promised] > 0.0).all()
    assert (np.asarray(least)[~promised] <= 0.0).any()


@jax.jit
def push_on(scenario, state, force):
    """Least clearance over four seconds of wanting to push on, filtered at every tick; final state."""

    def tick(state, _):
        sent = filtered(scenario, state, force, jnp.zeros(2))
        after = WORLD.step(state, scenario, pushing(sent.force, sent.offset_rate), 0.0, TICK)
        return after, clearance(scenario, after)

    last, gaps = jax.lax.scan(tick, state, None, length=200)
    return jnp.min(gaps), last


@pytest.mark.parametrize("pushes", [(48.0, 0.0), (48.0, 30.0), (30.0, 48.0), (25.0, 10.0)])
def test_pushing_on_towards_a_wall_never_touches_it(scene, pushes):
    scenario = scene(face=1.5)
    least, last = push_on(scenario, at(scenario, (0.0, 0.0, 0.0)), jnp.asarray(pushes, jnp.float32))
    assert least > 0.0
    assert last.pose[0] > 0.3  # it did get near
    assert last.twist[0] < 0.05


def test_friction_is_proven_by_rest_under_a_push_and_by_sliding(make_scenario):
    """And never believed to be more than what was seen."""
    scenario = make_scenario(truth={"friction": 0.4})
    body, shapes, zero = scenario.object.body, shapes_of(scenario), jnp.zeros(3)
    prove = jax.jit(safety.prove_friction)
    push, offset = jnp.array([20.0, 0.0]), jnp.zeros(2)
    least = safety.least_friction(body, CONFIG)

    def after(twist, force, friction):
        proven, estimate = least, ObjectEstimate(zero, jnp.asarray(twist), zero)
        adapted = dataclasses.replace(body, friction_force=jnp.asarray(friction))
        for _ in range(200):
            proven = prove(proven, estimate, force, offset, adapted, shapes, CONFIG)
        return float(proven)

    share = float(CONFIG.safety.belief)
    assert after([0.0, 0.0, 0.0], push, 80.0) == pytest.approx(share * 20.0, rel=0.1)
    assert after([0.0, 0.0, 0.0], 0.1 * push, 80.0) == pytest.approx(float(least))
    assert after([0.4, 0.0, 0.0], push, 30.0) == pytest.approx(share * 30.0, rel=0.01)
    assert after([0.4, 0.0, 0.0], push, 1.0) == pytest.approx(float(least))
