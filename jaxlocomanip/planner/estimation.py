"""State estimation from noisy poses (paper, "State estimation").

The object's observer predicts with the planner's own model, adapted mass and friction included, and corrects pose and
velocity by fixed fractions of the innovation; its innovation is also the prediction error that the adaptation law
learns from. Obstacles have a Kalman filter each: constant position, or constant velocity if they may move.
"""

from __future__ import annotations

import jax
import jax.numpy as jnp
from jax import Array

from jaxlocomanip.numerics import Floats, pytree, wrap_angle
from jaxlocomanip.planner.config import Estimation

PREDICTED = 3.0
"""s, for which paths trust obstacles to go on as they do now"""


@pytree
class ObjectEstimate:
    """Pose and velocity of the object."""

    pose: Array
    """[3] m, m, rad (continuous)"""
    twist: Array
    """[3] m/s, m/s, rad/s"""
    innovation: Array
    """[3] last measured minus predicted pose"""


@pytree
class ObstacleEstimate:
    """Positions and velocities of the obstacles, with the filter's covariance (equal for both axes)."""

    position: Array
    """[N_o, 2] m"""
    velocity: Array
    """[N_o, 2] m/s"""
    covariance: Array
    """[N_o, 3] variances p_xx, p_xv, p_vv"""


def start_object(pose: Array) -> ObjectEstimate:
    """Estimate at the first measured pose [3], at rest."""
    return ObjectEstimate(pose, jnp.zeros_like(pose), jnp.zeros_like(pose))


def correct_object(
    predicted_pose: Array, predicted_twist: Array, measured: Array, tick: Floats, settings: Estimation
) -> ObjectEstimate:
    """Observer correction.

    Args:
      predicted_pose: [3] one-tick prediction of the planner's model.
      predicted_twist: [3] likewise.
      measured: [3] measured pose; its heading may be wrapped.
      tick: s.
      settings: gains.
    """
    difference = measured - predicted_pose
    innovation = jnp.concatenate([difference[:2], wrap_angle(difference[2:])])
    return ObjectEstimate(
        predicted_pose + settings.pose_gain * innovation,
        predicted_twist + settings.twist_gain / tick * innovation,
        innovation,
    )


def start_obstacles(position: Array, settings: Estimation) -> ObstacleEstimate:
    """Estimate at the first measured positions [N_o, 2]; velocities unknown (standard deviation 1 m/s)."""
    ones = jnp.ones(position.shape[0], position.dtype)
    covariance = jnp.stack([ones * settings.obstacle_noise**2, 0.0 * ones, ones], axis=1)
    return ObstacleEstimate(position, jnp.zeros_like(position), covariance)


def track_obstacles(
    estimate: ObstacleEstimate, measured: Array, dynamic: Array, tick: Floats, settings: Estimation
) -> ObstacleEstimate:
    """One predict-and-correct step of every obstacle's Kalman filter.

    Args:
      estimate: the previous estimate.
      measured: [N_o, 2] m.
      dynamic: [N_o] bool; static obstacles keep zero velocity and no process noise.
      tick: s.
      settings: noise levels.
    """

    def one(position: Array, velocity: Array, p: Array, y: Array, moves: Array) -> tuple[Array, Array, Array]:
        speed = jnp.where(moves, velocity, 0.0)
        noise = jnp.where(moves, settings.obstacle_acceleration**2, 0.0)
        free = jnp.where(moves, 1.0, 0.0)
        xv, vv = free * p[1], free * p[2]
        xx = p[0] + 2.0 * tick * xv + tick**2 * vv + 0.25 * tick**4 * noise
        xv = xv + tick * vv + 0.5 * tick**3 * noise
        vv = vv + tick**2 * noise
        total = xx + settings.obstacle_noise**2
        gain_x, gain_v = xx / total, xv / total
        innovation = y - (position + tick * speed)
        covariance = jnp.stack([(1.0 - gain_x) * xx, (1.0 - gain_x) * xv, vv - gain_v * xv])
        return position + tick * speed + gain_x * innovation, speed + gain_v * innovation, covariance

    return ObstacleEstimate(
        *jax.vmap(one)(estimate.position, estimate.velocity, estimate.covariance, measured, dynamic)
    )
