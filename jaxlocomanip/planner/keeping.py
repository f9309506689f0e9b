"""Room to keep between each body and each obstacle.

Usually that is the filter's margin. Of a body that is within the margin of an obstacle that stands no more is asked
than that it come no closer, so that it is free to leave. Asked of one tick at a time, that would let it creep: a
little closer with each push that turns the object in another way than expected. So the room that there once was is
remembered, and all but a centimetre of it is kept for good.
"""

from __future__ import annotations

import jax.numpy as jnp
from jax import Array

from jaxlocomanip.numerics import Floats, pytree
from jaxlocomanip.planner.config import PlannerConfig
from jaxlocomanip.planner.estimation import ObjectEstimate, ObstacleEstimate
from jaxlocomanip.planner.room import bodies_of, gaps_at
from jaxlocomanip.planner.shapes import Shapes

ROUNDING = 1e-5
"""m, by which a body that does not move may seem to"""
SLACK = 0.01
"""m, of the room that there was, that may be used up; half of it where there was less than twice as much"""
_MEAN = 0.5
"""s, over which the room is averaged: a heading off by 0.01 rad moves the tail of a robot by 9 mm"""
_DOUBT = 0.02
"""m, by which the first measurement may have too much room"""


@pytree
class Kept:
    """What is remembered of the room; leaves [1 + N_r, N_o], m."""

    mean: Array
    """of late"""
    best: Array
    """most of it so far"""


def start(gaps: Array) -> Kept:
    """Before the first tick, at gaps [1 + N_r, N_o] m as first measured."""
    return Kept(gaps - _DOUBT, gaps - _DOUBT)


def regrouped(before: Kept, gaps: Array) -> Kept:
    """When robots have gone to other places: theirs begin anew, the object has not moved."""
    fresh = start(gaps)
    return Kept(fresh.mean.at[0].set(before.mean[0]), fresh.best.at[0].set(before.best[0]))


def watch(before: Kept, gaps: Array, tick: Floats) -> Kept:
    """One tick of `tick` s, with the gaps [1 + N_r, N_o] m as estimated."""
    mean = before.mean + tick / (tick + _MEAN) * (gaps - before.mean)
    return Kept(mean, jnp.maximum(before.best, mean))


def room_to_keep(kept: Kept, gaps: Array, moves: Array, margin: Floats) -> Array:
    """[1 + N_r, N_o] m.

    Args:
      kept: what is remembered.
      gaps: [1 + N_r, N_o] m, now.
      moves: [N_o] bool, obstacles that move: these are always kept clear of.
      margin: m.
    """
    best = jnp.minimum(margin, kept.best)
    least = best - jnp.minimum(SLACK, 0.5 * jnp.maximum(best, 0.0))
    return jnp.where(moves, margin, jnp.maximum(jnp.minimum(margin, gaps - ROUNDING), least))


def gaps_of(
    estimate: ObjectEstimate, offset: Array, obstacles: ObstacleEstimate, shapes: Shapes, config: PlannerConfig
) -> Array:
    """[1 + N_r, N_o] m, from the object and the robots at contact offsets [N_r] m to the obstacles, as estimated."""
    places = obstacles.position[..., None]
    return gaps_at(estimate.pose[:, None], offset[:, None], places, bodies_of(shapes, config))[..., 0]
