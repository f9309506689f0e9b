"""Which path to follow: the one in force, bent to where the object is now, or a new one from the search.

Both are refined and priced alike, and a new path has to be clearly cheaper, so that noise and small changes of the
estimate do not turn a team around. The path is held fixed when gradients are taken.
"""

from __future__ import annotations

from typing import Any

import jax
import jax.numpy as jnp
from jax import Array

from jaxlocomanip.lanes import where_needed
from jaxlocomanip.numerics import select, wrap_angle
from jaxlocomanip.planar.dynamics import Body
from jaxlocomanip.planner import reference
from jaxlocomanip.planner.config import PlannerConfig
from jaxlocomanip.planner.estimation import ObstacleEstimate
from jaxlocomanip.planner.path import UNPLANNED, Path
from jaxlocomanip.planner.reference import Progress
from jaxlocomanip.planner.refine import Guess, Refined, guess_along, guess_from, refine, unrefined
from jaxlocomanip.planner.search import search_poses
from jaxlocomanip.planner.shapes import Shapes
from jaxlocomanip.scenario import Goal

_WORSE, _MORE = 1.1, 0.3
"""a new path is searched if the old one costs more than so many times what it was expected to, and so many metres"""
_SHARE, _LESS = 0.8, 0.3
"""a new path is taken if it costs less than this share of the old one's cost, less so many metres"""


def plan(
    pose: Array,
    offset: Array,
    goal: Goal,
    path: Path,
    progress: Progress,
    shapes: Shapes,
    obstacles: ObstacleEstimate,
    body: Body,
    config: PlannerConfig,
) -> Refined:
    """The path to follow from a pose [3].

    Args:
      pose: of the object, now.
      offset: [N_r] m, contact offsets now.
      goal: where to.
      path: in force.
      progress: on it.
      shapes: geometry and team.
      obstacles: as estimated.
      body: the object as estimated.
      config: settings.
    """
    pose, offset, path, progress = jax.lax.stop_gradient((pose, offset, path, progress))
    given = jax.lax.stop_gradient((goal, shapes, obstacles, body, config))
    goal, shapes, obstacles, body, config = given
    skips = config.horizon.rest_skips
    rest = guess_along(path, progress.projected, pose, offset, shapes, body, config)

    def search(given: tuple[Any, ...]) -> Guess:
        pose, offset, goal, shapes, obstacles, body, config = given
        rough = search_poses(pose, goal, shapes, obstacles, body, config)
        return guess_from(rough, offset, shapes, body, config)

    def consider(carry: tuple[Refined, Array], anew: Array) -> tuple[tuple[Refined, Array], None]:
        best, needed = carry
        guess = jax.lax.cond(
            anew, lambda: where_needed(needed, search, (pose, offset, *given), rest, skips), lambda: rest
        )
        found = where_needed(needed, lambda arguments: refine(*arguments), (guess, *given), best, skips)
        best = select(needed & (found.cost < _SHARE * best.cost - _LESS), found, best)
        return (best, _wants_rival(best, path, progress, goal, shapes, config)), None

    # A path on which nothing moves is none, whatever it seems to cost: then the search decides alone.
    stuck = reference.stalls(progress, config.reference) >= reference.PATIENCE
    first = (unrefined(rest), (path.cost < UNPLANNED) & ~stuck)
    # One after the other in a loop, so that the refinement is compiled once.
    (best, _), _ = jax.lax.scan(consider, first, jnp.array([False, True]))
    return best


def _wants_rival(
    best: Refined, path: Path, progress: Progress, goal: Goal, shapes: Shapes, config: PlannerConfig
) -> Array:
    """[] bool: a path that goes on as it was expected to needs no rival, unless obstacles move."""
    expected = path.cost * (path.length - progress.projected) / jnp.maximum(path.length, 1e-3)
    worse = best.cost > _WORSE * expected + _MORE
    miss = jnp.abs(best.poses[-1] - goal.pose)
    off = jnp.maximum(
        jnp.max(miss[:2]) / goal.position_tolerance, jnp.abs(wrap_angle(miss[2])) / goal.heading_tolerance
    )
    moving = jnp.any(shapes.obstacle_dynamic & shapes.obstacle_mask)
    return worse | moving | (off > config.reference.arrive)
