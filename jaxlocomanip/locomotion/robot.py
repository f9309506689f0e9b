"""A quadruped as its own controller sees it: parameters, state, and what goes in and out of the controller.

Legs are always in the order FR, FL, RR, RL and their joints in the order hip (abduction), thigh, calf, so that
everything about legs has the shape [4, 3]. Body axes are those of the trunk: x forward, y left, z up.
"""

from __future__ import annotations

import jax.numpy as jnp
from jax import Array

from jaxlocomanip.numerics import pytree

LEGS: tuple[str, ...] = ("FR", "FL", "RR", "RL")
"""Order of everything about legs."""
JOINTS: tuple[str, ...] = ("hip", "thigh", "calf")
"""Order of a leg's joints."""


@pytree
class LeggedRobot:
    """Parameters of one robot, read from its MJCF (`worlds.legged.read_robot`)."""

    mass: Array
    """[] kg, whole robot"""
    inertia: Array
    """[3, 3] kg m^2, of the whole robot at the stand pose about its centre of mass, body axes"""
    com: Array
    """[3] m, centre of mass at the stand pose, from the trunk's origin, body axes"""
    hip: Array
    """[4, 3] m, hip joints from the trunk's origin, body axes"""
    abduction: Array
    """[4] m, signed lateral (y) distance from hip joint to thigh joint"""
    thigh: Array
    """[] m, length"""
    calf: Array
    """[] m, length down to the foot's centre"""
    foot_radius: Array
    """[] m"""
    joint_low: Array
    """[4, 3] rad"""
    joint_high: Array
    """[4, 3] rad"""
    torque_max: Array
    """[4, 3] N m"""
    stand: Array
    """[4, 3] rad, joint angles of the stand pose"""
    stand_height: Array
    """[] m, of the trunk's origin above the ground at the stand pose"""
    pusher: Array
    """[3] m, centre of the pusher's sphere from the trunk's origin, body axes"""
    pusher_radius: Array
    """[] m"""
    link_mass: Array
    """[4, 3] kg, hip, thigh and calf of each leg"""
    link_com: Array
    """[4, 3, 3] m, their centres of mass from their joints, in their own axes"""
    leg_inertia: Array
    """[4, 3, 3] kg m^2, joint-space inertia of each leg at the stand pose, motors included, trunk held"""
    joint_damping: Array
    """[4, 3] N m s/rad"""


@pytree
class BodyState:
    """Measured state of one robot."""

    position: Array
    """[3] m, trunk's origin in the world"""
    rotation: Array
    """[3, 3] R_WB"""
    velocity: Array
    """[3] m/s, of the trunk's origin, world axes"""
    angular_velocity: Array
    """[3] rad/s, world axes"""
    joint: Array
    """[4, 3] rad"""
    joint_rate: Array
    """[4, 3] rad/s"""


@pytree
class Motion:
    """What one robot is asked to do until the next request."""

    velocity: Array
    """[2] m/s, of the trunk, world axes"""
    heading: Array
    """[] rad, now"""
    yaw_rate: Array
    """[] rad/s"""
    force: Array
    """[3] N, external force expected on the robot (what the object pushes back), world axes"""
    point: Array
    """[3] m, where it acts, in the world"""
    walking: Array
    """[] bool: trot; otherwise stand on four feet as soon as every leg has landed"""


@pytree
class JointCommand:
    """The low-level command of quadruped robots: held and executed at the rate of the motors."""

    position: Array
    """[4, 3] rad"""
    rate: Array
    """[4, 3] rad/s"""
    kp: Array
    """[4, 3] N m/rad"""
    kd: Array
    """[4, 3] N m s/rad"""
    torque: Array
    """[4, 3] N m, feed-forward"""


def joint_torque(command: JointCommand, joint: Array, joint_rate: Array, torque_max: Array) -> Array:
    """[4, 3] N m, what the motors do under a held command, clipped to their limits."""
    spring = command.kp * (command.position - joint)
    damper = command.kd * (command.rate - joint_rate)
    return jnp.clip(command.torque + spring + damper, -torque_max, torque_max)
