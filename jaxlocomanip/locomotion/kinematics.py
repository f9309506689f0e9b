"""Kinematics of a leg: abduction about x, thigh and calf about y, links hanging down at zero angles.

Feet are points, the centres of the spheres at the calves' ends, in body axes from the trunk's origin.
"""

from __future__ import annotations

import jax
import jax.numpy as jnp
import numpy as np
from jax import Array

from jaxlocomanip.locomotion.algebra import inverse3
from jaxlocomanip.locomotion.robot import LeggedRobot
from jaxlocomanip.numerics import safe_norm

STRAIGHT = 0.05
"""least determinant of a leg's Jacobian with unit columns that is inverted: straight legs move no faster than that"""
_UP, _LEFT = np.array([0.0, 0.0, 1.0], np.float32), np.array([0.0, 1.0, 0.0], np.float32)


def _in_plane(robot: LeggedRobot, joint: Array) -> tuple[Array, Array, Array, Array]:
    """Foot from the thigh joint in the leg's plane (forward, up), and its part beyond the knee; [4] m each."""
    thigh, both = joint[:, 1], joint[:, 1] + joint[:, 2]
    forward_calf = -robot.calf * jnp.sin(both)
    up_calf = -robot.calf * jnp.cos(both)
    return (
        forward_calf - robot.thigh * jnp.sin(thigh),
        up_calf - robot.thigh * jnp.cos(thigh),
        forward_calf,
        up_calf,
    )


def feet(robot: LeggedRobot, joint: Array) -> Array:
    """[4, 3] m, feet in body axes at joint angles [4, 3] rad."""
    forward, up, _, _ = _in_plane(robot, joint)
    c, s = jnp.cos(joint[:, 0]), jnp.sin(joint[:, 0])
    side = robot.abduction
    return robot.hip + jnp.stack([forward, c * side - s * up, s * side + c * up], axis=-1)


def jacobians(robot: LeggedRobot, joint: Array) -> Array:
    """[4, 3, 3] m, derivatives of `feet` [leg, axis, joint]; a foot moves with its own leg's joints only."""
    forward, up, forward_calf, up_calf = _in_plane(robot, joint)
    c, s = jnp.cos(joint[:, 0]), jnp.sin(joint[:, 0])
    side = robot.abduction
    hip = jnp.stack([jnp.zeros_like(c), -s * side - c * up, c * side - s * up], axis=-1)
    # Turning by a pitch angle moves the point (forward, up) by (up, -forward).
    thigh = jnp.stack([up, s * forward, -c * forward], axis=-1)
    calf = jnp.stack([up_calf, s * forward_calf, -c * forward_calf], axis=-1)
    return jnp.stack([hip, thigh, calf], axis=-1)


def gravity_torques(robot: LeggedRobot, joint: Array, gravity: Array) -> Array:
    """[4, 3] N m that hold the legs' own weight at rest.

    Args:
      robot: parameters.
      joint: [4, 3] rad.
      gravity: [3] m/s^2 in body axes, pointing down.
    """

    def potential(angles: Array) -> Array:
        hip, thigh, both = angles[:, 0], angles[:, 1], angles[:, 1] + angles[:, 2]
        knee = _pitch(thigh, -robot.thigh * _UP)
        beside = robot.abduction[:, None] * _LEFT
        coms = jnp.stack(
            [
                robot.link_com[:, 0],
                beside + _pitch(thigh, robot.link_com[:, 1]),
                beside + knee + _pitch(both, robot.link_com[:, 2]),
            ],
            axis=1,
        )
        c, s = jnp.cos(hip)[:, None], jnp.sin(hip)[:, None]
        side, up = c * coms[..., 1] - s * coms[..., 2], s * coms[..., 1] + c * coms[..., 2]
        along = jnp.stack([coms[..., 0], side, up], axis=-1) @ gravity
        return -jnp.sum(robot.link_mass * along)

    return jax.grad(potential)(joint)


def _pitch(angle: Array, vector: Array) -> Array:
    """[4, 3] vectors turned about y by angles [4]."""
    c, s = jnp.cos(angle), jnp.sin(angle)
    x, y, z = vector[..., 0], vector[..., 1], vector[..., 2]
    return jnp.stack([c * x + s * z, jnp.broadcast_to(y, angle.shape), c * z - s * x], axis=-1)


def joint_rates(jacobian: Array, velocity: Array) -> Array:
    """[4, 3] rad/s that move the feet at velocities [4, 3] m/s in body axes."""
    floor = STRAIGHT * jnp.prod(safe_norm(jacobian, axis=-2), axis=-1)
    return jnp.einsum("lij,lj->li", inverse3(jacobian, floor), velocity)


def joint_accelerations(robot: LeggedRobot, joint: Array, rate: Array, acceleration: Array) -> Array:
    """[4, 3] rad/s^2 that accelerate feet by [4, 3] m/s^2 in body axes while the joints move at rates [4, 3] rad/s."""

    def moving(angles: Array) -> Array:
        return jnp.einsum("lij,lj->li", jacobians(robot, angles), rate)

    _, turning = jax.jvp(moving, (joint,), (rate,))
    return joint_rates(jacobians(robot, joint), acceleration - turning)


def joint_angles(robot: LeggedRobot, foot: Array) -> Array:
    """[4, 3] rad that put the feet at [4, 3] m in body axes, or as near as reach and joint limits allow.

    Knees bend the way they do in the stand pose, and feet stay below the hips' axes.
    """
    point = foot - robot.hip
    side = robot.abduction
    across = jnp.sqrt(jnp.maximum(point[:, 1] ** 2 + point[:, 2] ** 2, side**2))
    up = -jnp.sqrt(jnp.maximum(across**2 - side**2, 0.0))
    hip = jnp.arctan2(point[:, 2], point[:, 1]) - jnp.arctan2(up, side)
    hip = hip - 2.0 * jnp.pi * jnp.round(hip / (2.0 * jnp.pi))

    bend = jnp.sign(robot.stand[:, 2])
    limits = jnp.stack([robot.joint_low[:, 2], robot.joint_high[:, 2]])
    length = safe_norm(jnp.stack([point[:, 0], up], axis=-1))
    cosine = (length**2 - robot.thigh**2 - robot.calf**2) / (2.0 * robot.thigh * robot.calf)
    calf = jnp.clip(bend * jnp.arccos(jnp.clip(cosine, -1.0, 1.0)), limits[0], limits[1])
    reach = jnp.arctan2(-point[:, 0], -up)
    thigh = reach - jnp.arctan2(robot.calf * jnp.sin(calf), robot.thigh + robot.calf * jnp.cos(calf))
    return jnp.clip(jnp.stack([hip, thigh, calf], axis=-1), robot.joint_low, robot.joint_high)
