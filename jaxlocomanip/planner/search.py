"""Obstacle-aware path of the object's pose (the paper's "incremental subgoals", which it leaves open).

Dynamic programming over a grid of poses (x, y, heading) in the goal's frame. A move goes one cell in one of 16
directions while the heading keeps or changes by one of 16 steps, or turns on the spot. Its cost is its length, more
where the object or a robot comes near an obstacle, and much more where the team, which can only push, has no wrench
for it. Obstacles that move are taken where they are predicted to be when the team gets there. All counts are fixed,
so the search batches; the path is then traced through the interpolated cost to go by soft-minimum descent, which
treats ties symmetrically.

The path is a piecewise smooth function of its inputs, and is held fixed when gradients are taken.
"""

from __future__ import annotations

import jax
import jax.numpy as jnp
import numpy as np
from jax import Array

from jaxlocomanip.numerics import Floats, pytree, wrap_angle
from jaxlocomanip.planar.dynamics import Body
from jaxlocomanip.planar.geometry import point_distance, rotate
from jaxlocomanip.planner.authority import pushability
from jaxlocomanip.planner.config import PlannerConfig
from jaxlocomanip.planner.estimation import ObstacleEstimate
from jaxlocomanip.planner.shapes import Shapes

HEADINGS = 16
CELLS = 48
_TRACE_STEPS = 120
_SWEEPS = 120
"""at most; the sweeps stop once no cost changes"""
_BORDER = 1.6
"""m of room around start and goal"""
_UNPUSHABLE = 15.0
"""times dearer is a move for which the team has no wrench at all"""
_EDGE = 1.5
"""weight of the neighbouring moves' unpushability: keeps away from the edge of what the team can do"""
_BLOCKED = 60.0
"""cost factor per metre of overlap with an obstacle's margin"""
_FAR = 1e4

_ANGLES = 2.0 * np.pi * np.arange(HEADINGS) / HEADINGS
_CELL_MOVES = [
    (int(np.rint(np.cos(a) * r)), int(np.rint(np.sin(a) * r)))
    for a, r in zip(_ANGLES, [1.0, 2.2, 1.4, 2.2] * 4, strict=True)
]
_LENGTHS = np.array([np.hypot(*move) for move in _CELL_MOVES])
_TURN = 2.0 * np.pi / HEADINGS


@pytree
class _Grid:
    origin: Array
    """[2] m, goal-frame position of cell (0, 0)"""
    spacing: Array
    """[] m"""
    goal_cell: Array
    """[2] int"""


def search_poses(
    start: Array, goal: Array, shapes: Shapes, obstacles: ObstacleEstimate, body: Body, config: PlannerConfig
) -> Array:
    """[_TRACE_STEPS + 2, 3] poses along the cheapest path from the pose `start` [3] to `goal` [3]."""
    start, goal, obstacles, body = jax.lax.stop_gradient((start, goal, obstacles, body))
    turn_radius = config.reference.speed / config.reference.turn_rate
    local = jnp.concatenate([rotate(-goal[2], start[:2] - goal[:2]), wrap_angle(start[2:] - goal[2:])])
    grid = _grid(local)
    near = _clearance(grid, local, goal, shapes, obstacles, config)
    density = 1.0 + 3.0 * jnp.maximum(config.reference.clearance - near, 0.0)
    density = density + _BLOCKED * jnp.maximum(config.constraints.margin - near, 0.0)
    moves, turns = _move_factors(shapes, body, grid.spacing)
    value = _cost_to_go(grid, density, moves, turns, turn_radius)
    poses = _trace(local, grid, density, value, moves, turns, turn_radius)
    return _to_world(poses, local, goal, start)


def _grid(local: Array) -> _Grid:
    low = jnp.minimum(local[:2], 0.0) - _BORDER
    side = jnp.max(jnp.maximum(local[:2], 0.0) + _BORDER - low)
    spacing = side / (CELLS - 1)
    cell = jnp.rint(-low / spacing)
    return _Grid(-cell * spacing, spacing, cell.astype(jnp.int32))


def _clearance(
    grid: _Grid, local: Array, goal: Array, shapes: Shapes, obstacles: ObstacleEstimate, config: PlannerConfig
) -> Array:
    """[HEADINGS, CELLS, CELLS] m, least distance of the team's discs to any obstacle at each pose of the grid."""
    ticks = jnp.arange(CELLS, dtype=local.dtype) * grid.spacing
    nodes = grid.origin + jnp.stack(jnp.meshgrid(ticks, ticks, indexing="ij"), axis=-1)
    arrival = jnp.sqrt(jnp.sum((nodes - local[:2]) ** 2, axis=-1)) / config.reference.speed
    arrival = jnp.clip(arrival, 0.0, 3.0)
    world = goal[:2] + rotate(goal[2], nodes)

    def distance(point: Array, time: Array) -> Array:
        moved = point - obstacles.position - obstacles.velocity * time
        each = jax.vmap(point_distance)(moved, shapes.obstacle_vertices, shapes.obstacle_radius)
        # Nobody walks at constant velocity for long: the later the meeting, the wider the berth.
        berth = jnp.where(shapes.obstacle_dynamic, config.reference.caution * time, 0.0)
        return jnp.min(jnp.where(shapes.obstacle_mask, each - berth, _FAR))

    field = jax.vmap(jax.vmap(distance))(world, arrival)
    headings = jnp.asarray(_ANGLES, local.dtype)

    def at(heading: Array, center: Array, radius: Array, used: Array) -> Array:
        shift = rotate(heading, center) / grid.spacing
        return jnp.where(used > 0.5, _shifted(field, shift) - radius, _FAR)

    discs = shapes.protected_discs(config)
    over_discs = jax.vmap(at, in_axes=(None, 0, 0, 0))
    each = jax.vmap(over_discs, in_axes=(0, None, None, None))(headings, discs.centers, discs.radii, discs.used)
    return jnp.min(each, axis=1)


def _shifted(field: Array, shift: Array) -> Array:
    """field [n, n] read at index + shift by bilinear interpolation, held at the border."""
    size = field.shape[0]
    index = jnp.arange(size, dtype=field.dtype)

    def rows(values: Array, offset: Array) -> Array:
        where = jnp.clip(index + offset, 0.0, size - 1.0)
        low = jnp.minimum(where.astype(jnp.int32), size - 2)
        part = (where - low)[:, None]
        return (1.0 - part) * values[low] + part * values[low + 1]

    return rows(rows(field, shift[0]).T, shift[1]).T


def _move_factors(shapes: Shapes, body: Body, spacing: Array) -> tuple[Array, Array]:
    """Cost factors of moves [HEADINGS directions in the body frame, 3 turns] and of turns on the spot [2]."""
    directions = jnp.asarray(np.stack([np.cos(_ANGLES), np.sin(_ANGLES)], axis=1), spacing.dtype)
    turn = jnp.array([-_TURN, 0.0, _TURN], spacing.dtype)
    advance = 1.5 * spacing * directions
    twists = jnp.concatenate(
        [
            jnp.repeat(advance, 3, axis=0),
            jnp.tile(turn, HEADINGS)[:, None],
        ],
        axis=1,
    )
    spots = jnp.array([[0.0, 0.0, -_TURN], [0.0, 0.0, _TURN]], spacing.dtype)
    misfit = pushability(shapes.team, body, jnp.concatenate([twists, spots]), shapes.torsion_radius)
    table = misfit[:-2].reshape(HEADINGS, 3)
    beside = 0.5 * (jnp.roll(table, 1, axis=0) + jnp.roll(table, -1, axis=0))
    return 1.0 + _UNPUSHABLE * table + _EDGE * beside, 1.5 + _UNPUSHABLE * misfit[-2:]


def _cost_to_go(grid: _Grid, density: Array, moves: Array, turns: Array, turn_radius: Floats) -> Array:
    """[HEADINGS, CELLS, CELLS] cost from each pose to the goal, by a fixed number of min-plus sweeps."""
    index = jnp.arange(CELLS)
    at_goal = (index[:, None] == grid.goal_cell[0]) & (index[None, :] == grid.goal_cell[1])
    goal = at_goal[None] & (jnp.arange(HEADINGS) == 0)[:, None, None]
    start = jnp.where(goal, 0.0, jnp.full(density.shape, _FAR, density.dtype))
    heading = np.arange(HEADINGS)
    spot = turn_radius * _TURN * turns
    costs = []
    for m in range(HEADINGS):
        relative = (m - heading) % HEADINGS
        straight = _LENGTHS[m] * grid.spacing
        bent = jnp.sqrt(straight**2 + (turn_radius * _TURN) ** 2)
        lengths = jnp.stack([bent, straight, bent])
        costs.append(moves[relative] * lengths)

    def sweep(carry: tuple[Array, Array, Array]) -> tuple[Array, Array, Array]:
        count, value, _ = carry
        turned = [jnp.roll(value, 1, axis=0), value, jnp.roll(value, -1, axis=0)]
        best = jnp.minimum(spot[0] * density + turned[0], spot[1] * density + turned[2])
        padded = [jnp.pad(v, ((0, 0), (2, 2), (2, 2)), constant_values=_FAR) for v in turned]
        for m, (i, j) in enumerate(_CELL_MOVES):
            for t in range(3):
                neighbour = padded[t][:, 2 + i : 2 + i + CELLS, 2 + j : 2 + j + CELLS]
                best = jnp.minimum(best, costs[m][:, t, None, None] * density + neighbour)
        best = jnp.where(goal, 0.0, jnp.minimum(best, value))
        return count + 1, best, jnp.max(value - best)

    def unsettled(carry: tuple[Array, Array, Array]) -> Array:
        return (carry[0] < _SWEEPS) & (carry[2] > 1e-3)

    first = (jnp.zeros((), jnp.int32), start, jnp.full((), _FAR, density.dtype))
    return jax.lax.while_loop(unsettled, sweep, first)[1]


def _interpolated(value: Array, grid: _Grid, pose: Array) -> Array:
    """Trilinear value at a goal-frame pose [3]; headings wrap."""
    cell = jnp.clip((pose[:2] - grid.origin) / grid.spacing, 0.0, CELLS - 1.001)
    low = cell.astype(jnp.int32)
    part = cell - low
    bins = pose[2] / _TURN
    lower = jnp.floor(bins)
    turn = bins - lower
    k = lower.astype(jnp.int32) % HEADINGS

    def plane(h: Array) -> Array:
        corner = jax.lax.dynamic_slice(value, (h, low[0], low[1]), (1, 2, 2))[0]
        along = (1.0 - part[0]) * corner[0] + part[0] * corner[1]
        return (1.0 - part[1]) * along[0] + part[1] * along[1]

    return (1.0 - turn) * plane(k) + turn * plane((k + 1) % HEADINGS)


def _trace(
    local: Array, grid: _Grid, density: Array, value: Array, moves: Array, turns: Array, turn_radius: Floats
) -> Array:
    """[_TRACE_STEPS + 1, 3] goal-frame poses down the cost to go; the tail rests at the goal."""
    advance = grid.spacing * jnp.asarray(np.stack([np.cos(_ANGLES), np.sin(_ANGLES)], axis=1), local.dtype)
    sharpness = 0.5 * _TURN
    steps_B = jnp.concatenate([jnp.repeat(advance, 3, axis=0), jnp.zeros((2, 2), local.dtype)])
    angle = sharpness * jnp.concatenate(
        [jnp.tile(jnp.array([-1.0, 0.0, 1.0], local.dtype), HEADINGS), jnp.array([-1.0, 1.0], local.dtype)]
    )
    length = jnp.sqrt(jnp.sum(steps_B**2, axis=1) + (turn_radius * angle) ** 2)
    price = length * jnp.concatenate([moves.reshape(-1), turns])
    softness = 0.15 * grid.spacing

    def step(pose: Array, _: None) -> tuple[Array, Array]:
        change = jnp.concatenate([rotate(pose[2] + 0.5 * angle, steps_B), angle[:, None]], axis=1)
        candidates = pose + change
        ahead = jax.vmap(lambda p: _interpolated(value, grid, p))(candidates)
        cost = price * _interpolated(density, grid, pose) + ahead
        weights = jax.nn.softmax((jnp.min(cost) - cost) / softness)
        mean = weights @ change
        along = jnp.sum(weights * price) * _interpolated(density, grid, pose) + _interpolated(value, grid, pose + mean)
        # Where the cost to go is concave, as between two equal ways around an obstacle, the mean of the best moves is
        # worse than each of them: then one is taken.
        ridge = along > weights @ cost + 0.01 * grid.spacing
        move = jnp.where(ridge, change[jnp.argmin(cost)], mean)
        rest = jnp.concatenate([pose[:2], wrap_angle(pose[2:])])
        remaining = jnp.sqrt(jnp.sum(rest[:2] ** 2) + (turn_radius * rest[2]) ** 2)
        move = jnp.where(remaining < 1.2 * grid.spacing, -rest, move)
        return pose + move, pose + move

    _, poses = jax.lax.scan(step, local, None, length=_TRACE_STEPS)
    return jnp.concatenate([local[None], poses])


def _to_world(poses: Array, local: Array, goal: Array, start: Array) -> Array:
    """Goal-frame poses in the world, ending exactly at the goal, with headings continuous from the start's."""
    end = jnp.concatenate([jnp.zeros(2, poses.dtype), poses[-1:, 2] - wrap_angle(poses[-1:, 2])])
    closed = jnp.concatenate([poses, end[None]])
    heading = start[2] + closed[:, 2:] - local[2]
    return jnp.concatenate([goal[:2] + rotate(goal[2], closed[:, :2]), heading], axis=1)
