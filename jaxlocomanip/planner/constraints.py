"""Inequalities of a horizon: bounds, control Lyapunov function, and the settings of all barriers.

Components come first and stages last: a state is an array [nx, ...], and the axes after the first count stages, or
are absent for one stage alone. So loops run along the stages of a horizon, in contiguous memory.
"""

from __future__ import annotations

import jax.numpy as jnp
from jax import Array

from jaxlocomanip.numerics import Floats, pytree, wrap_angle
from jaxlocomanip.planar.dynamics import Body, friction_wrench
from jaxlocomanip.planar.vector import trailing, unit, vector
from jaxlocomanip.planner.config import Barrier, Constraints, PlannerConfig
from jaxlocomanip.planner.shapes import ROBOT_DISCS, Shapes
from jaxlocomanip.scenario import UNPAIRED


@pytree
class Motion:
    """Object and contacts; the axes after the first count stages."""

    pose: Array
    """[3, ...]"""
    twist: Array
    """[3, ...]"""
    acceleration: Array
    """[3, ...] predicted qdd"""
    force: Array
    """[N_r, ...] N"""
    offset: Array
    """[N_r, ...] m"""
    offset_rate: Array
    """[N_r, ...] m/s"""


def bounds(motion: Motion, shapes: Shapes) -> tuple[Array, Array, Array, Array]:
    """Bounds, each wanted >= 0: on force, offset and offset rate [2 N_r, ...] and room in the team [P, ...]."""
    team = shapes.team

    def both(low: Array | float, value: Array, high: Array) -> Array:
        return jnp.concatenate([value - low, trailing(high, value) - value])

    limit = trailing(team.offset_limit, motion.offset)
    speed = trailing(team.slide_speed_max, motion.offset_rate)
    return (
        both(0.0, motion.force, team.force_max),
        both(-limit, motion.offset, team.offset_limit),
        both(-speed, motion.offset_rate, team.slide_speed_max),
        room(motion.offset, shapes),
    )


def room(offset: Array, shapes: Shapes) -> Array:
    """[P, ...] room between robots of neighbouring contacts at contact offsets [N_r, ...], m."""
    team = shapes.team
    taken = [trailing(team.pair_rows[:, i], offset) * offset[i] for i in range(offset.shape[0])]
    return trailing(team.pair_bounds, offset) - sum(taken, jnp.zeros((), offset.dtype))


def lyapunov_condition(
    pose: Array,
    twist: Array,
    wrench: Array,
    body: Body,
    target: Array,
    target_twist: Array,
    settings: Constraints,
    smoothing: Floats,
) -> Array:
    """[...] CLF: s'(-tau + H qdd_r + C qd_r + f_k) - 1/2 s' K_D s, with s = qd_e + lambda q_e.

    Args:
      pose: [3, ...] of the object.
      twist: [3, ...] of the object.
      wrench: tau [3, ...] about p, world axes.
      body: the object as estimated.
      target: [3, ...] reference pose.
      target_twist: [3, ...] reference velocity.
      settings: gains; optionally divides by 1 + |s| lest a far reference outweigh every barrier.
      smoothing: m/s, of friction at rest.
    """
    error_rate = twist - target_twist
    off = vector(pose) - vector(target)
    turn = wrap_angle(pose[2] - target[2])
    rate = settings.clf_rate
    s, spin = vector(error_rate) + off * rate, error_rate[2] + rate * turn
    # H a + C w with a = -lambda qd_e and w = qd - s.
    arm = vector(body.com).rotated(unit(pose[2])) * body.mass
    a, bend = vector(error_rate) * (-rate), -rate * error_rate[2]
    force = a * body.mass + arm.turned * bend - arm * (twist[2] * (twist[2] - spin))
    moment = arm.cross(a) + body.inertia * bend
    friction = friction_wrench(body, pose[2], twist, smoothing)
    needed = force + vector(friction) - vector(wrench)
    squared = s.dot(s) + spin * spin
    h = s.dot(needed) + spin * (moment + friction[2] - wrench[2]) - 0.5 * settings.clf_gain * squared
    positive = squared > 0.0
    size = jnp.where(positive, jnp.sqrt(jnp.where(positive, squared, 1.0)), 0.0)
    return h / (1.0 + settings.clf_normalised * size)


@pytree
class BarrierRows:
    """Settings of every inequality of a stage, in the order bounds, CLF, object, robots; leaves [nh]."""

    weight: Array
    switch: Array
    reach: Array


def barrier_rows(shapes: Shapes, config: PlannerConfig) -> BarrierRows:
    """Barrier settings of all inequalities; absent obstacles and unprotected bodies have weight 0."""
    settings, team = config.constraints, shapes.team
    n = team.offset.shape[0]
    dtype = team.offset.dtype
    exists = shapes.obstacle_mask.astype(dtype)
    groups: list[tuple[Barrier, Array]] = [
        (settings.force, jnp.ones(2 * n, dtype)),
        (settings.offset, jnp.ones(2 * n, dtype)),
        (settings.offset_rate, jnp.ones(2 * n, dtype)),
        (settings.team, (team.pair_bounds < UNPAIRED).astype(dtype)),
        (settings.clf, jnp.ones(1, dtype)),
        (settings.object_cbf, jnp.tile(exists, shapes.object_radii.shape[0]) * config.protection.object),
        (settings.robot_cbf, jnp.tile(exists, n * ROBOT_DISCS) * config.protection.robots),
    ]

    def rows(values: list[Array]) -> Array:
        return jnp.concatenate(values).astype(dtype)

    return BarrierRows(
        rows([barrier.weight * mask for barrier, mask in groups]),
        rows([barrier.switch * jnp.ones_like(mask) for barrier, mask in groups]),
        rows([barrier.reach * jnp.ones_like(mask) for barrier, mask in groups]),
    )
