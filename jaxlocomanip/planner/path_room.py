"""Room of the team's discs along the path of a `quasistatic.PathProblem`, all stages and discs side by side.

Arrays have stages last. Only what is nearest to a disc is looked at closely: distances to all obstacles first, then the
direction away from that one. What several pieces read is computed apart from them (`numerics.apart`).
"""

from __future__ import annotations

from functools import reduce
from typing import TYPE_CHECKING

import jax
import jax.numpy as jnp
from jax import Array

from jaxlocomanip.numerics import apart, smaller
from jaxlocomanip.planar.geometry import Outline, outline, quick_distance, quick_normal
from jaxlocomanip.planar.vector import Vector, choose, unit, vector, vectors
from jaxlocomanip.planner.room import side_by_side
from jaxlocomanip.planner.shapes import ROBOT_DISCS

if TYPE_CHECKING:
    from jaxlocomanip.planner.quasistatic import PathProblem

_NOWHERE = 1e3
"""m, to an obstacle that there is not"""


def rooms(problem: PathProblem, x: Array) -> Array:
    """[D, N] m, of all discs at states [nx, N]: distance to the nearest obstacle, beyond radius and margin."""
    return _rooms(problem, x) - _reaches(problem)


def _rooms(problem: PathProblem, x: Array) -> Array:
    """[D, N] m, distances of all discs' middles to the nearest obstacle."""
    return _least(_distances(problem, _seen(problem, x, _arms(problem, x)), _outlines(problem)))


@apart
def _least(away: Array) -> Array:
    return reduce(smaller, [*away])


def facing(problem: PathProblem, x: Array) -> tuple[Array, Vector, Vector]:
    """Room [D, N] m, its gradient by the disc's place, and the disc's place from the body point."""
    arm, shapes = _arms(problem, x), _outlines(problem)
    seen = _seen(problem, x, arm)
    away = _distances(problem, seen, shapes)
    return _least(away) - _reaches(problem), _outwards(*_nearest(away, seen, shapes)), arm


@apart
def _distances(problem: PathProblem, seen: Vector, shapes: Outline) -> Array:
    """[N_o, D, N] m."""
    time, obstacles = problem.stages.time, problem.shapes
    berth = jnp.where(obstacles.obstacle_dynamic[:, None], problem.config.reference.caution * time, 0.0)
    rounding = (obstacles.obstacle_radius[:, None] + berth)[:, None]
    return jnp.where(obstacles.obstacle_mask[:, None, None], quick_distance(seen, shapes) - rounding, _NOWHERE)


@apart
def _nearest(away: Array, seen: Vector, shapes: Outline) -> tuple[Vector, Outline]:
    """Places [D, N] of discs from the nearest of obstacles at distances [N_o, D, N], and its outline [V, D, N]."""
    distance, place = away[0], seen[0]
    shape = jax.tree.map(lambda leaf: leaf[:, 0], shapes)
    for o in range(1, away.shape[0]):
        nearer = away[o] < distance
        distance, place = smaller(away[o], distance), choose(nearer, seen[o], place)
        shape = jax.tree.map(lambda leaf, kept, o=o, nearer=nearer: jnp.where(nearer, leaf[:, o], kept), shapes, shape)
    return place, shape


@apart
def _outwards(place: Vector, shape: Outline) -> Vector:
    return quick_normal(place, shape)


@apart
def _outlines(problem: PathProblem) -> Outline:
    """Leaves [V, N_o, 1, 1]."""
    return outline(vectors(jnp.swapaxes(problem.shapes.obstacle_vertices, 0, 1)[:, :, None, None]))


@apart
def _arms(problem: PathProblem, x: Array) -> Vector:
    """[D, N] m, places of all discs from the body point, in world axes."""
    shapes, n = problem.shapes, x.shape[0] - 3
    middles = vectors(shapes.robot_centers(jnp.zeros(n, x.dtype)).reshape(-1, 2)[:, None])
    aside = side_by_side(jnp.repeat(shapes.team.tangent, ROBOT_DISCS, axis=0))
    robots = middles + aside * jnp.repeat(x[3:], ROBOT_DISCS, axis=0)
    objects = vectors(shapes.object_centers[:, None] + jnp.zeros_like(x[0])[:, None])
    local = Vector(jnp.concatenate([objects.x, robots.x]), jnp.concatenate([objects.y, robots.y]))
    return local.rotated(unit(x[2]))


@apart
def _seen(problem: PathProblem, x: Array, arm: Vector) -> Vector:
    """[N_o, D, N] m, places of discs from obstacles."""
    obstacles = problem.obstacles
    places = obstacles.position[..., None] + obstacles.velocity[..., None] * problem.stages.time
    center = arm + vector(x)
    return Vector(center.x[None], center.y[None]) - Vector(places[:, 0, None], places[:, 1, None])


def _reaches(problem: PathProblem) -> Array:
    """[D, 1] m, radii of the discs, and the margin."""
    shapes = problem.shapes
    radii = jnp.concatenate([shapes.object_radii, jnp.repeat(shapes.robot_radii, ROBOT_DISCS)])
    return (radii + problem.config.constraints.margin)[:, None]
