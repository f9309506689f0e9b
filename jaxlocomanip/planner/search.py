"""Obstacle-aware path of the object's pose (the paper's "incremental subgoals", which it leaves open).

Dynamic programming over a grid of poses (x, y, heading) in the goal's frame. A move goes one cell in one of 16
directions while the heading keeps or changes by one of 16 steps, or turns on the spot. Its cost is its length, more
where the object or a robot comes near an obstacle, and much more where the team, which can only push, has no wrench
for it. Obstacles that move are taken where they are predicted to be when the team gets there. What comes out says
which way around the obstacles and whether to take a loop; `refine` makes a path of it that can be pushed.

The path is a piecewise smooth function of its inputs, and is held fixed when gradients are taken.
"""

from __future__ import annotations

import jax
import jax.numpy as jnp
from jax import Array

from jaxlocomanip.numerics import wrap_angle
from jaxlocomanip.planar.dynamics import Body
from jaxlocomanip.planar.geometry import rotate
from jaxlocomanip.planner.config import PlannerConfig
from jaxlocomanip.planner.descent import STEPS, descend
from jaxlocomanip.planner.estimation import ObstacleEstimate
from jaxlocomanip.planner.moves import price_moves
from jaxlocomanip.planner.pose_grid import clearance, ends, lay_grid
from jaxlocomanip.planner.shapes import Shapes
from jaxlocomanip.planner.sweeping import cost_to_go
from jaxlocomanip.scenario import Goal

ROUGH = STEPS + 2
"""poses of a searched path"""
_BLOCKED = 60.0
"""cost factor per metre of overlap with twice an obstacle's margin: where the filter would keep stopping the team"""
_THICKNESS = 0.03
"""m, by which discs reach beyond the bodies that they cover: overlaps larger than that are real, and cost more, unless
robots can avoid them at other contact offsets"""


def search_poses(
    start: Array, target: Goal, shapes: Shapes, obstacles: ObstacleEstimate, body: Body, config: PlannerConfig
) -> Array:
    """[ROUGH, 3] poses along the cheapest path on the grid from the pose `start` [3] to a goal, where they stay."""
    given = jax.lax.stop_gradient((start, target, shapes, obstacles, body, config))
    start, target, shapes, obstacles, body, config = given
    goal = target.pose
    turn_radius = config.reference.turn_radius
    local = jnp.concatenate([rotate(-goal[2], start[:2] - goal[:2]), wrap_angle(start[2:] - goal[2:])])
    grid = lay_grid(local)
    near, widest = clearance(grid, local, goal, shapes, obstacles, config)
    density = 1.0 + 3.0 * jnp.maximum(config.reference.clearance - near, 0.0)
    tight, overlap = (jnp.maximum(2.0 * config.constraints.margin - room, 0.0) for room in (near, widest))
    density = density + _BLOCKED * (tight + overlap**2 / _THICKNESS)
    moves = price_moves(shapes, body, grid.spacing, turn_radius)
    ending = ends(grid, target) + grid.spacing * (density - 1.0)
    value = cost_to_go(ending, density, moves)
    poses = descend(local, grid, value, ending, density, moves, shapes, body, turn_radius)
    heading = start[2] + poses[:, 2:] - local[2]
    return jnp.concatenate([goal[:2] + rotate(goal[2], poses[:, :2]), heading], axis=1)
