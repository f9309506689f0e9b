"""Legs against MuJoCo and against finite differences."""

import jax
import jax.numpy as jnp
import mujoco
import numpy as np
import pytest

from jaxlocomanip.locomotion import kinematics
from jaxlocomanip.locomotion.robot import LEGS
from jaxlocomanip.robots.model import ROBOT_TYPES
from jaxlocomanip.worlds.legged import joint_names, robot_path

every_robot = pytest.mark.parametrize("name", ROBOT_TYPES)
RNG = np.random.default_rng(1)


class Legs:
    """MuJoCo's legs at given joint angles, the trunk anywhere."""

    def __init__(self, name):
        self.model = mujoco.MjModel.from_xml_path(str(robot_path(name)))
        self.data = mujoco.MjData(self.model)

    def pose(self, joint, quaternion=(1.0, 0.0, 0.0, 0.0)):
        self.data.qpos[:3] = [0.3, -0.2, 0.5]
        self.data.qpos[3:7] = quaternion / np.linalg.norm(quaternion)
        for name, angle in zip(joint_names(), np.ravel(joint), strict=True):
            self.data.joint(name).qpos[0] = angle
        mujoco.mj_forward(self.model, self.data)
        return self

    @property
    def rotation(self):
        return self.data.body("trunk").xmat.reshape(3, 3)

    @property
    def feet(self):
        places = np.array([self.data.geom(f"{leg}_foot").xpos for leg in LEGS])
        return (places - self.data.body("trunk").xpos) @ self.rotation

    @property
    def gravity(self):
        return np.array([self.data.joint(n).qfrc_bias[0] for n in joint_names()]).reshape(4, 3)


def postures(robot, count):
    low, high = np.asarray(robot.joint_low), np.asarray(robot.joint_high)
    return RNG.uniform(low, high, (count, 4, 3)).astype(np.float32)


@every_robot
def test_feet_and_weights_are_those_of_mujoco(name, robots):
    legs, robot = Legs(name), robots[name]
    for joint in postures(robot, 20):
        legs.pose(joint, RNG.normal(size=4))
        assert kinematics.feet(robot, joint) == pytest.approx(legs.feet, abs=2e-6)
        down = -9.81 * legs.rotation[2].astype(np.float32)
        assert kinematics.gravity_torques(robot, joint, down) == pytest.approx(legs.gravity, abs=2e-5)


@every_robot
def test_jacobian_is_the_derivative_of_the_feet(name, robots):
    robot = robots[name]
    for joint in postures(robot, 10):
        derivative = np.asarray(jax.jacfwd(lambda q: kinematics.feet(robot, q))(joint))
        own = np.stack([derivative[leg, :, leg] for leg in range(4)])
        assert kinematics.jacobians(robot, joint) == pytest.approx(own, abs=1e-6)
        assert np.abs(derivative[0, :, 1:]).max() == 0.0


def test_jacobian_by_finite_differences_of_mujoco(robots):
    robot, legs, step = robots["aliengo"], Legs("aliengo"), 1e-6
    for joint in postures(robot, 3).astype(float):
        found = np.asarray(kinematics.jacobians(robot, joint.astype(np.float32)))
        for axis in range(3):
            shift = step * np.eye(3)[axis]
            change = (legs.pose(joint + shift).feet - legs.pose(joint - shift).feet) / (2 * step)
            assert found[:, :, axis] == pytest.approx(change, abs=1e-5)


@every_robot
def test_inverse_returns_to_where_the_feet_are(name, robots):
    robot = robots[name]
    near = np.asarray(robot.stand) + RNG.uniform(-0.5, 0.5, (200, 4, 3)).astype(np.float32)
    for joint in np.clip(near, robot.joint_low, robot.joint_high):
        foot = kinematics.feet(robot, joint)
        assert kinematics.joint_angles(robot, foot) == pytest.approx(joint, abs=2e-3)


@every_robot
def test_inverse_out_of_reach_is_finite_within_limits_and_nearest_along_the_leg(name, robots):
    robot = robots[name]
    far = np.asarray(robot.hip) + 2.0 * RNG.normal(size=(100, 4, 3)).astype(np.float32)
    found = np.asarray(jax.vmap(kinematics.joint_angles, (None, 0))(robot, far))
    assert np.isfinite(found).all()
    assert (found >= np.asarray(robot.joint_low) - 1e-6).all() and (found <= np.asarray(robot.joint_high) + 1e-6).all()
    below = np.asarray(robot.hip) + np.stack([np.zeros(4), robot.abduction, np.full(4, -5.0)], axis=1)
    angles = kinematics.joint_angles(robot, jnp.asarray(below, jnp.float32))
    foot = np.asarray(kinematics.feet(robot, angles)) - np.asarray(robot.hip)
    assert foot[:, 0] == pytest.approx(np.zeros(4), abs=1e-5)  # it points at the target, as long as the knee allows
    assert angles[:, 2] == pytest.approx(robot.joint_high[:, 2])


def test_rates_and_accelerations_move_the_feet_as_asked(robots):
    robot = robots["go1"]
    joint = jnp.asarray(robot.stand)
    velocity, hurry = RNG.normal(size=(2, 4, 3)).astype(np.float32)
    rate = kinematics.joint_rates(kinematics.jacobians(robot, joint), velocity)
    speeding = kinematics.joint_accelerations(robot, joint, rate, hurry)

    def feet(t):
        return kinematics.feet(robot, joint + t * rate + 0.5 * t**2 * speeding)

    first = jax.jvp(feet, (0.0,), (1.0,))[1]
    second = jax.jvp(lambda t: jax.jvp(feet, (t,), (1.0,))[1], (0.0,), (1.0,))[1]
    assert first == pytest.approx(velocity, abs=1e-5)
    assert second == pytest.approx(hurry, abs=1e-3)


def test_a_straight_leg_asks_for_bounded_rates(robots):
    robot = robots["aliengo"]
    straight = jnp.zeros((4, 3))
    rate = kinematics.joint_rates(kinematics.jacobians(robot, straight), jnp.ones((4, 3)))
    assert np.isfinite(rate).all() and np.abs(rate).max() < 200.0
