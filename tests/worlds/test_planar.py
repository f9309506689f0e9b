"""The planar world: how its robots push and slide, and where the energy goes."""

import dataclasses

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from jaxlocomanip.planar import dynamics
from jaxlocomanip.planar.geometry import perpendicular, rotate
from jaxlocomanip.worlds.interface import Push
from jaxlocomanip.worlds.planar import PlanarWorld

WORLD, TICK = PlanarWorld(), 0.02
step = jax.jit(lambda world, *args: world.step(*args, 0.0, TICK))
TRUTH = {"mass": 8.0, "friction": 0.4, "com": [0.03, -0.02]}


@pytest.fixture
def scenario(make_scenario):
    """A function, so that the arrays are made in the precision of the test."""
    return lambda: make_scenario(truth=TRUTH)


def push(force=(0.0, 0.0), rate=(0.0, 0.0)):
    return Push(jnp.asarray(force, float), jnp.asarray(rate, float), jnp.zeros(3), jnp.zeros((), bool))


def test_starts_at_rest_in_contact(scenario):
    made = scenario()
    view = WORLD.view(WORLD.start(made), made)
    assert (view.pose == made.start).all() and (view.twist == 0.0).all() and (view.force == 0.0).all()
    assert (view.robots == made.team.robot_poses(made.start, made.team.offset)).all()
    after = step(WORLD, WORLD.start(made), made, push())
    assert (after.pose == made.start).all()


@pytest.mark.parametrize("ticks", [1, 5, 20])
def test_push_follows_the_command_with_the_time_constant(x64, scenario, ticks):
    made, state = scenario(), WORLD.start(scenario())
    for _ in range(ticks):
        state = step(WORLD, state, made, push((10.0, 5.0)))
    expected = np.array([10.0, 5.0]) * (1.0 - np.exp(-ticks * TICK / WORLD.force_lag))
    assert np.allclose(state.force, expected, rtol=1e-12)
    assert (state.twist == 0.0).all()  # below break-away


def test_push_is_limited_to_what_the_robot_can_do(x64, scenario):
    made, state = scenario(), WORLD.start(scenario())
    for _ in range(60):
        state = step(WORLD, state, made, push((1e3, -50.0)))
    assert state.force[0] == pytest.approx(float(made.team.force_max[0]), rel=1e-6)
    assert state.force[1] == 0.0


def sliding(made, twist, force=0.0):
    """State with the contact forces already built up."""
    return dataclasses.replace(WORLD.start(made), twist=jnp.asarray(twist, float), force=jnp.full(2, force))


def test_push_fades_with_speed(x64, scenario):
    """From `fade` below the robot's top speed linearly to nothing; the object then only feels friction."""
    made = scenario()
    top = float(made.team.push_speed_max[0])
    world = PlanarWorld(substeps=1, fade=0.1)

    def gained(speed):
        """Impulse of 30 N on the -x face over one step, with the robot on -y not pushing."""
        start = sliding(made, (speed, 0.0, 0.0))
        loaded = dataclasses.replace(start, force=jnp.array([30.0, 0.0]))
        pushed = step(world, loaded, made, push((30.0, 0.0)))
        coasting = step(world, start, made, push())
        return float(made.truth.mass) * float((pushed.twist - coasting.twist)[0])

    full = gained(top - 0.5)
    assert full == pytest.approx(30.0 * TICK, rel=0.02)
    assert gained(top - 0.05) == pytest.approx(0.5 * full, rel=1e-2)
    assert gained(top) == pytest.approx(0.0, abs=1e-12)
    assert gained(top + 0.2) == pytest.approx(0.0, abs=1e-12)


def test_sliding_along_a_face_at_rest_is_limited_by_walking_sideways(x64, scenario):
    made = scenario()
    limit = np.asarray(made.team.slide_speed_max)
    slow = step(WORLD, WORLD.start(made), made, push(rate=(0.1, -0.05)))
    assert np.allclose(slow.offset, np.array([0.1, -0.05]) * TICK, rtol=1e-12)
    fast = step(WORLD, WORLD.start(made), made, push(rate=(9.0, -9.0)))
    assert np.allclose(fast.offset, np.array([1.0, -1.0]) * limit * TICK, rtol=1e-12)


def test_sliding_along_a_moving_face_leaves_less_speed(x64, scenario):
    """The robot walks with the face; what it has left is the slide. A face that runs away takes it along."""
    made, world = scenario(), PlanarWorld(substeps=1)
    limit, aside = float(made.team.slide_speed_max[0]), 0.2
    start = sliding(made, (0.0, aside, 0.0))  # the tangent of the -x face is +y
    along = step(world, start, made, push(rate=(9.0, 0.0)))
    against = step(world, start, made, push(rate=(-9.0, 0.0)))
    assert along.offset[0] == pytest.approx((limit - aside) * TICK)
    assert against.offset[0] == pytest.approx((-limit - aside) * TICK)
    swept = step(world, sliding(made, (0.0, limit + 0.3, 0.0)), made, push())
    assert swept.offset[0] == pytest.approx(-0.3 * TICK)


def test_offsets_end_at_the_edge_of_the_face(x64, scenario):
    made, state = scenario(), WORLD.start(scenario())
    for _ in range(200):
        state = step(WORLD, state, made, push(rate=(1.0, -1.0)))
    limit = np.asarray(made.team.offset_limit)
    assert np.allclose(state.offset, limit * [1.0, -1.0], rtol=1e-12)


def power_balance(made, substeps, world):
    """Kinetic energy gained, work of the pushes and dissipation of one second of pushing, in J."""
    h = TICK / substeps
    inertia = jnp.stack([made.truth.mass, made.truth.mass, made.truth.central_inertia])
    limits = jnp.stack([made.truth.friction_force, made.truth.friction_force, made.truth.friction_moment])
    command = push((45.0, 40.0), (0.05, -0.05))

    def central(state):
        return dynamics.to_com(made.truth, state.pose[2], state.twist)

    def contact_speeds(state):
        points = made.team.contact_points(state.offset)
        velocity_B = rotate(-state.pose[2], state.twist[:2]) + state.twist[2] * perpendicular(points)
        return jnp.sum(velocity_B * made.team.normal, axis=-1)

    def one(carry, _):
        state, work, heat = carry
        after = world.substep(state, made, made.team, command, h)
        before_V, after_V = central(state), central(after)
        fade = jnp.clip((made.team.push_speed_max - contact_speeds(state)) / world.fade, 0.0, 1.0)
        speeds = 0.5 * (contact_speeds(state) + contact_speeds(after))
        work = work + h * jnp.sum(after.force * fade * speeds)
        rubbing = [jnp.sqrt(jnp.sum((limits * V) ** 2)) for V in (before_V, after_V)]
        return (after, work, heat + 0.5 * h * (rubbing[0] + rubbing[1])), None

    count = round(1.0 / h)
    start = sliding(made, (0.3, 0.1, 0.2), 20.0)
    (last, work, heat), _ = jax.lax.scan(one, (start, 0.0, 0.0), None, length=count)
    kinetic = [0.5 * jnp.sum(inertia * central(s) ** 2) for s in (start, last)]
    return kinetic[1] - kinetic[0], work, heat


def test_energy_is_work_minus_dissipation(x64, scenario):
    """Up to the error of the time integration, which halves as the substeps double."""
    made, errors = scenario(), []
    balance = jax.jit(power_balance, static_argnums=1)
    for substeps in (2, 4, 8, 16):
        gained, work, heat = balance(made, substeps, WORLD)
        assert work > 5.0 and heat > 5.0
        errors.append(abs(float(gained - (work - heat))) / float(work))
    assert errors[0] < 0.02
    ratios = np.array(errors[:-1]) / np.array(errors[1:])
    assert (ratios > 1.7).all(), errors


def test_single_precision_stays_single(scenario):
    made = scenario()
    state = step(WORLD, WORLD.start(made), made, push((40.0, 40.0)))
    numbers = [leaf for leaf in jax.tree.leaves(state) if jnp.issubdtype(leaf.dtype, jnp.floating)]
    assert len(numbers) >= 4 and all(leaf.dtype == jnp.float32 for leaf in numbers)
