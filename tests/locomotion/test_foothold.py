import dataclasses

import jax.numpy as jnp
import numpy as np
import pytest

from jaxlocomanip.locomotion.algebra import yaw_matrix
from jaxlocomanip.locomotion.foothold import FootholdRule, footholds, hips, nominal_footholds
from jaxlocomanip.locomotion.robot import BodyState

RULE = FootholdRule(capture=0.03, clamp=0.3, sink=0.004)
STANCE = 0.3
ZERO = jnp.zeros(())


def body(robot, velocity=(0.0, 0.0), yaw=0.0):
    return BodyState(
        position=jnp.array([1.0, 2.0, 0.35]),
        rotation=yaw_matrix(jnp.float32(yaw)),
        velocity=jnp.array([*velocity, 0.0]),
        angular_velocity=jnp.zeros(3),
        joint=robot.stand,
        joint_rate=jnp.zeros((4, 3)),
    )


def test_standing_feet_are_below_the_hips(robots):
    robot = robots["aliengo"]
    places = footholds(robot, RULE, body(robot), jnp.zeros(2), ZERO, jnp.zeros(4), STANCE)
    assert places[:, :2] == pytest.approx(np.array([1.0, 2.0]) + np.asarray(hips(robot)), abs=1e-6)
    assert places[:, 2] == pytest.approx(np.full(4, float(robot.foot_radius) - 0.004), abs=1e-6)


def test_steady_walk_has_hips_above_feet_at_mid_stance(robots):
    robot, velocity, wait = robots["go1"], jnp.array([0.5, -0.2]), jnp.array([0.0, 0.05, 0.1, 0.2])
    now = body(robot, velocity, 0.4)
    places = footholds(robot, RULE, now, velocity, jnp.float32(0.3), wait, STANCE)
    middle = (wait + 0.5 * STANCE)[None]
    nominal = nominal_footholds(robot, now, velocity, jnp.float32(0.3), middle)[0]
    assert places[:, :2] == pytest.approx(np.asarray(nominal), abs=1e-6)


def test_too_fast_steps_further_in_the_direction_of_the_error(robots):
    robot, asked = robots["a1"], jnp.array([0.2, 0.0])
    steady = footholds(robot, RULE, body(robot, (0.2, 0.0)), asked, ZERO, jnp.zeros(4), STANCE)
    pushed = footholds(robot, RULE, body(robot, (0.2, 0.5)), asked, ZERO, jnp.zeros(4), STANCE)
    assert pushed - steady == pytest.approx(np.tile([0.0, 0.5 * 0.5 * STANCE + 0.03 * 0.5, 0.0], (4, 1)), abs=1e-6)


def test_shift_is_clamped(robots):
    robot = robots["a1"]
    rule = dataclasses.replace(RULE, clamp=0.1)
    places = footholds(robot, rule, body(robot, (5.0, -5.0)), jnp.zeros(2), ZERO, jnp.zeros(4), STANCE)
    assert places[:, :2] - hips(robot) == pytest.approx(np.tile([1.1, 1.9], (4, 1)), abs=1e-5)
