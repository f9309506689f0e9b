"""Legged robots on their walk around the object, from the faces of one formation to those of the next.

Each robot follows its pose of `formation.Walk`: it steps back and circles, facing the object. The walk goes on only as
fast as the slowest robot keeps up. The last phase, stepping up to the new face, is the approach of `worlds.contact`.
"""

from __future__ import annotations

import jax.numpy as jnp
from jax import Array

from jaxlocomanip.formation import PHASES, Walk
from jaxlocomanip.locomotion.robot import Motion
from jaxlocomanip.numerics import Floats, safe_norm, wrap_angle

CIRCLED = PHASES - 1.0
"""phase at which the robots stand before their new faces"""
GAIN = 2.0
"""1/s, on the way that a robot is behind its pose"""
CATCH_UP = 0.2
"""m/s, most that this adds"""
BEHIND = 0.12
"""m, by which a robot may be behind before the walk waits for it"""
_SOON = 0.1
"""s, ahead of which the walk's velocity is taken"""


def motions(
    walk: Walk, phase: Array, pose: Array, robots: Array, ahead: Array, point: Array, period: Floats
) -> tuple[Array, Motion]:
    """The walk's phase after a period, s, and what the robots are asked to do meanwhile.

    Args:
      walk: of the team.
      phase: [] now, below `CIRCLED`.
      pose: [3] of the object.
      robots: [N_r, 3] poses of the robots' trunks: origin, m, and heading, rad.
      ahead: [N_r] m, from a trunk's origin to the middle of the robot's body rectangle.
      point: [N_r, 3] m, where each robot would touch the object.
      period: s.
    """

    def trunks(phase: Array) -> Array:
        middles = walk.poses_in_world(pose, phase)
        direction = jnp.stack([jnp.cos(middles[:, 2]), jnp.sin(middles[:, 2])], axis=-1)
        return jnp.concatenate([middles[:, :2] - ahead[:, None] * direction, middles[:, 2:]], axis=1)

    target = trunks(phase)
    off = target[:, :2] - robots[:, :2]
    waits = jnp.max(safe_norm(off)) > BEHIND
    soon = trunks(jnp.minimum(walk.advance(phase, _SOON), CIRCLED))
    pace = jnp.where(waits, 0.0, 1.0 / _SOON)
    rate = pace * jnp.concatenate([soon[:, :2] - target[:, :2], wrap_angle(soon[:, 2:] - target[:, 2:])], axis=1)
    closing = GAIN * off
    closing = closing * jnp.minimum(1.0, CATCH_UP / jnp.maximum(safe_norm(closing), 1e-6))[:, None]
    nothing = jnp.zeros_like(point)
    motion = Motion(
        velocity=rate[:, :2] + closing,
        heading=target[:, 2],
        yaw_rate=rate[:, 2],
        force=nothing,
        point=point,
        walking=jnp.ones(robots.shape[0], bool),
    )
    return jnp.where(waits, phase, jnp.minimum(walk.advance(phase, period), CIRCLED)), motion
