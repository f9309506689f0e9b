"""The grid of poses (x, y, heading) in the goal's frame on which paths are searched, and what can be read off it."""

from __future__ import annotations

from functools import reduce

import jax
import jax.numpy as jnp
import numpy as np
from jax import Array

from jaxlocomanip.formation import circle
from jaxlocomanip.numerics import apart, larger, pytree, safe_norm, smaller
from jaxlocomanip.planar.geometry import Outline, outline, quick_distance, rotate
from jaxlocomanip.planar.vector import Vector, vectors
from jaxlocomanip.planner.authority import usable_offsets
from jaxlocomanip.planner.config import PlannerConfig
from jaxlocomanip.planner.estimation import PREDICTED, ObstacleEstimate
from jaxlocomanip.planner.shapes import Shapes, rectangle_discs
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


def lay_grid(local: Array, extent: Array) -> Grid:
    """The grid around the goal, at the origin, and a start [3] in the goal's frame, for bodies of an `extent`, [] m."""
    low = jnp.minimum(local[:2], 0.0) - BORDER
    side = jnp.max(jnp.maximum(local[:2], 0.0) + BORDER - low)
    spacing = jnp.maximum(side / (CELLS - 1), extent / (_REACH - 1))
    cell = jnp.rint(-low / spacing)
    return Grid(-cell * spacing, spacing, cell.astype(jnp.int32))


def extent(shapes: Shapes) -> Array:
    """[] m, distance from the object's body point to the farthest of all discs, wherever robots stand or walk."""
    _, circles = circle(shapes.object_vertices, shapes.team)
    along, _ = rectangle_discs(shapes.team)
    ends = [shapes.robot_centers(part * shapes.team.offset_limit).reshape(-1, 2) for part in STANDS]
    standing = jnp.max(safe_norm(jnp.concatenate([shapes.object_centers, *ends])))
    return jnp.maximum(standing, jnp.max(circles[:, None] + along))


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
    arrival = jnp.clip(arrival, 0.0, PREDICTED)
    world = goal[:2] + rotate(goal[2], nodes)
    edges = outline(vectors(jnp.swapaxes(shapes.obstacle_vertices, 0, 1)[..., None, None, :]))
    return _field(vectors(world), arrival, edges, shapes, obstacles, config)


def clearance(field: Array, grid: Grid, shapes: Shapes, config: PlannerConfig) -> Array:
    """[2, HEADINGS, CELLS, CELLS] m, least distance of the team's discs to any obstacle at each pose of the grid.

    First with the robots at the middles of their faces, then with each where along its face it has most room.
    """
    headings = TURN * jnp.arange(HEADINGS, dtype=field.dtype)
    limit = usable_offsets(shapes.team)
    # Discs in groups, of which the least distance counts: the object's, then each robot's at each of its stands.
    robots = jnp.stack([shapes.robot_centers(part * limit) for part in STANDS], axis=1)
    groups = [(shapes.object_centers, shapes.object_radii)]
    groups += [
        (centers, jnp.broadcast_to(radius, centers.shape[:1]))
        for stands, radius in zip(robots, shapes.robot_radii, strict=True)
        for centers in stands
    ]
    protected = config.protection.object > 0.5, config.protection.robots > 0.5

    def at_heading(wide: Array, heading: Array) -> tuple[Array, Array]:
        room = [_room(_windows(wide, rotate(heading, centers) / grid.spacing), radii) for centers, radii in groups]
        body = jnp.where(protected[0], room[0], FAR)
        return wide, _least_and_widest(body, [jnp.where(protected[1], one, FAR) for one in room[1:]])

    # One heading after the other: side by side each disc's part of the field would be gathered number by number.
    return jnp.swapaxes(jax.lax.scan(at_heading, jnp.pad(field, _REACH, mode="edge"), headings)[1], 0, 1)


@apart
def _field(
    point: Vector, time: Array, edges: Outline, shapes: Shapes, obstacles: ObstacleEstimate, config: PlannerConfig
) -> Array:
    """[n, n] m, distance of points [n, n] to the nearest obstacle as it is predicted at times [n, n] s."""
    places = obstacles.position[..., None, None] + obstacles.velocity[..., None, None] * time
    moved = Vector(point.x - places[:, 0], point.y - places[:, 1])
    each = quick_distance(moved, edges) - shapes.obstacle_radius[:, None, None]
    # Nobody walks at constant velocity for long: the later the meeting, the wider the berth.
    berth = jnp.where(shapes.obstacle_dynamic[:, None, None], config.reference.caution * time, 0.0)
    return reduce(smaller, [*jnp.where(shapes.obstacle_mask[:, None, None], each - berth, FAR)])


def shifted(field: Array, shift: Array) -> Array:
    """field [n, n] read at index + shift [2] by bilinear interpolation, held at the border.

    The shift is the same for every node, so that one part of the widened field and its neighbours by one are enough.
    """
    ((near, part),) = _windows(jnp.pad(field, _REACH, mode="edge"), shift[None])
    return _interpolated(near, part)


def _interpolated(near: Array, part: Array) -> Array:
    """[n, n] of [n + 1, n + 1], between each number and its neighbours."""
    along = near[:-1] + part[0] * (near[1:] - near[:-1])
    return along[:, :-1] + part[1] * (along[:, 1:] - along[:, :-1])


@apart
def _windows(wide: Array, shifts: Array) -> list[tuple[Array, Array]]:
    """The parts [n + 1, n + 1] of a widened field that begin at shifts [D, 2], and what is left of these, [2]."""
    found = []
    for shift in shifts:
        low = jnp.floor(shift)
        corner = jnp.clip(_REACH + low.astype(jnp.int32), 0, 2 * _REACH - 1)
        size = wide.shape[0] - 2 * _REACH + 1
        found.append((jax.lax.dynamic_slice(wide, (corner[0], corner[1]), (size, size)), shift - low))
    return found


@apart
def _room(windows: list[tuple[Array, Array]], radii: Array) -> Array:
    """[n, n] m, least distance of discs of these radii, of their windows."""
    rooms = [_interpolated(*window) - radius for window, radius in zip(windows, radii, strict=True)]
    return reduce(smaller, rooms)


@apart
def _least_and_widest(body: Array, robots: list[Array]) -> Array:
    """[2, n, n] m, room of the team with robots at the middles of their faces, and where each has most room."""
    middle, count = STANDS.index(0.0), len(STANDS)
    widest = [reduce(larger, robots[k : k + count]) for k in range(0, len(robots), count)]
    return jnp.stack([reduce(smaller, robots[middle::count], body), reduce(smaller, widest, body)])
