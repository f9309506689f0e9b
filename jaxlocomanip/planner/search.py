"""Obstacle-aware path of the object's pose (the paper's "incremental subgoals", which it leaves open).

Dynamic programming over a grid of poses (x, y, heading) in the goal's frame. A move goes one cell in one of 16
directions while the heading keeps or changes by one of 16 steps, or turns on the spot. Its cost is its length, more
where the object or a robot comes near an obstacle, and much more where the team, which can only push, has no wrench
for it. Obstacles that move are taken where they are predicted to be when the team gets there. What comes out says
which way around the obstacles, whether to take a loop, and whether to walk around the object to other faces on the
way (`regrasp`); `refine` makes a path of it that can be pushed.

The path is a piecewise smooth function of its inputs, and is held fixed when gradients are taken.
"""

from __future__ import annotations

import dataclasses
from typing import Any

import jax
import jax.numpy as jnp
from jax import Array

from jaxlocomanip.formation import count, team_in, usable
from jaxlocomanip.lanes import where_needed
from jaxlocomanip.numerics import pytree, safe_norm, select, wrap_angle
from jaxlocomanip.planar.dynamics import Body
from jaxlocomanip.planar.geometry import rotate
from jaxlocomanip.planner.config import PlannerConfig
from jaxlocomanip.planner.descent import STEPS, descend, first_node
from jaxlocomanip.planner.estimation import ObstacleEstimate
from jaxlocomanip.planner.moves import Moves, price_moves
from jaxlocomanip.planner.path import Aim, at_goal
from jaxlocomanip.planner.pose_grid import (
    CELLS,
    DIRECTIONS,
    FAR,
    HEADINGS,
    TURNS,
    Grid,
    clearance,
    distance_field,
    ends,
    extent,
    lay_grid,
)
from jaxlocomanip.planner.regrasp import (
    AGAIN,
    HEADING_TOLERANCE,
    POSITION_TOLERANCE,
    PRICE,
    ROOM,
    may_walk,
    order,
    ring,
    room_to_walk,
)
from jaxlocomanip.planner.shapes import Shapes
from jaxlocomanip.planner.sweeping import cost_to_go
from jaxlocomanip.scenario import Formations, Goal

ROUGH = STEPS + 2
"""poses of a searched path"""
_BLOCKED = 60.0
"""cost factor per metre of overlap with twice an obstacle's margin: where the filter would keep stopping the team"""
_THICKNESS = 0.03
"""m, by which discs reach beyond the bodies that they cover: overlaps larger than that are real, and cost more, unless
robots can avoid them at other contact offsets"""
_STUCK = 6.0
"""m of detour that a team that does not get on would make to leave by other faces"""


@pytree
class Query:
    """What is searched for."""

    start: Array
    """[3] pose"""
    offset: Array
    """[N_r] m, contact offsets"""
    goal: Goal
    now: Array
    """[] int, formation"""
    stuck: Array
    """[] bool: the team does not get on in its formation"""
    wide: Array
    """[] bool: other formations may be looked at"""
    berth: Array
    """[] m, room that walks around the object keep beyond the usual"""
    walks: Array
    """[] int, made so far"""

    @property
    def price(self) -> Array:
        """[] m of way that a walk is worth."""
        return PRICE + AGAIN * self.walks


@pytree
class Found:
    """A rough path."""

    poses: Array
    """[ROUGH, 3], the last one repeated"""
    aim: Aim


@pytree
class Landscape:
    """The grid as one formation sees it; leaves [HEADINGS, CELLS, CELLS] but for the moves."""

    density: Array
    """cost of a unit of length"""
    moves: Moves
    stop: Array
    """cost of ending at the goal's pose"""
    walks: Array
    """[2, ...] cost of walking on by a face, forwards or backwards, and of what comes after"""
    value: Array
    """cost to go"""
    first: Array
    """[3] node at which a path from the start begins"""
    cost: Array
    """[] of that path"""

    @property
    def ending(self) -> Array:
        """Cost of ending, one way or another."""
        return jnp.minimum(self.stop, jnp.min(self.walks, axis=0))


def search_poses(
    query: Query,
    shapes: Shapes,
    formations: Formations,
    obstacles: ObstacleEstimate,
    body: Body,
    config: PlannerConfig,
) -> Found:
    """The cheapest path on the grid from a pose to a goal, or to where the team had better walk to other faces.

    Args:
      query: from where to where.
      shapes: geometry, and the team in its first formation.
      formations: the other ones.
      obstacles: as estimated.
      body: the object as estimated.
      config: settings.
    """
    query, shapes, formations, obstacles, body, config = jax.lax.stop_gradient(
        (query, shapes, formations, obstacles, body, config)
    )
    start, goal = query.start, query.goal.pose
    local = jnp.concatenate([rotate(-goal[2], start[:2] - goal[:2]), wrap_angle(start[2:] - goal[2:])])
    grid = lay_grid(local, extent(shapes))
    land, costs = survey(local, grid, query, shapes, formations, obstacles, body, config)
    poses, last = descend(local, land.first, grid, land.value, land.ending, land.density, land.moves)
    heading = start[2] + poses[:, 2:] - local[2]
    poses = jnp.concatenate([goal[:2] + rotate(goal[2], poses[:, :2]), heading], axis=1)
    if count(formations) == 1:
        return Found(poses, at_goal(query.goal, query.now))
    at_once = _walks_at_once(query, costs, shapes, formations, obstacles, config)
    stays = jnp.min(at_once) <= land.cost + jnp.where(query.stuck, _STUCK, 0.0)
    walks = jnp.where(stays, at_once, land.walks[:, *last])
    stop, poses = jnp.where(stays, FAR, land.stop[*last]), jnp.where(stays, start, poses)
    return Found(poses, _aim(query, poses[-1], stop, walks, count(formations)))


def _walks_at_once(
    query: Query,
    costs: Array,
    shapes: Shapes,
    formations: Formations,
    obstacles: ObstacleEstimate,
    config: PlannerConfig,
) -> Array:
    """[2] cost of walking on by a face from where the object is, forwards or backwards.

    By the room that there is and what other formations can do from the very pose: from the nearest node, two of them
    may each take the other for the better one.
    """

    def one(on: Array) -> Array:
        to = (query.now + on) % costs.shape[0]
        room = room_to_walk(query.start, query.offset, query.now, to, shapes, formations, obstacles, config)
        return jnp.where(room > 0.0, query.price + costs[to], FAR)

    return jax.lax.map(one, jnp.array([1, -1]))


def _aim(query: Query, end: Array, stop: Array, walks: Array, size: int) -> Aim:
    """Where a path that ends at a pose [3] leads, by the costs of ending there."""
    on = jnp.where(walks[0] <= walks[1], 1, -1)
    tolerances = jnp.asarray(POSITION_TOLERANCE, end.dtype), jnp.asarray(HEADING_TOLERANCE, end.dtype)
    walk = Aim(Goal(end, *tolerances), (query.now + on) % size, jnp.min(walks))
    return select(jnp.min(walks) < stop, walk, at_goal(query.goal, query.now))


def survey(
    local: Array,
    grid: Grid,
    query: Query,
    shapes: Shapes,
    formations: Formations,
    obstacles: ObstacleEstimate,
    body: Body,
    config: PlannerConfig,
) -> tuple[Landscape, Array]:
    """The grid as the present formation sees it, and the cost of the way [F + 1] in every formation.

    The other formations are looked at where they might help: a walk costs its price at least, so where the goal can be
    reached for little more than the straight line, none of them need be.
    """
    size, now = count(formations), query.now
    field = distance_field(grid, local, query.goal.pose, shapes, obstacles, config)
    walks = config.reference.change_faces > 0.5
    fits = usable(formations) & (walks | (jnp.arange(size) == now))
    room = ring(field, grid, shapes) if size > 1 else field

    def look(carry: _Survey, shift: Array) -> tuple[_Survey, None]:
        table, costs, known, wanted = carry
        k = (now + shift) % size
        needed = wanted & fits[k]
        given = (k, table, local, grid, field, room, query, shapes, formations, body, config)
        found = where_needed(needed, lambda given: _landscape(*given), given, known)
        table = jnp.where(needed, table.at[k].set(found.value), table)
        costs = jnp.where(needed, costs.at[k].set(found.cost), costs)
        known = select(shift == 0, found, known)
        far = costs[now] > safe_norm(local[:2]) + query.price
        return (table, costs, known, query.wide & (far | query.stuck)), None

    nothing = _unseen(local.dtype)
    begin = (jnp.stack([nothing.value] * size), jnp.full(size, FAR, local.dtype), nothing, jnp.ones((), bool))
    (_, costs, land, _), _ = jax.lax.scan(look, begin, jnp.asarray(order(size)))
    return land, costs


_Survey = tuple[Array, Array, Landscape, Array]
"""Costs to go in all formations, costs of the way in them, what the present one sees, whether others may help."""


def _unseen(dtype: Any) -> Landscape:
    """Stands where no formation has been looked at."""
    blank = jnp.full((HEADINGS, CELLS, CELLS), FAR, dtype)
    moves = Moves(jnp.zeros((DIRECTIONS, HEADINGS, len(TURNS)), dtype), jnp.zeros(2, dtype))
    first, cost = jnp.zeros(3, jnp.int32), jnp.full((), FAR, dtype)
    return Landscape(blank, moves, blank, jnp.stack([blank, blank]), blank, first, cost)


def _landscape(
    k: Array,
    table: Array,
    local: Array,
    grid: Grid,
    field: Array,
    room: Array,
    query: Query,
    shapes: Shapes,
    formations: Formations,
    body: Body,
    config: PlannerConfig,
) -> Landscape:
    """The grid as formation k [] sees it.

    Args:
      k: [] int, formation.
      table: [F + 1, HEADINGS, CELLS, CELLS] costs to go in the formations looked at before, `FAR` in others.
      local: [3] start in the goal's frame.
      grid: its place.
      field: result of `distance_field`.
      room: result of `ring`, where there are other formations.
      query: from where to where.
      shapes: geometry, and the team in its first formation.
      formations: the other ones.
      body: the object as estimated.
      config: settings.
    """
    size, turn_radius = count(formations), config.reference.turn_radius
    there = dataclasses.replace(shapes, team=team_in(shapes.team, formations, k))
    near, widest = clearance(field, grid, there, config)
    density = 1.0 + 3.0 * jnp.maximum(config.reference.clearance - near, 0.0)
    tight, overlap = (jnp.maximum(2.0 * config.constraints.margin - free, 0.0) for free in (near, widest))
    density = density + _BLOCKED * (tight + overlap**2 / _THICKNESS)
    moves = price_moves(there, body, grid.spacing, turn_radius)
    stop = ends(grid, query.goal) + grid.spacing * (density - 1.0)
    walks = jnp.full((2, *stop.shape), FAR, stop.dtype)
    if size > 1:
        berth = config.safety.margin + ROOM + query.berth
        for way, on in enumerate((1, -1)):
            to = (k + on) % size
            free = may_walk(room, k, to, shapes, formations, berth)
            walks = walks.at[way].set(jnp.where(free, query.price + table[to], FAR))
    value = cost_to_go(jnp.minimum(stop, jnp.min(walks, axis=0)), density, moves)
    first, cost = first_node(local, grid, value, density, there, body, turn_radius)
    return Landscape(density, moves, stop, walks, value, first, cost)
