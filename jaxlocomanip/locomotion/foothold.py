"""Where swinging feet shall land: below the hips at mid-stance, moved against a velocity error."""

from __future__ import annotations

import jax.numpy as jnp
from jax import Array

from jaxlocomanip.locomotion.algebra import yaw_matrix, yaw_of
from jaxlocomanip.locomotion.robot import BodyState, LeggedRobot
from jaxlocomanip.numerics import Floats, pytree


@pytree
class FootholdRule:
    """Numbers of the rule."""

    capture: Floats
    """s, foothold shift per velocity error"""
    clamp: Floats
    """m, largest shift of a foothold from below its hip, along each horizontal axis"""
    sink: Floats
    """m, how far below the ground's surface soles are aimed at, so that they land in time"""


def hips(robot: LeggedRobot) -> Array:
    """[4, 2] m, points above which feet stand when the legs hang straight, body axes."""
    return robot.hip[:, :2] + jnp.stack([jnp.zeros_like(robot.abduction), robot.abduction], axis=-1)


def landing_height(robot: LeggedRobot, rule: FootholdRule) -> Array:
    """[] m, height of a foot's centre at the end of its swing."""
    return robot.foot_radius - rule.sink


def footholds(
    robot: LeggedRobot,
    rule: FootholdRule,
    body: BodyState,
    velocity: Array,
    yaw_rate: Array,
    remaining: Array,
    stance: Floats,
) -> Array:
    """Raibert's symmetric foothold with a capture term.

    Args:
      robot: parameters.
      rule: numbers of the rule.
      body: measured state.
      velocity: [2] m/s, commanded, world axes.
      yaw_rate: [] rad/s, commanded.
      remaining: [4] s until touchdown.
      stance: s, duration of the stance that follows.

    Returns:
      [4, 3] m, in the world.
    """
    actual = body.velocity[:2]
    heading = yaw_of(body.rotation) + yaw_rate * (remaining + 0.5 * stance)
    below = jnp.einsum("lij,lj->li", yaw_matrix(heading)[:, :2, :2], hips(robot))
    shift = 0.5 * stance * actual + rule.capture * (actual - velocity)
    place = body.position[:2] + below + remaining[:, None] * actual + jnp.clip(shift, -rule.clamp, rule.clamp)
    return jnp.concatenate([place, jnp.full((4, 1), landing_height(robot, rule), place.dtype)], axis=-1)


def nominal_footholds(
    robot: LeggedRobot,
    body: BodyState,
    velocity: Array,
    yaw_rate: Array,
    middle: Array,
) -> Array:
    """[N, 4, 2] m, footholds of stances whose middles are `middle` [N, 4] s ahead if commands are followed exactly."""
    heading = yaw_of(body.rotation) + yaw_rate * middle
    below = jnp.einsum("nlij,lj->nli", yaw_matrix(heading)[..., :2, :2], hips(robot))
    return body.position[:2] + middle[..., None] * velocity + below
