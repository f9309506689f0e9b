"""The grid of poses (x, y, heading) in the goal's frame on which paths are searched, and what can be read off it."""

from __future__ import annotations

import jax
import jax.numpy as jnp
import numpy as np
from jax import Array

from jaxlocomanip.numerics import pytree
from jaxlocomanip.planar.geometry import quick_point_distance, rotate
from jaxlocomanip.planner.authority import usable_offsets
from jaxlocomanip.planner.config import PlannerConfig
from jaxlocomanip.planner.estimation import ObstacleEstimate
from jaxlocomanip.planner.shapes import Shapes
from jaxlocomanip.scenario import Goal

HEADINGS, DIRECTIONS = 32, 16
CELLS = 48
FAR = 1e4
"""m, or cost, of what is out of reach"""
MISS, FREE, NEAR = 60.0, 0.2, 0.6
"""m of detour that a miss by the goal's whole tolerance is worth, share of the tolerance that costs nothing, and share
within which a path may end"""
BORDER = 1.6
"""m of room around start and goal"""

_ANGLES = 2.0 * np.pi * np.arange(DIRECTIONS) / DIRECTIONS
CELL_MOVES = [
    (int(np.rint(np.cos(a) * r)), int(np.rint(np.sin(a) * r)))
    for a, r in zip(_ANGLES, [1.0, 2.2, 1.4, 2.2] * 4, strict=True)
]
"""steps of one or two cells in each of the 16 directions"""
LENGTHS = np.array([np.hypot(*move) for move in CELL_MOVES])
"""of the moves, in cells"""
TURN = 2.0 * np.pi / HEADINGS
"""rad, from one heading to the next"""
TURNS = np.arange(-2, 3)
"""by which a move may turn"""
STANDS = (-1.0, 0.0, 1.0)
"""contact offsets at which a robot's room is looked at, in multiples of the usable range"""
_REACH = 24
"""cells, largest distance of a disc from the object's body point"""


@pytree
class Grid:
    """Place and spacing of the grid; the goal lies on a node."""

    origin: Array
    """[2] m, goal-frame position of cell (0, 0)"""
    spacing: Array
    """[] m"""
    goal_cell: Array
    """[2] int"""


def lay_grid(local: Array) -> Grid:
    """The grid around the goal, at the origin, and a start [3] in the goal's frame."""
    low = jnp.minimum(local[:2], 0.0) - BORDER
    side = jnp.max(jnp.maximum(local[:2], 0.0) + BORDER - low)
    spacing = side / (CELLS - 1)
    cell = jnp.rint(-low / spacing)
    return Grid(-cell * spacing, spacing, cell.astype(jnp.int32))


def ends(grid: Grid, goal: Goal) -> Array:
    """[HEADINGS, CELLS, CELLS] m, cost of ending at each pose: that of its miss of the goal, and `FAR` off it."""
    cells = jnp.arange(CELLS)
    x, y = (grid.spacing * (cells - grid.goal_cell[i]) / goal.position_tolerance for i in range(2))
    turns = TURN * jnp.minimum(jnp.arange(HEADINGS), HEADINGS - jnp.arange(HEADINGS))
    aside, turned = jnp.sqrt(x[:, None] ** 2 + y[None, :] ** 2), turns[:, None, None] / goal.heading_tolerance
    near = jnp.maximum(aside, turned) < NEAR
    return jnp.where(near, price_of_miss(aside) + price_of_miss(turned), FAR)


def price_of_miss(miss: Array) -> Array:
    """m of detour that a miss by a share of the goal's tolerance is worth."""
    return MISS * (jnp.maximum(miss - FREE, 0.0) / (1.0 - FREE)) ** 2


def distance_field(
    grid: Grid, local: Array, goal: Array, shapes: Shapes, obstacles: ObstacleEstimate, config: PlannerConfig
) -> Array:
    """[CELLS, CELLS] m, distance of each node to the nearest obstacle, as predicted for when the team gets there."""
    ticks = jnp.arange(CELLS, dtype=local.dtype) * grid.spacing
    nodes = grid.origin + jnp.stack(jnp.meshgrid(ticks, ticks, indexing="ij"), axis=-1)
    arrival = jnp.sqrt(jnp.sum((nodes - local[:2]) ** 2, axis=-1)) / config.reference.speed
    arrival = jnp.clip(arrival, 0.0, 3.0)
    world = goal[:2] + rotate(goal[2], nodes)

    def distance(point: Array, time: Array) -> Array:
        moved = point - obstacles.position - obstacles.velocity * time
        each = jax.vmap(quick_point_distance)(moved, shapes.obstacle_vertices, shapes.obstacle_radius)
        # Nobody walks at constant velocity for long: the later the meeting, the wider the berth.
        berth = jnp.where(shapes.obstacle_dynamic, config.reference.caution * time, 0.0)
        return jnp.min(jnp.where(shapes.obstacle_mask, each - berth, FAR))

    return jax.vmap(jax.vmap(distance))(world, arrival)


def clearance(field: Array, grid: Grid, shapes: Shapes, config: PlannerConfig) -> Array:
    """[2, HEADINGS, CELLS, CELLS] m, least distance of the team's discs to any obstacle at each pose of the grid.

    First with the robots at the middles of their faces, then with each where along its face it has most room.
    """
    headings = TURN * jnp.arange(HEADINGS, dtype=field.dtype)

    def at(heading: Array, center: Array, radius: Array) -> Array:
        return shifted(field, rotate(heading, center) / grid.spacing) - radius

    def least(heading: Array, centers: Array, radii: Array) -> Array:
        return jnp.min(jax.vmap(at, in_axes=(None, 0, 0))(heading, centers, radii), axis=0)

    limit = usable_offsets(shapes.team)
    robots = jnp.stack([shapes.robot_centers(part * limit) for part in STANDS])
    radii = jnp.broadcast_to(shapes.robot_radii[:, None], robots.shape[1:3])

    def at_heading(heading: Array) -> Array:
        standing = jax.vmap(jax.vmap(least, in_axes=(None, 0, 0)), in_axes=(None, 0, None))(heading, robots, radii)
        team = jnp.min(jnp.stack([standing[STANDS.index(0.0)], jnp.max(standing, axis=0)]), axis=1)
        body = least(heading, shapes.object_centers, shapes.object_radii)
        protection = config.protection
        return jnp.minimum(jnp.where(protection.object > 0.5, body, FAR), jnp.where(protection.robots > 0.5, team, FAR))

    return jax.vmap(at_heading, out_axes=1)(headings)


def shifted(field: Array, shift: Array) -> Array:
    """field [n, n] read at index + shift [2] by bilinear interpolation, held at the border.

    The shift is the same for every node, so that one slice of the widened field and its neighbours by one are enough.
    """
    size = field.shape[0]
    low = jnp.floor(shift)
    corner = jnp.clip(_REACH + low.astype(jnp.int32), 0, 2 * _REACH - 1)
    part = shift - low
    wide = jax.lax.dynamic_slice(jnp.pad(field, _REACH, mode="edge"), (corner[0], corner[1]), (size + 1, size + 1))
    along = (1.0 - part[0]) * wide[:-1] + part[0] * wide[1:]
    return (1.0 - part[1]) * along[:, :-1] + part[1] * along[:, 1:]
