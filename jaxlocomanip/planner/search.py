"""Obstacle-aware path of the object's pose (the paper's "incremental subgoals", which it leaves open).

Dynamic programming over a grid of poses (x, y, heading) in the goal's frame. A move goes one cell in one of 16
directions while the heading keeps or changes by one of 16 steps, or turns on the spot. Its cost is its length, more
where the object or a robot comes near an obstacle, and much more where the team, which can only push, has no wrench
for it. Obstacles that move are taken where they are predicted to be when the team gets there. The path is then traced
through the interpolated cost to go by soft-minimum descent, which treats ties symmetrically.

The path is a piecewise smooth function of its inputs, and is held fixed when gradients are taken.
"""

from __future__ import annotations

import jax
import jax.numpy as jnp
import numpy as np
from jax import Array

from jaxlocomanip.numerics import Floats, wrap_angle
from jaxlocomanip.planar.dynamics import Body
from jaxlocomanip.planar.geometry import rotate
from jaxlocomanip.planner.authority import pushability
from jaxlocomanip.planner.config import PlannerConfig
from jaxlocomanip.planner.estimation import ObstacleEstimate
from jaxlocomanip.planner.pose_grid import ANGLES, HEADINGS, TURN, Grid, clearance, interpolated, lay_grid
from jaxlocomanip.planner.shapes import Shapes
from jaxlocomanip.planner.sweeping import cost_to_go

_TRACE_STEPS = 120
_UNPUSHABLE = 15.0
"""times dearer is a move for which the team has no wrench at all"""
_EDGE = 1.5
"""weight of the neighbouring moves' unpushability: keeps away from the edge of what the team can do"""
_BLOCKED = 60.0
"""cost factor per metre of overlap with an obstacle's margin"""


def search_poses(
    start: Array, goal: Array, shapes: Shapes, obstacles: ObstacleEstimate, body: Body, config: PlannerConfig
) -> Array:
    """[_TRACE_STEPS + 2, 3] poses along the cheapest path from the pose `start` [3] to `goal` [3]."""
    given = jax.lax.stop_gradient((start, goal, shapes, obstacles, body, config))
    start, goal, shapes, obstacles, body, config = given
    turn_radius = config.reference.speed / config.reference.turn_rate
    local = jnp.concatenate([rotate(-goal[2], start[:2] - goal[:2]), wrap_angle(start[2:] - goal[2:])])
    grid = lay_grid(local)
    near = clearance(grid, local, goal, shapes, obstacles, config)
    density = 1.0 + 3.0 * jnp.maximum(config.reference.clearance - near, 0.0)
    density = density + _BLOCKED * jnp.maximum(config.constraints.margin - near, 0.0)
    moves, turns = _move_factors(shapes, body, grid.spacing)
    value = cost_to_go(grid, density, moves, turns, turn_radius)
    poses = _trace(local, grid, density, value, moves, turns, turn_radius)
    return _to_world(poses, local, goal, start)


def _move_factors(shapes: Shapes, body: Body, spacing: Array) -> tuple[Array, Array]:
    """Cost factors of moves [HEADINGS directions in the body frame, 3 turns] and of turns on the spot [2]."""
    directions = jnp.asarray(np.stack([np.cos(ANGLES), np.sin(ANGLES)], axis=1), spacing.dtype)
    turn = jnp.array([-TURN, 0.0, TURN], spacing.dtype)
    advance = 1.5 * spacing * directions
    twists = jnp.concatenate(
        [
            jnp.repeat(advance, 3, axis=0),
            jnp.tile(turn, HEADINGS)[:, None],
        ],
        axis=1,
    )
    spots = jnp.array([[0.0, 0.0, -TURN], [0.0, 0.0, TURN]], spacing.dtype)
    misfit = pushability(shapes.team, body, jnp.concatenate([twists, spots]), shapes.torsion_radius)
    table = misfit[:-2].reshape(HEADINGS, 3)
    beside = 0.5 * (jnp.roll(table, 1, axis=0) + jnp.roll(table, -1, axis=0))
    return 1.0 + _UNPUSHABLE * table + _EDGE * beside, 1.5 + _UNPUSHABLE * misfit[-2:]


def _trace(
    local: Array, grid: Grid, density: Array, value: Array, moves: Array, turns: Array, turn_radius: Floats
) -> Array:
    """[_TRACE_STEPS + 1, 3] goal-frame poses down the cost to go; the tail rests at the goal."""
    advance = grid.spacing * jnp.asarray(np.stack([np.cos(ANGLES), np.sin(ANGLES)], axis=1), local.dtype)
    sharpness = 0.5 * TURN
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
        ahead = jax.vmap(lambda p: interpolated(value, grid, p))(candidates)
        cost = price * interpolated(density, grid, pose) + ahead
        weights = jax.nn.softmax((jnp.min(cost) - cost) / softness)
        mean = weights @ change
        along = jnp.sum(weights * price) * interpolated(density, grid, pose) + interpolated(value, grid, pose + mean)
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
