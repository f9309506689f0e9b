"""Physics in MJX: parity with MuJoCo C, batches of unlike objects in one compilation, and lanes that do not fit."""

import dataclasses

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from jaxlocomanip.checked import InputError
from jaxlocomanip.locomotion.robot import JointCommand

pytest.importorskip("mujoco.mjx")

from jaxlocomanip.worlds.physics_c import CPhysics  # noqa: E402
from jaxlocomanip.worlds.physics_mjx import MjxPhysics, load_model, stack_models  # noqa: E402
from jaxlocomanip.worlds.scene import build_scene  # noqa: E402

# The number of steps is traced, so that each of these is compiled once for all tests.
advance = jax.jit(MjxPhysics.advance)
observe = jax.jit(MjxPhysics.observe)
advance_lanes = jax.jit(jax.vmap(MjxPhysics.advance, in_axes=(0, 0, 0, None)))
observe_lanes = jax.jit(jax.vmap(MjxPhysics.observe))

HEXAGON = [[np.cos(a), np.sin(a)] for a in np.arange(6) * np.pi / 3]
OBJECTS = (
    {"size": [0.5, 0.5], "height": 0.5, "mass": 8.0, "friction": 0.4},
    {"size": [0.9, 0.4], "height": 0.35, "mass": 5.0, "friction": 0.25, "com": [0.03, -0.02]},
)


def hold(joint, kp=300.0, kd=8.0):
    """Springs and dampers that hold the joints where they are."""
    one = np.ones_like(joint)
    return JointCommand(joint, 0 * one, kp * one, kd * one, 0 * one)


def single(tree):
    """Arrays of JAX in single precision for arrays of NumPy."""
    return jax.tree.map(lambda leaf: jnp.asarray(leaf, None if leaf.dtype == bool else jnp.float32), tree)


def stacked(*trees):
    return jax.tree.map(lambda *leaves: jnp.stack(leaves), *trees)


def lane(tree, index):
    return jax.tree.map(lambda leaf: leaf[index], tree)


def pressing(scene):
    """In C: the first robot leans on the object, the others stand back; a state and the command that holds it."""
    physics = CPhysics(scene)
    state = physics.start()
    command = hold(physics.observe(state).robots.joint)
    state = physics.advance(state, command, 250)
    qpos, rotation = state.qpos.copy(), physics.observe(state).robots.rotation
    for i, at in enumerate(scene.tables.trunk_qpos):
        qpos[at : at + 2] += (0.03 if i == 0 else -0.05) * rotation[i, :2, 0]
    state = physics.advance(dataclasses.replace(state, qpos=qpos), command, 30)
    assert physics.observe(state).touching.tolist() == [True] + [False] * (len(qpos) // 19 - 1)
    return physics, state, command


@pytest.fixture(scope="module")
def scenes(make_scenario):
    """Two lanes that differ in size, mass, friction, centre of mass and start."""
    starts = ([0.0, 0.0, 0.0], [0.4, -0.3, 0.6])
    made = [make_scenario(object=o, start={"pose": s}) for o, s in zip(OBJECTS, starts, strict=True)]
    return [build_scene(scenario, standoff=0.0, scenery=False) for scenario in made]


@pytest.fixture(scope="module")
def lanes(scenes):
    return stack_models(scenes)


def assert_close(mine, theirs, position, velocity, force):
    """Observations of MJX and of C."""
    assert np.abs(mine.body_position - theirs.body_position).max() < position
    assert np.abs(mine.pose - theirs.pose).max() < position
    assert np.abs(mine.robots.joint - theirs.robots.joint).max() < 2 * position
    assert np.abs(mine.twist - theirs.twist).max() < velocity
    for name in ("velocity", "angular_velocity", "joint_rate"):
        assert np.abs(getattr(mine.robots, name) - getattr(theirs.robots, name)).max() < 10 * velocity, name
    assert np.abs(mine.foot_force - theirs.foot_force).max() < force
    assert np.abs(mine.push_force - theirs.push_force).max() < force
    assert (np.asarray(mine.touching) == theirs.touching).all()
    for name in ("rotation", "position"):
        assert np.abs(getattr(mine.robots, name) - getattr(theirs.robots, name)).max() < position, name
    assert np.abs(mine.body_quaternion - theirs.body_quaternion).max() < position
    assert abs(mine.tilt - theirs.tilt) < 10 * position and abs(mine.lift - theirs.lift) < position


@pytest.mark.parametrize("iterations", [(4, 8), (100, 50)], ids=["equal options", "converged"])
@pytest.mark.parametrize("index", [0, 1])
def test_follows_mujoco_c(scenes, lanes, index, iterations):
    """From one state with a pusher in contact, under one held command.

    With equal options a difference is an error of the port; with C's solver converged it would also show if the few
    iterations of the scene were too few.
    """
    physics, state, command = pressing(scenes[index])
    physics.model.opt.iterations, physics.model.opt.ls_iterations = iterations
    model = lane(lanes, index)
    for steps, position, velocity, force in ((1, 1e-5, 1e-4, 0.05), (10, 2e-5, 1e-4, 0.05), (100, 2e-4, 1e-3, 0.5)):
        mine = observe(model, advance(model, single(state), single(command), steps))
        theirs = physics.observe(physics.advance(state, command, steps))
        assert theirs.push_force[0] > 5.0
        assert_close(mine, theirs, position, velocity, force)
    physics.model.opt.iterations, physics.model.opt.ls_iterations = 4, 8


def test_a_lane_is_the_same_alone(scenes, lanes):
    started = [pressing(scene)[1:] for scene in scenes]
    states, commands = (stacked(*map(single, trees)) for trees in zip(*started, strict=True))
    together = observe_lanes(lanes, advance_lanes(lanes, states, commands, 50))
    for i, scene in enumerate(scenes):
        model = load_model(scene)
        alone = observe(model, advance(model, lane(states, i), lane(commands, i), 50))
        assert_close(alone, lane(together, i), 2e-5, 2e-4, 0.1)


def test_start_and_dtypes(scenes, lanes):
    states = jax.vmap(MjxPhysics.start)(lanes)
    for i, scene in enumerate(scenes):
        expected = CPhysics(scene).start()
        for mine, theirs in zip(jax.tree.leaves(lane(states, i)), jax.tree.leaves(expected), strict=True):
            assert mine.shape == theirs.shape and mine == pytest.approx(theirs, abs=1e-6)
    command = stacked(*[single(hold(CPhysics(s).observe(CPhysics(s).start()).robots.joint)) for s in scenes])
    after = advance_lanes(lanes, states, command, 2)
    for tree in (states, after, observe_lanes(lanes, after)):
        assert all(leaf.dtype in (jnp.float32, bool) for leaf in jax.tree.leaves(tree))
        assert all(np.isfinite(leaf).all() for leaf in jax.tree.leaves(tree))


def test_what_is_not_a_number_stays_in_its_lane(scenes, lanes):
    states = jax.vmap(MjxPhysics.start)(lanes)
    command = stacked(*[single(hold(CPhysics(s).observe(CPhysics(s).start()).robots.joint)) for s in scenes])
    bad = dataclasses.replace(command, torque=command.torque.at[1].set(jnp.nan))
    after = observe_lanes(lanes, advance_lanes(lanes, states, bad, 5))
    assert np.isfinite(after.robots.joint[0]).all() and np.isfinite(after.pose[0]).all()
    assert np.isnan(after.robots.joint[1]).any()


def test_other_values_compile_nothing_new(make_scenario, scenes, lanes):
    states = jax.vmap(MjxPhysics.start)(lanes)
    command = stacked(*[single(hold(CPhysics(s).observe(CPhysics(s).start()).robots.joint)) for s in scenes])
    advance_lanes(lanes, states, command, 2)
    compiled = advance_lanes._cache_size()
    boxes = (
        {"size": [1.1, 0.7], "mass": 20.0, "friction": 0.1, "com": [-0.1, 0.05]},
        {"size": [0.3, 0.6], "mass": 2.0},
    )
    others = [build_scene(make_scenario(object=b, truth={"friction": 0.6}), scenery=False) for b in boxes]
    models = stack_models(others)
    advance_lanes(models, jax.vmap(MjxPhysics.start)(models), command, 7)
    assert advance_lanes._cache_size() == compiled


def test_object_sticks_and_slides_as_its_friction_says(make_scenario):
    """On a floor tilted by gravity: mu m g = 31.4 N, one lane pulled with 30.5 N, the other with 32.5 N."""
    scenario = make_scenario(object=OBJECTS[0])
    scenes = [build_scene(scenario, scenery=False, standoff=2.0)] * 2
    models = stack_models(scenes)
    gravity = jnp.array([[0.2, -30.5 / 8.0, -9.81], [0.2, -32.5 / 8.0, -9.81]])
    models = dataclasses.replace(models, model=models.model.tree_replace({"opt.gravity": gravity}))
    states = jax.vmap(MjxPhysics.start)(models)
    command = stacked(*[single(hold(CPhysics(s).observe(CPhysics(s).start()).robots.joint)) for s in scenes])
    early = advance_lanes(models, states, command, 100)
    late = advance_lanes(models, early, command, 250)
    moved = np.asarray(late.qpos - early.qpos)[:, 1]
    assert abs(moved[0]) < 0.5 * 2e-3
    assert moved[1] < -0.5 * 30e-3


@pytest.mark.slow
def test_polygons_of_unlike_size_in_one_batch(make_scenario):
    """Hexagons are meshes, whose vertices MJX keeps in the model: each lane must collide with its own."""
    robots = [{"type": "go1", "face": 3}]
    shapes = [
        {"footprint": (r * np.array(HEXAGON)).tolist(), "mass": m, "friction": 0.3} for r, m in ((0.3, 4), (0.4, 9))
    ]
    scenes = [build_scene(make_scenario(object=s, robots=robots), scenery=False, standoff=0.0) for s in shapes]
    started = [pressing(scene) for scene in scenes]
    states, commands = (stacked(*map(single, trees)) for trees in zip(*[s[1:] for s in started], strict=True))
    models = stack_models(scenes)
    seen = observe_lanes(models, advance_lanes(models, states, commands, 50))
    for i, (physics, state, command) in enumerate(started):
        theirs = physics.observe(physics.advance(state, command, 50))
        assert theirs.push_force[0] > 5.0
        assert_close(lane(seen, i), theirs, 2e-4, 1e-3, 0.5)


def test_a_mixed_team_stacks_and_traces(make_scenario):
    robots = [{"type": t, "face": f} for t, f in (("aliengo", "-x"), ("a1", "-y"), ("go1", "+y"))]
    sizes = ([0.8, 0.9], [1.0, 1.2])
    scenes = [build_scene(make_scenario(object={"size": s, "mass": 5.0}, robots=robots), scenery=False) for s in sizes]
    models = stack_models(scenes)
    states = jax.vmap(MjxPhysics.start)(models)
    command = hold(jnp.zeros((2, 3, 4, 3)))
    after = jax.eval_shape(jax.vmap(lambda m, s, c: m.advance(s, c, 3)), models, states, command)
    assert jax.tree.map(jnp.shape, after) == jax.tree.map(jnp.shape, states)


@pytest.mark.parametrize(
    ("tables", "text"),
    [
        ({"robots": [{"type": "a1", "face": "-x"}, {"type": "aliengo", "face": "-y"}]}, "robots = ('a1', 'aliengo')"),
        ({"robots": [{"type": "aliengo", "face": "-x"}]}, "robots = ('aliengo',)"),
        (
            {"object": {"footprint": HEXAGON, "mass": 5.0}, "robots": [{"type": "aliengo", "face": f} for f in (0, 3)]},
            "corners = 6: must be 4",
        ),
        (
            {
                "object": {"footprint": [[-0.5, -0.4], [0.5, -0.4], [0.4, 0.6], [-0.5, 0.4]], "mass": 5.0},
                "robots": [{"type": "aliengo", "face": f} for f in (0, 2)],
            },
            "box = False: must be True",
        ),
    ],
)
def test_lanes_that_do_not_fit_are_named(make_scenario, scenes, tables, text):
    other = build_scene(make_scenario(**tables), scenery=False)
    with pytest.raises(InputError, match=r"scenes\[2\]") as error:
        stack_models([*scenes, other])
    assert text in str(error.value)


def test_scenery_does_not_stack(make_scenario):
    far = [{"shape": "circle", "radius": 0.2, "position": [5.0, 5.0]}]
    scenes = [build_scene(make_scenario()), build_scene(make_scenario(obstacles=far))]
    with pytest.raises(InputError, match=r"scenes\[1\].*scenery=False"):
        stack_models(scenes)
    with pytest.raises(InputError, match="at least one"):
        stack_models([])
