"""Which path to follow: the one in force, bent to where the object is now, or a new one from the search.

Both are refined and priced alike, and a new path has to be clearly cheaper, so that noise and small changes of the
estimate do not turn a team around. The path is held fixed when gradients are taken.
"""

from __future__ import annotations

import dataclasses
from typing import Any

import jax
import jax.numpy as jnp
from jax import Array

from jaxlocomanip.formation import team_in
from jaxlocomanip.lanes import where_needed
from jaxlocomanip.numerics import pytree, safe_norm, select, wrap_angle
from jaxlocomanip.planar.dynamics import Body
from jaxlocomanip.planner import reference
from jaxlocomanip.planner.config import PlannerConfig
from jaxlocomanip.planner.estimation import PREDICTED, ObstacleEstimate
from jaxlocomanip.planner.path import UNPLANNED, Aim, Path
from jaxlocomanip.planner.reference import Progress
from jaxlocomanip.planner.refine import Guess, Refined, guess_along, guess_from, refine, unrefined
from jaxlocomanip.planner.search import Query, search_poses
from jaxlocomanip.planner.shapes import Shapes
from jaxlocomanip.scenario import Formations, Goal

_WORSE, _MORE = 1.1, 0.3
"""a new path is searched if the old one costs more than so many times what it was expected to, and so many metres"""
_SHARE, _LESS = 0.8, 0.3
"""a new path is taken if it costs less than this share of the old one's cost, less so many metres"""
_NEAR = 2.0
"""m from the object, within which an obstacle that moves is a reason to search anew"""


@pytree
class Choice:
    """A path and where it leads."""

    refined: Refined
    aim: Aim

    @property
    def cost(self) -> Array:
        """[] m, all the way to the goal."""
        return self.refined.cost + self.aim.beyond


def plan(
    pose: Array,
    offset: Array,
    goal: Goal,
    path: Path,
    progress: Progress,
    shapes: Shapes,
    formations: Formations,
    now: Array,
    berth: Array,
    walks: Array,
    obstacles: ObstacleEstimate,
    body: Body,
    config: PlannerConfig,
) -> Choice:
    """The path to follow from a pose [3]; of a team that has arrived, none that is worth anything.

    Args:
      pose: of the object, now.
      offset: [N_r] m, contact offsets now.
      goal: where to.
      path: in force.
      progress: on it.
      shapes: geometry, and the team in its first formation.
      formations: the other ones.
      now: [] int, formation now.
      berth: [] m, room that walks around the object keep beyond the usual.
      walks: [] int, made so far.
      obstacles: as estimated.
      body: the object as estimated.
      config: settings.
    """
    pose, offset, path, progress = jax.lax.stop_gradient((pose, offset, path, progress))
    given = jax.lax.stop_gradient((shapes, formations, obstacles, body, config))
    shapes, formations, obstacles, body, config = given
    skips = config.horizon.rest_skips
    there = dataclasses.replace(shapes, team=team_in(shapes.team, formations, now))
    # A path on which nothing moves is none, whatever it seems to cost: then the search decides alone.
    stuck = reference.stalls(progress, config.reference) >= reference.PATIENCE
    # Beside obstacles that move a new path is searched every time, which is no reason to look at all formations.
    threatened = beset(pose, shapes, obstacles)
    wide = stuck | (path.cost >= UNPLANNED) | ~threatened
    query = jax.lax.stop_gradient(Query(pose, offset, goal, now, stuck, wide, berth, walks))
    rest = guess_along(path, progress.projected, pose, offset, there, body, config), path.aim

    def search(arguments: tuple[Any, ...]) -> tuple[Guess, Aim]:
        query, there, shapes, formations, obstacles, body, config = arguments
        rough = search_poses(query, shapes, formations, obstacles, body, config)
        return guess_from(rough.poses, query.offset, there, body, config), rough.aim

    def consider(carry: tuple[Choice, Array], anew: Array) -> tuple[tuple[Choice, Array], None]:
        best, needed = carry
        guess, aim = jax.lax.cond(
            anew, lambda: where_needed(needed, search, (query, there, *given), rest, skips, group=1), lambda: rest
        )
        arguments = (guess, aim.goal, there, obstacles, body, config)
        found = where_needed(needed, lambda arguments: refine(*arguments), arguments, best.refined, skips)
        new = Choice(found, aim)
        best = select(needed & (new.cost < _SHARE * best.cost - _LESS), new, best)
        return (best, ~progress.resting & (threatened | _wants_rival(best, path, progress, config))), None

    first = (Choice(unrefined(rest[0]), path.aim), ~progress.resting & (path.cost < UNPLANNED) & ~stuck)
    # One after the other in a loop, so that the refinement is compiled once.
    (best, _), _ = jax.lax.scan(consider, first, jnp.array([False, True]))
    return best


def beset(pose: Array, shapes: Shapes, obstacles: ObstacleEstimate) -> Array:
    """[] bool: an obstacle that moves is near an object at a pose [3], or soon will be.

    Those far away are as good as standing ones, whose price on the path in force is looked at in every search.
    """
    times = jnp.linspace(0.0, PREDICTED, 4)[:, None, None]
    places = obstacles.position + times * obstacles.velocity
    sizes = jnp.max(safe_norm(shapes.obstacle_vertices, axis=-1), axis=-1) + shapes.obstacle_radius
    away = jnp.min(safe_norm(places - pose[:2], axis=-1), axis=0) - sizes
    return jnp.any(shapes.obstacle_dynamic & shapes.obstacle_mask & (away < _NEAR))


def _wants_rival(best: Choice, path: Path, progress: Progress, config: PlannerConfig) -> Array:
    """[] bool: a path that goes on as it was expected to needs no rival."""
    expected = path.cost * (path.length - progress.projected) / jnp.maximum(path.length, 1e-3)
    worse = best.refined.cost > _WORSE * expected + _MORE
    goal = best.aim.goal
    miss = jnp.abs(best.refined.poses[-1] - goal.pose)
    off = jnp.maximum(
        jnp.max(miss[:2]) / goal.position_tolerance, jnp.abs(wrap_angle(miss[2])) / goal.heading_tolerance
    )
    return worse | (off > config.reference.arrive)
