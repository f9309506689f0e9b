"""Room around true shapes, and how fast robots may slide along their faces without using it up.

Poses and contact offsets are looked at many at a time, side by side along the last axis, so that every operation on a
component is one long loop.
"""

from __future__ import annotations

import dataclasses
from functools import reduce

import jax
import jax.numpy as jnp
from jax import Array

from jaxlocomanip.numerics import Floats, pytree
from jaxlocomanip.planar.geometry import outline, outline_distance
from jaxlocomanip.planar.vector import Vector, unit, vector
from jaxlocomanip.planner.config import PlannerConfig
from jaxlocomanip.planner.shapes import Shapes
from jaxlocomanip.scenario import Team
from jaxlocomanip.solver.layout import added

ROOM_RATE = 4.0
"""1/s, of the barrier conditions on room"""
AHEAD = 0.02
"""m, at which a robot's room is looked at beside where it is"""
FAR = 1e3
"""m, room where there is nothing to hit"""


@pytree
class Bodies:
    """What is kept clear of obstacles."""

    team: Team
    object_vertices: Array
    """[V, 2] m, body frame"""
    obstacle_vertices: Array
    """[N_o, W, 2] m"""
    obstacle_radius: Array
    """[N_o] m"""
    obstacle_mask: Array
    """[N_o] bool"""
    obstacle_dynamic: Array
    """[N_o] bool"""
    protected: Array
    """[2] bool: object, robots"""


def bodies_of(shapes: Shapes, config: PlannerConfig) -> Bodies:
    """The bodies that a configuration protects."""
    protection = config.protection
    return Bodies(
        shapes.team,
        shapes.object_vertices,
        shapes.obstacle_vertices,
        shapes.obstacle_radius,
        shapes.obstacle_mask,
        shapes.obstacle_dynamic,
        jnp.stack([jnp.asarray(protection.object), jnp.asarray(protection.robots)]) > 0.5,
    )


@pytree
class Rooms:
    """Least signed distances of true shapes in n situations [n], m."""

    standing: Array
    """object and robots to obstacles that stand"""
    moving: Array
    """object and robots to obstacles that move"""
    team: Array
    """robots to each other"""


def rooms_at(poses: Array, offsets: Array, places: Array, bodies: Bodies, kept: Floats = 0.0) -> Rooms:
    """Rooms of n situations.

    Args:
      poses: [3, n] of the object.
      offsets: [N_r, n] m.
      places: [N_o, 2, n] m, of the obstacles.
      bodies: the shapes.
      kept: m, of the room between bodies and obstacles, what is not to be used up; [1 + N_r, N_o, 1] of each pair, or
        one number.
    """
    team = bodies.team
    offsets = jnp.clip(offsets, -team.offset_limit[:, None], team.offset_limit[:, None])
    object_gaps, *robot_gaps = gaps_at(poses, offsets, places, bodies) - kept
    object_gaps = jnp.where(bodies.protected[0], object_gaps, FAR)
    gaps = jnp.minimum(object_gaps, jnp.where(bodies.protected[1], reduce(jnp.minimum, robot_gaps), FAR))
    moves = bodies.obstacle_dynamic[:, None]
    # Robots whose faces move aside faster than they can walk come into each other's way.
    pairs = [
        team.pair_bounds[p] - added([row * offset for row, offset in zip(team.pair_rows[p], offsets, strict=True)])
        for p in range(team.pair_bounds.shape[0])
    ]
    return Rooms(
        standing=_least(jnp.where(moves, FAR, gaps)),
        moving=_least(jnp.where(moves, gaps, FAR)),
        team=reduce(jnp.minimum, pairs, jnp.full_like(gaps[0], FAR)),
    )


def robot_rooms(poses: Array, offsets: Array, places: Array, bodies: Bodies) -> Array:
    """[N_r, n] m, room of each robot's true shape to the obstacles; arguments as in `rooms_at`."""
    return jnp.stack([_least(gaps) for gaps in gaps_at(poses, offsets, places, bodies)[1:]])


def standing_room(gaps: Array, bodies: Bodies) -> Array:
    """[] m, least of the gaps [1 + N_r, N_o] between bodies that are protected and obstacles that stand."""
    protected = jnp.concatenate([bodies.protected[:1], jnp.repeat(bodies.protected[1:], gaps.shape[0] - 1)])
    return jnp.min(jnp.where(protected[:, None] & ~bodies.obstacle_dynamic, gaps, FAR))


def _least(rows: Array) -> Array:
    """[n], least of [N, n], in elementwise operations."""
    return reduce(jnp.minimum, [*rows])


def gaps_at(poses: Array, offsets: Array, places: Array, bodies: Bodies) -> Array:
    """[1 + N_r, N_o, n] m, signed distances of object and robots to the obstacles; `FAR` where there is none."""
    moving = outline(_corners(poses, offsets, bodies))
    vertices = jnp.moveaxis(bodies.obstacle_vertices, 1, 0)
    standing = outline(Vector(vertices[:, :, 0], vertices[:, :, 1]))
    # Leaves [corner, 1 + N_r, N_o, n]. As seen from the obstacles, so that their edges are computed once.
    moving, standing = (
        jax.tree.map(lambda leaf: leaf[:, :, None], moving),
        jax.tree.map(lambda leaf: leaf[:, None, :, None], standing),
    )
    seen = dataclasses.replace(moving, corner=moving.corner - Vector(places[:, 0], places[:, 1]))
    each = outline_distance(seen, standing)
    return jnp.where(bodies.obstacle_mask[:, None], each - bodies.obstacle_radius[:, None], FAR)


def _corners(poses: Array, offsets: Array, bodies: Bodies) -> Vector:
    """Corners [V, 1 + N_r, n] of object and robots; polygons of fewer corners repeat their last."""
    team = bodies.team
    point, normal = contacts(offsets, team)
    reach, length, width = (leaf[:, None] for leaf in (team.reach, team.half_length, team.half_width))
    middle = point - normal * reach
    ends, sides = normal * length, normal.turned * width
    robots = [middle - ends - sides, middle + ends - sides, middle + ends + sides, middle - ends + sides]
    footprint = side_by_side(bodies.object_vertices)
    whole = jnp.zeros_like(offsets[0])
    count = max(bodies.object_vertices.shape[0], len(robots))
    corners = []
    for v in range(count):
        own, robot = footprint[min(v, bodies.object_vertices.shape[0] - 1)], robots[min(v, len(robots) - 1)]
        corners.append(jax.tree.map(lambda a, b: jnp.concatenate([(a + whole)[None], b]), own, robot))
    every = jax.tree.map(lambda *leaves: jnp.stack(leaves), *corners)
    return every.rotated(unit(poses[2])) + vector(poses)


def side_by_side(array: Array) -> Vector:
    """Components [k, 1] of an array [k, 2], to go with poses side by side."""
    return Vector(array[:, 0, None], array[:, 1, None])


def contacts(offsets: Array, team: Team) -> tuple[Vector, Vector]:
    """Contact points [N_r, n] at offsets [N_r, n] and push directions [N_r, 1], body frame."""
    normal = side_by_side(team.normal)
    return side_by_side(team.origin) + normal.turned * offsets, normal


def slide_limits(
    pose: Array, offset: Array, places: Array, shapes: Shapes, config: PlannerConfig
) -> tuple[Array, Array]:
    """Fastest offset rates [2, N_r] m/s, downwards and upwards, with which no robot walks into an obstacle.

    Also the rates [N_r] with which those that have less than twice the margin slide to where there is more room.

    The same barrier condition as `keep_room`, on the room of each robot by itself. It is asked of single robots
    because candidates move all at once: of two robots between obstacles one would give way at the other's cost, to and
    fro.

    Args:
      pose: [3] of the object.
      offset: [N_r] m.
      places: [N_o, 2] m, of the obstacles.
      shapes: geometry.
      config: settings.
    """
    limit = shapes.team.offset_limit
    offsets = [offset, *(jnp.clip(offset + step, -limit, limit) for step in (-AHEAD, AHEAD))]
    rooms = robot_rooms(pose[:, None], jnp.stack(offsets, axis=1), places[:, :, None], bodies_of(shapes, config))
    now, then = rooms[:, 0], rooms[:, 1:].T
    closing = jnp.maximum(now - then, 0.0) / AHEAD
    rates = ROOM_RATE * jnp.maximum(now - config.safety.margin, 0.0) / jnp.maximum(closing, 1e-3)
    guarded = (config.safety.enabled > 0.5) & (config.protection.robots > 0.5)
    rates = jnp.where(guarded & (closing > 0.0), rates, jnp.inf)
    missing = jnp.maximum(2.0 * config.safety.margin - now, 0.0)
    away = ROOM_RATE * missing * jnp.sign(then[1] - then[0]) * (jnp.max(then, axis=0) > now + 0.1 * AHEAD)
    return rates, jnp.clip(away, -shapes.team.slide_speed_max, shapes.team.slide_speed_max)


def keep_room(offset: Array, rate: Array, team: Team, margin: Floats) -> Array:
    """Offset rates [N_r] nearest to `rate` under which the room between robots closes no faster than it vanishes.

    The barrier condition row @ rate <= ROOM_RATE (bound - margin - row @ offset) of each pair in turn; the margin in m.
    """
    for i in range(team.pair_bounds.shape[0]):
        row = team.pair_rows[i]
        excess = row @ rate - ROOM_RATE * (team.pair_bounds[i] - margin - row @ offset)
        rate = rate - row * jnp.maximum(excess, 0.0) / jnp.maximum(row @ row, 1.0)
    return rate
