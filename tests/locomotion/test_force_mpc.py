"""Forces of simple situations where the answer is known."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from asked import motion

from jaxlocomanip.locomotion import controller, qp
from jaxlocomanip.locomotion.algebra import yaw_matrix
from jaxlocomanip.locomotion.force_mpc import in_world
from jaxlocomanip.locomotion.robot import BodyState
from jaxlocomanip.locomotion.srbd import GRAVITY


@jax.jit
def solved(robot, settings, body, asked):
    """Forces [N, 4, 3] in the world that a standing robot's MPC finds."""
    state = controller.start(robot, settings, body)
    problem = controller.force_problem(state, robot, settings, body, asked, jnp.float32(0.0))
    forces = qp.solve(problem, settings.forces.penalty, settings.forces.iterations)
    return in_world(forces, body)


def standing(robot, yaw=0.0, place=(0.0, 0.0), **changes):
    level = {
        "position": jnp.array([*place, robot.stand_height]),
        "rotation": yaw_matrix(jnp.float32(yaw)),
        "velocity": jnp.zeros(3),
        "angular_velocity": jnp.zeros(3),
        "joint": robot.stand,
        "joint_rate": jnp.zeros((4, 3)),
    }
    return BodyState(**(level | changes))


@pytest.mark.parametrize("name", ["aliengo", "a1", "go1"])
def test_standing_carries_the_weight_and_nothing_else(name, robots, gains):
    robot = robots[name]
    forces = solved(robot, gains[name], standing(robot), motion(walking=False))
    total = np.asarray(forces).sum(axis=1)
    weight = float(robot.mass) * GRAVITY
    assert total == pytest.approx(np.tile([0.0, 0.0, weight], (10, 1)), abs=2e-2 * weight)
    assert total[0] == pytest.approx([0.0, 0.0, weight], abs=2e-3 * weight)
    foot = robot.hip + jnp.stack([0.0 * robot.abduction, robot.abduction, 0.0 * robot.abduction], axis=1) - robot.com
    moment = np.cross(np.asarray(foot) * [1, 1, 0], np.asarray(forces[0]) * [0, 0, 1]).sum(axis=0)
    assert moment == pytest.approx(np.zeros(3), abs=0.01 * weight * 0.3)


def test_the_answer_turns_and_moves_with_the_robot(robots, gains):
    robot, settings = robots["aliengo"], gains["aliengo"]
    tilted = dict(velocity=jnp.array([0.1, -0.05, 0.0]), angular_velocity=jnp.array([0.1, 0.2, -0.1]))
    here = solved(robot, settings, standing(robot, **tilted), motion(walking=False))
    turn = np.asarray(yaw_matrix(jnp.float32(2.0)))
    turned = {name: jnp.asarray(turn) @ value for name, value in tilted.items()}
    there = solved(robot, settings, standing(robot, 2.0, (500.0, -300.0), **turned), motion(heading=2.0, walking=False))
    assert np.asarray(there) @ turn == pytest.approx(np.asarray(here), abs=0.2)


@pytest.mark.parametrize("yaw", [0.0, 1.2])
def test_an_expected_push_is_met_by_the_feet(yaw, robots, gains):
    robot = robots["aliengo"]
    body = standing(robot, yaw)
    turn = np.asarray(body.rotation)
    push = turn @ np.array([-40.0, 0.0, 0.0])
    point = np.asarray(body.position) + turn @ np.array([0.36, 0.0, 0.0])
    asked = motion(heading=yaw, force=push, point=point, walking=False)
    forces = np.asarray(solved(robot, gains["aliengo"], body, asked))
    assert forces[0].sum(axis=0)[:2] == pytest.approx(-push[:2], abs=0.5)
    # The push acts above the feet: it would lift the front, whose feet therefore carry less.
    front, rear = forces[0, :2, 2].sum(), forces[0, 2:, 2].sum()
    lever = 40.0 * float(robot.stand_height) / (float(robot.hip[0, 0] - robot.hip[2, 0]))
    free = np.asarray(solved(robot, gains["aliengo"], body, motion(heading=yaw, walking=False)))
    change = (rear - front) - (free[0, 2:, 2].sum() - free[0, :2, 2].sum())
    assert change == pytest.approx(2.0 * lever, rel=0.1)


def test_errors_are_corrected_in_their_direction(robots, gains):
    robot, settings = robots["go1"], gains["go1"]
    low = standing(robot, position=jnp.array([0.0, 0.0, robot.stand_height - 0.03]))
    assert np.asarray(solved(robot, settings, low, motion(walking=False)))[0, :, 2].sum() > 1.05 * robot.mass * GRAVITY
    sliding = standing(robot, velocity=jnp.array([0.3, 0.0, 0.0]))
    assert np.asarray(solved(robot, settings, sliding, motion(walking=False)))[0, :, 0].sum() < -10.0


def test_forces_stay_in_the_cone_however_large_the_error(robots, gains):
    robot, settings = robots["a1"], gains["a1"]
    wild = standing(robot, velocity=jnp.array([5.0, -5.0, 3.0]), angular_velocity=jnp.array([9.0, -9.0, 9.0]))
    forces = np.asarray(solved(robot, settings, wild, motion(walking=False)))
    assert np.isfinite(forces).all()
    normal = forces[..., 2]
    assert (normal >= 0.0).all() and (normal <= float(settings.forces.force_max)).all()
    assert (np.abs(forces[..., :2]) <= 0.5 * normal[..., None] + 1e-3).all()
