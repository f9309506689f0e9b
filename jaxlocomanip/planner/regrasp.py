"""Changing the formation: where on the grid of poses the team has room to walk around the object, and at what price.

A team that can only push reaches some goals by long loops or not at all, and cannot leave a place that it was pushed
into. From other faces it pushes in other directions. The search therefore knows one more kind of move: at a pose with
room all along the walk of `formation`, the team goes over to the cost to go of the next formation.
"""

from __future__ import annotations

import jax
import jax.numpy as jnp
from jax import Array

from jaxlocomanip.formation import PHASES, circle, walk_around
from jaxlocomanip.planar.geometry import point_distance
from jaxlocomanip.planner.config import PlannerConfig
from jaxlocomanip.planner.estimation import ObstacleEstimate
from jaxlocomanip.planner.pose_grid import FAR, HEADINGS, TURN, Grid, shifted
from jaxlocomanip.planner.shapes import ROBOT_DISCS, Shapes, rectangle_discs
from jaxlocomanip.scenario import Team

PRICE = 3.0
"""m of way that a walk around the object is worth: it takes about as long"""
ROOM = 0.1
"""m, beyond all margins, that a walk is planned with: the object comes to rest near the pose, not at it"""
SAMPLES = 13
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


def walk_prices(room: Array, leaves: Team, reaches: Team, shapes: Shapes, forwards: bool, berth: Array) -> Array:
    """[HEADINGS, CELLS, CELLS] m, price of a walk at each pose; `FAR` where it has too little room.

    Args:
      room: result of `ring`.
      leaves: the team as it stands.
      reaches: and as it shall stand.
      shapes: geometry.
      forwards: counter-clockwise.
      berth: [] m, room to keep.
    """
    middle = jnp.zeros_like(leaves.offset)
    walk = walk_around(shapes.object_vertices, leaves, middle, reaches, jnp.asarray(forwards))
    first, last = jnp.minimum(walk.angle, walk.angle + walk.turn), jnp.maximum(walk.angle, walk.angle + walk.turn)
    bins = TURN * jnp.arange(HEADINGS, dtype=room.dtype)
    # A bin is swept if it lies, give or take half a bin, between a robot's first and last angle.
    since = (bins[:, None] - first + 0.5 * TURN) % (2.0 * jnp.pi)
    swept = jnp.any(since <= last - first + TURN, axis=1)

    def at_heading(turn: Array) -> Array:
        return jnp.min(jnp.where(jnp.roll(swept, turn)[:, None, None], room, FAR), axis=0)

    least = jax.lax.map(at_heading, jnp.arange(HEADINGS))
    return jnp.where(least > berth, PRICE, FAR)


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
    leaves: Team,
    reaches: Team,
    size: int,
    obstacles: ObstacleEstimate,
    config: PlannerConfig,
) -> Array:
    """[] m, least distance between robots and obstacles during a walk, beyond the filter's margin.

    Args:
      pose: [3] of the object.
      offset: [N_r] m, contact offsets now.
      now: [] int, formation now.
      wanted: [] int, formation to take.
      shapes: geometry.
      leaves: the team in the one.
      reaches: and in the other.
      size: number of formations.
      obstacles: as estimated; extrapolated at constant velocity, with a berth that grows in time.
      config: settings.
    """
    forwards = (wanted - now) % size <= size // 2
    walk = walk_around(shapes.object_vertices, leaves, offset, reaches, forwards)
    along, radii = rectangle_discs(shapes.team)

    def at(phase: Array) -> Array:
        poses = walk.poses_in_world(pose, phase)
        heading = jnp.stack([jnp.cos(poses[:, 2]), jnp.sin(poses[:, 2])], axis=-1)
        discs = (poses[:, None, :2] - along[..., None] * heading[:, None]).reshape(-1, 2)
        time = jnp.sum(walk.durations * jnp.clip(phase - jnp.arange(PHASES), 0.0, 1.0))
        places = obstacles.position + obstacles.velocity * time
        berth = jnp.where(shapes.obstacle_dynamic, config.reference.caution * time, 0.0)
        away = jax.vmap(lambda place, v, r: jax.vmap(lambda disc: point_distance(disc - place, v, r))(discs))(
            places, shapes.obstacle_vertices, shapes.obstacle_radius
        )
        away = jnp.where(shapes.obstacle_mask[:, None], away - berth[:, None], FAR)
        return jnp.min(away - jnp.repeat(radii, ROBOT_DISCS))

    least = jnp.min(jax.lax.map(at, jnp.linspace(0.0, float(PHASES), SAMPLES, dtype=pose.dtype)))
    return least - config.safety.margin
