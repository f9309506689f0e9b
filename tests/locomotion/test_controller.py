"""What the controller does from call to call; that it walks and pushes is shown elsewhere."""

import dataclasses

import asked
import jax
import jax.numpy as jnp
import numpy as np
import pytest
from flat_ground import FlatGround, control_once

from jaxlocomanip.locomotion import controller
from jaxlocomanip.locomotion.robot import joint_torque
from jaxlocomanip.locomotion.srbd import GRAVITY

WALK = asked.walk((0.1, 0.5, 0.0, 0.2))


@pytest.fixture(scope="module")
def walking(gains):
    """A maker of grounds on which a robot has walked for a while."""

    def make(name, until=1.02):
        ground = FlatGround(name, gains[name])
        ground.run(until, WALK)
        return ground

    return make


def call(ground, time, solve, **changes):
    body = ground.measure()
    wanted = dataclasses.replace(WALK(ground, body, time), **changes)
    return control_once(ground.state, ground.robot, ground.settings, body, wanted, np.float32(time), np.bool_(solve))


def test_forces_are_kept_between_solves_and_change_with_one(walking):
    ground = walking("aliengo")
    held, _ = call(ground, 1.022, False)
    fresh, _ = call(ground, 1.022, True)
    assert (held.planned == ground.state.planned).all()
    assert not np.allclose(fresh.planned, ground.state.planned, atol=0.1)


def test_forces_act_on_stance_legs_only_and_sum_to_about_the_weight(walking):
    ground = walking("aliengo")
    state, command = call(ground, 1.022, True)
    swinging = np.asarray(state.gait.swinging)
    force = np.asarray(state.force)
    assert (force[swinging] == 0.0).all() and (force[~swinging, 2] > 10.0).all()
    assert force[:, 2].sum() == pytest.approx(float(ground.robot.mass) * GRAVITY, rel=0.3)
    assert (np.asarray(command.kp)[swinging] == 40.0).all() and (np.asarray(command.kp)[~swinging] == 0.0).all()


def test_a_leg_that_lands_between_solves_takes_the_plans_second_interval(walking):
    ground = walking("aliengo", until=1.09)
    swinging = np.asarray(ground.state.gait.swinging)
    assert swinging.tolist() == [True, False, False, True]
    state, _ = call(ground, 1.101, False)  # they land 2 T after the start at 0.1 s
    assert not np.asarray(state.gait.swinging).any()
    assert np.asarray(state.force) == pytest.approx(np.asarray(ground.state.planned)[1])
    assert np.asarray(state.force)[swinging, 2].min() > 10.0


def test_standing_command_holds_the_robot_by_torque_alone(robots, gains):
    ground = FlatGround("go1", gains["go1"])
    _, command = control_once(
        ground.state,
        ground.robot,
        ground.settings,
        ground.measure(),
        asked.motion(walking=False),
        np.float32(0.0),
        np.bool_(True),
    )
    torque = joint_torque(command, ground.measure().joint, ground.measure().joint_rate, ground.robot.torque_max)
    assert np.asarray(torque) == pytest.approx(np.asarray(command.torque), abs=1e-5)
    assert (np.asarray(command.kp) == 0.0).all()


def test_reference_never_leaves_the_robot(walking):
    ground = walking("a1")
    for far in ([100.0, -100.0], [-3.0, 7.0]):
        ground.state = dataclasses.replace(ground.state, reference=jnp.asarray(far, jnp.float32))
        state, _ = call(ground, 1.022, False)
        off = np.asarray(state.reference) - ground.measure().position[:2]
        assert np.abs(off).max() == pytest.approx(0.1, abs=1e-5)


def test_a_mixed_team_equals_its_members_and_solve_stays_a_branch(walking):
    grounds = [walking("aliengo"), walking("go1")]
    bodies = [ground.measure() for ground in grounds]
    wanted = [WALK(ground, body, 1.022) for ground, body in zip(grounds, bodies, strict=True)]

    def stacked(parts):
        return jax.tree.map(lambda *leaves: jnp.stack([jnp.asarray(leaf) for leaf in leaves]), *parts)

    team = (
        stacked([g.state for g in grounds]),
        stacked([g.robot for g in grounds]),
        stacked([g.settings for g in grounds]),
        stacked(bodies),
        stacked(wanted),
    )
    together = jax.vmap(controller.control, (0, 0, 0, 0, 0, None, None))
    time, solve = jnp.float32(1.022), jnp.bool_(True)
    _, commands = jax.jit(together)(*team, time, solve)
    for index, ground in enumerate(grounds):
        _, alone = call(ground, 1.022, True)
        for ours, single in zip(jax.tree.leaves(commands), jax.tree.leaves(alone), strict=True):
            assert np.asarray(ours[index]) == pytest.approx(np.asarray(single), abs=2e-2)
    assert " cond[" in str(jax.make_jaxpr(together)(*team, time, solve))


def test_single_precision_throughout(walking):
    state, command = call(walking("aliengo"), 1.022, True)
    floating = [leaf for leaf in jax.tree.leaves((state, command)) if jnp.issubdtype(leaf.dtype, jnp.floating)]
    assert floating and all(leaf.dtype == jnp.float32 for leaf in floating)


def test_double_precision_works_too(x64):
    from jaxlocomanip.locomotion.settings import settings_for
    from jaxlocomanip.worlds.legged import read_robot

    robot, settings = read_robot("aliengo"), settings_for("aliengo")
    ground = FlatGround("aliengo", settings)
    body = jax.tree.map(lambda leaf: jnp.asarray(leaf, jnp.float64), ground.measure())
    wanted = jax.tree.map(jnp.asarray, asked.motion(walking=False))
    wanted = jax.tree.map(lambda leaf: leaf.astype(jnp.float64) if leaf.dtype == jnp.float32 else leaf, wanted)
    state = controller.start(robot, settings, body)
    state, command = jax.jit(controller.control)(
        state, robot, settings, body, wanted, jnp.float64(0.0), jnp.bool_(True)
    )
    assert command.torque.dtype == jnp.float64
    assert np.asarray(state.force)[:, 2].sum() == pytest.approx(float(robot.mass) * GRAVITY, rel=1e-3)
