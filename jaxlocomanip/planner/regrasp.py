"""Changing the formation: where on the grid of poses the team has room to walk around the object, and at what price.

A team that can only push reaches some goals by long loops or not at all, and cannot leave a place that it was pushed
into. From other faces it pushes in other directions. The search therefore knows one more kind of move: at a pose with
room all along the walk of `formation`, the team goes over to the cost to go of the next formation.
"""

from __future__ import annotations

import jax
import jax.numpy as jnp
from jax import Array

from jaxlocomanip.formation import PHASES, circle, count, team_in, walk_around
from jaxlocomanip.numerics import Floats
from jaxlocomanip.planar.geometry import polygon_distance, rectangle
from jaxlocomanip.planner.config import PlannerConfig
from jaxlocomanip.planner.estimation import ObstacleEstimate
from jaxlocomanip.planner.keeping import ROUNDING
from jaxlocomanip.planner.pose_grid import FAR, HEADINGS, TURN, Grid, shifted
from jaxlocomanip.planner.shapes import ROBOT_DISCS, Shapes, rectangle_discs
from jaxlocomanip.scenario import Formations

PRICE, AGAIN = 3.0, 1.0
"""m of way that a walk around the object is worth, since it takes about as long, and how much more with every one that
the team has made: lest it goes to and fro between two formations of which each promises more than it keeps"""
ROOM = 0.1
"""m, beyond all margins, that a walk is planned with: the object comes to rest near the pose, not at it"""
YIELD, CLOSEST = 0.005, 0.015
"""m, that robots in a tight place may come closer when they leave it, and where that ends: each walk would take some"""
SAMPLES = 16
"""instants of a walk at which its room is looked at"""
POSITION_TOLERANCE, HEADING_TOLERANCE = 0.1, 0.25
"""m and rad, of where the team walks around the object: a miss changes little"""


def ring(field: Array, grid: Grid, shapes: Shapes) -> Array:
    """[HEADINGS, CELLS, CELLS] m, room of a robot that circles, at polar angles (goal frame) of TURN each.

    Args:
      field: [CELLS, CELLS] m, distance of each node to the obstacles.
      grid: its place.
      shapes: geometry and team.
    """
    _, radius = circle(shapes.object_vertices, shapes.team)
    along, radii = rectangle_discs(shapes.team)
    discs = (radius[:, None] + along).reshape(-1)
    sizes = jnp.repeat(radii, ROBOT_DISCS)

    def at(angle: Array) -> Array:
        direction = jnp.stack([jnp.cos(angle), jnp.sin(angle)])
        each = jax.vmap(lambda r, size: shifted(field, r * direction / grid.spacing) - size)(discs, sizes)
        return jnp.min(each, axis=0)

    return jax.lax.map(at, TURN * jnp.arange(HEADINGS, dtype=field.dtype))


def may_walk(room: Array, now: Array, wanted: Array, shapes: Shapes, formations: Formations, berth: Array) -> Array:
    """[HEADINGS, CELLS, CELLS] bool, at which poses there is room for a walk.

    Args:
      room: result of `ring`.
      now: [] int, formation that the team has there.
      wanted: [] int, and the one that it shall take.
      shapes: geometry, and the team in its first formation.
      formations: the other ones.
      berth: [] m, room to keep.
    """
    size = count(formations)
    leaves, reaches = (team_in(shapes.team, formations, k) for k in (now, wanted))
    middle = jnp.zeros_like(leaves.offset)
    walk = walk_around(shapes.object_vertices, leaves, middle, reaches, now, wanted, size)
    first, last = jnp.minimum(walk.angle, walk.angle + walk.turn), jnp.maximum(walk.angle, walk.angle + walk.turn)
    bins = TURN * jnp.arange(HEADINGS, dtype=room.dtype)
    # A bin is swept if it lies, give or take half a bin, between a robot's first and last angle.
    since = (bins[:, None] - first + 0.5 * TURN) % (2.0 * jnp.pi)
    swept = jnp.any(since <= last - first + TURN, axis=1)

    def at_heading(turn: Array) -> Array:
        return jnp.min(jnp.where(jnp.roll(swept, turn)[:, None, None], room, FAR), axis=0)

    least = jax.lax.map(at_heading, jnp.arange(HEADINGS))
    return least > berth


def order(size: int) -> list[int]:
    """Formations, relative to the present one, in the order in which the search looks at them.

    Itself first, then the farthest ones, whose costs the nearer ones build on, and itself again.
    """
    others = sorted(range(1, size), key=lambda k: -min(k, size - k))
    return [0, *others, 0] if others else [0]


def room_to_walk(
    pose: Array,
    offset: Array,
    now: Array,
    wanted: Array,
    shapes: Shapes,
    formations: Formations,
    obstacles: ObstacleEstimate,
    config: PlannerConfig,
) -> Array:
    """[] m, least distance between the robots' bodies and obstacles during a walk, beyond what has to be kept.

    That is the filter's margin, or nearly what there is at the beginning if that is less: robots that stand in a tight
    place may leave it.

    Args:
      pose: [3] of the object.
      offset: [N_r] m, contact offsets now.
      now: [] int, formation now.
      wanted: [] int, formation to take.
      shapes: geometry, and the team in its first formation.
      formations: the other ones.
      obstacles: as estimated; where they are and where they would be at constant velocity, with a berth that grows in
        time, the faster the less is known of their velocities.
      config: settings.
    """
    size = count(formations)
    leaves, reaches = (team_in(shapes.team, formations, k) for k in (now, wanted))
    walk = walk_around(shapes.object_vertices, leaves, offset, reaches, now, wanted, size)
    # At first their velocities are not known at all; a walk in the first tick ended in somebody who came along.
    unsure = jnp.sqrt(obstacles.covariance[:, 2])

    def at(phase: Array) -> Array:
        bodies = jax.vmap(rectangle)(walk.poses_in_world(pose, phase), leaves.half_length, leaves.half_width)
        time = jnp.sum(walk.durations * jnp.clip(phase - jnp.arange(PHASES), 0.0, 1.0))
        # One that goes away may come back: a walk cannot be broken off.
        places = jnp.stack([obstacles.position, obstacles.position + obstacles.velocity * time], axis=1)
        berth = jnp.where(shapes.obstacle_dynamic, (config.reference.caution + unsure) * time, 0.0)

        def from_obstacles(body: Array) -> Array:
            def from_one(places: Array, vertices: Array, radius: Array) -> Array:
                return jnp.min(jax.vmap(lambda place: polygon_distance(body, 0.0, place + vertices, radius))(places))

            each = jax.vmap(from_one)(places, shapes.obstacle_vertices, shapes.obstacle_radius)
            return jnp.min(jnp.where(shapes.obstacle_mask, each - berth, FAR))

        return jnp.min(jax.vmap(from_obstacles)(bodies))

    rooms = jax.lax.map(at, jnp.linspace(0.0, float(PHASES), SAMPLES, dtype=pose.dtype))
    return jnp.min(rooms) - asked_of_a_walk(rooms[0], config.safety.margin)


def asked_of_a_walk(room: Array, margin: Floats) -> Array:
    """[] m, room that a walk has to keep if it begins with so much."""
    tight = jnp.maximum(room - YIELD, jnp.minimum(room - ROUNDING, CLOSEST))
    return jnp.minimum(margin, tight)
