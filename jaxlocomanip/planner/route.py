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

from jaxlocomanip.lanes import where_needed
from jaxlocomanip.numerics import select, wrap_angle
from jaxlocomanip.planar.dynamics import Body
from jaxlocomanip.planner.config import PlannerConfig
from jaxlocomanip.planner.estimation import ObstacleEstimate
from jaxlocomanip.planner.path import UNPLANNED, Path
from jaxlocomanip.planner.reference import Progress
from jaxlocomanip.planner.refine import STEPS, Refined, refine
from jaxlocomanip.planner.search import search_poses
from jaxlocomanip.planner.shapes import Shapes
from jaxlocomanip.scenario import Goal

_WORSE, _MORE = 1.1, 0.3
"""a new path is searched if the old one costs more than so many times what it was expected to, and so many metres"""
_STALLED = 0.1
"""a team that covers less than this share of the usual way between two searches is stuck"""
_SHARE, _LESS = 0.8, 0.3
"""a new path is taken if it costs less than this share of the old one's cost, less so many metres"""


def plan(
    pose: Array,
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
      goal: where to.
      path: in force.
      progress: on it.
      shapes: geometry and team.
      obstacles: as estimated.
      body: the object as estimated.
      config: settings.
    """
    pose, path, progress = jax.lax.stop_gradient((pose, path, progress))
    given = jax.lax.stop_gradient((goal, shapes, obstacles, body, config))
    goal, shapes, obstacles, body, config = given
    ahead = jnp.linspace(0.0, 1.0, STEPS + 1, dtype=pose.dtype) * (path.length - progress.projected)
    rest = path.at(progress.projected + ahead)
    old = refine(rest.at[0].set(pose), *given)
    # A path on which nothing moves is none, whatever it seems to cost: then the search decides alone.
    stalled = ~progress.resting & (progress.projected < _STALLED * config.reference.speed * config.reference.replan)
    planned = (path.cost < UNPLANNED) & ~stalled
    old = dataclasses.replace(old, cost=jnp.where(planned, old.cost, UNPLANNED))

    def search(given: tuple[Any, ...]) -> Refined:
        pose, goal, shapes, obstacles, body, config = given
        return refine(search_poses(pose, goal.pose, shapes, obstacles, body, config), *given[1:])

    # A path that goes on as it was expected to needs no rival, unless obstacles move.
    expected = path.cost * (path.length - progress.projected) / jnp.maximum(path.length, 1e-3)
    worse = old.cost > _WORSE * expected + _MORE
    miss = jnp.abs(old.poses[-1] - goal.pose)
    off = jnp.maximum(
        jnp.max(miss[:2]) / goal.position_tolerance, jnp.abs(wrap_angle(miss[2])) / goal.heading_tolerance
    )
    moving = jnp.any(shapes.obstacle_dynamic & shapes.obstacle_mask)
    needed = worse | moving | (off > config.reference.arrive)
    if config.horizon.rest_skips:
        new = where_needed(needed, search, (pose, *given), old)
    else:
        new = search((pose, *given))
    return select(needed & (new.cost < _SHARE * old.cost - _LESS), new, old)
