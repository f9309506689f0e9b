"""Costs and Gauss-Newton models of all stages of a `quasistatic.PathProblem` at once, derivatives written out.

Motions depend on contact offsets and pushes only, the room of a disc on the pose and its own robot's offset, and the
other terms on single variables. Equal to forward differentiation of the stage (tests hold them together). Variables are
z = [p, theta, d, push, slide]; arrays have stages last, so that every operation on a component is one long loop. What
several pieces read is computed apart from them (`numerics.apart`).
"""

from __future__ import annotations

from typing import TYPE_CHECKING

import jax
import jax.numpy as jnp
from jax import Array

from jaxlocomanip.numerics import apart, pytree
from jaxlocomanip.planar.vector import Vector, unit
from jaxlocomanip.planner.authority import usable_offsets
from jaxlocomanip.planner.path_room import facing, rooms
from jaxlocomanip.planner.room import contacts, side_by_side
from jaxlocomanip.planner.shapes import ROBOT_DISCS
from jaxlocomanip.solver.layout import added
from jaxlocomanip.solver.ocp import Penalty, StageModel

if TYPE_CHECKING:
    from jaxlocomanip.planner.quasistatic import PathProblem

EVENLY = 20.0
"""weight of steps of uneven length: obstacles cost per step, and a long one would pass through"""
STANDS = 0.1
"""of a step's length, sliding motion below which the object hardly slides"""


@pytree
class Sliding:
    """What the pushes do; leaves [N] but for the lever arms."""

    lever: Array
    """[N_r, N] of the pushes about the centre of mass, in multiples of rho"""
    force: Vector
    """m, of motion"""
    moment: Array
    """m, of motion at the distance rho"""
    move: Vector
    """m, of the body point, in the body axes of halfway"""
    turn: Array
    """rad"""
    halfway: Vector
    """cosine and sine of the heading halfway"""
    length: Array
    """m, of the step, turns included"""
    speed: Array
    """m, sliding motion in the norm of the limit surface, floored"""


def values(problem: PathProblem, x: Array, u: Array) -> tuple[Array, Array]:
    """Cost [N] and next state [nx, N] of the stages at states [nx, N] and inputs [nu, N]."""
    sliding = _sliding(problem, x, u)
    h = _inequalities(problem, sliding, x, u, rooms(problem, x))
    return _cost(problem, sliding, x, u, problem.penalty(h, problem.stages)), _following(sliding, x, u)


def models(problem: PathProblem, x: Array, u: Array) -> StageModel:
    """Models of the stages, leaves [N, ...]; arguments as above."""
    n = x.shape[0] - 3
    sliding = _sliding(problem, x, u)
    room, normal, arm = facing(problem, x)
    h = _inequalities(problem, sliding, x, u, room)
    penalty = _priced(problem, h)
    moves = _by_pushes(problem, sliding, u)
    pushed = _way_rows(problem, sliding, moves), *_push_rows(problem, sliding, moves, u, penalty)
    placed = _place_rows(problem, x, normal, arm), penalty.slope[4 * n :], penalty.curvature[4 * n :]
    hessian, gradient = _summed(problem, x, u, penalty, pushed, placed, _ways(problem, sliding))
    found = StageModel(
        hessian=hessian,
        gradient=gradient,
        dynamics=_jacobian(sliding, moves),
        next_state=_following(sliding, x, u),
        cost=_cost(problem, sliding, x, u, penalty),
    )
    return jax.tree.map(lambda leaf: jnp.moveaxis(leaf, -1, 0), found)


@apart
def _priced(problem: PathProblem, h: Array) -> Penalty:
    return problem.penalty(h, problem.stages)


@apart
def _sliding(problem: PathProblem, x: Array, u: Array) -> Sliding:
    team, friction = problem.shapes.team, problem.friction
    com, push = friction.com, u[: x.shape[0] - 3]
    point, normal = contacts(x[3:], team)
    lever = (point - Vector(com[0], com[1])).cross(normal) * (1.0 / friction.rho)
    force = Vector(added([*(normal.x * push)]), added([*(normal.y * push)]))
    moment = added([*(push * lever)])
    turn = moment / friction.rho
    move = Vector(force.x + turn * com[1], force.y - turn * com[0])
    length = jnp.sqrt(move.dot(move) + (problem.config.reference.turn_radius * turn) ** 2)
    speed = jnp.sqrt(force.dot(force) + moment * moment + (STANDS * problem.step) ** 2)
    return Sliding(lever, force, moment, move, turn, unit(x[2] + 0.5 * turn), length, speed)


def _following(sliding: Sliding, x: Array, u: Array) -> Array:
    """[nx, N]."""
    moved = sliding.move.rotated(sliding.halfway)
    pose = jnp.stack([x[0] + moved.x, x[1] + moved.y, x[2] + sliding.turn])
    return jnp.concatenate([pose, x[3:] + u[x.shape[0] - 3 :]])


def _ways(problem: PathProblem, sliding: Sliding) -> Array:
    """[4, N] residuals that depend on the motion."""
    along = problem.stages.turning * sliding.turn
    uneven = jnp.sqrt(EVENLY) * (sliding.length - problem.step)
    return jnp.sqrt(2.0 / problem.step) * jnp.stack([sliding.move.x, sliding.move.y, along, uneven])


def _separable(problem: PathProblem, x: Array, u: Array) -> tuple[Array, Array]:
    """[nz, 1] weights of the squares of [nz, N]."""
    error = jnp.concatenate([x[:3] - problem.stages.guess.T, x[3:], u])
    return problem.weights()[:, None], error


def _inequalities(problem: PathProblem, sliding: Sliding, x: Array, u: Array, room: Array) -> Array:
    """[nh, N], in the order of `PathProblem.stage`."""
    team, offset, n = problem.shapes.team, x[3:], x.shape[0] - 3
    limit = usable_offsets(team)[:, None]
    pushes = u[:n] / sliding.speed
    taken = added([team.pair_rows[:, i, None] * offset[i] for i in range(n)])
    between = (team.pair_bounds - problem.config.constraints.margin)[:, None] - taken
    capacity = problem.friction.capacity[:, None]
    return jnp.concatenate([pushes, capacity - pushes, limit + offset, limit - offset, between, room])


@apart
def _cost(problem: PathProblem, sliding: Sliding, x: Array, u: Array, penalty: Penalty) -> Array:
    """[N]."""
    weight, error = _separable(problem, x, u)
    ways = _ways(problem, sliding)
    return 0.5 * added([*(weight * error * error), *(ways * ways)]) + added([*penalty.value])


@pytree
class Moves:
    """Derivatives by contact offsets and pushes, one after the other; leaves [2 N_r, N]."""

    force: Vector
    moment: Array
    move: Vector
    turn: Array


@apart
def _by_pushes(problem: PathProblem, sliding: Sliding, u: Array) -> Moves:
    team, friction = problem.shapes.team, problem.friction
    n = sliding.lever.shape[0]
    normal = side_by_side(team.normal)
    none = jnp.zeros_like(sliding.lever)
    by_offset = u[:n] * normal.turned.cross(normal) / friction.rho
    force = Vector(jnp.concatenate([none, none + normal.x]), jnp.concatenate([none, none + normal.y]))
    moment = jnp.concatenate([by_offset, sliding.lever])
    turn = moment / friction.rho
    move = Vector(force.x + turn * friction.com[1], force.y - turn * friction.com[0])
    return Moves(force, moment, move, turn)


@apart
def _way_rows(problem: PathProblem, sliding: Sliding, moves: Moves) -> Array:
    """[4, 2 N_r, N], of `_ways`."""
    square = problem.config.reference.turn_radius**2
    moving = sliding.length > 0.0
    inverse = jnp.where(moving, 1.0 / jnp.where(moving, sliding.length, 1.0), 0.0)
    longer = (sliding.move.dot(moves.move) + square * sliding.turn * moves.turn) * inverse
    rows = [moves.move.x, moves.move.y, problem.stages.turning * moves.turn, jnp.sqrt(EVENLY) * longer]
    return jnp.sqrt(2.0 / problem.step) * jnp.stack(rows)


@apart
def _push_rows(
    problem: PathProblem, sliding: Sliding, moves: Moves, u: Array, penalty: Penalty
) -> tuple[Array, Array, Array]:
    """[N_r, 2 N_r, N] of the pushes relative to the sliding motion, their slopes and curvatures [N_r, N]."""
    n = sliding.lever.shape[0]
    inverse = 1.0 / sliding.speed
    faster = (sliding.force.dot(moves.force) + sliding.moment * moves.moment) * inverse**3
    own = jnp.concatenate([jnp.zeros((n, n), u.dtype), jnp.eye(n, dtype=u.dtype)], axis=1)
    rows = own[..., None] * inverse - u[:n, None] * faster
    slope, curvature = penalty.slope, penalty.curvature
    return rows, slope[:n] - slope[n : 2 * n], curvature[:n] + curvature[n : 2 * n]


@apart
def _place_rows(problem: PathProblem, x: Array, normal: Vector, arm: Vector) -> Array:
    """[P + D, 3 + N_r, N], of the room between robots and to obstacles, by pose and contact offsets."""
    team, n = problem.shapes.team, x.shape[0] - 3
    none = jnp.zeros((team.pair_bounds.shape[0], 3), x.dtype)
    pairs = jnp.concatenate([none, -team.pair_rows], axis=1)[..., None] + jnp.zeros_like(x[0])
    aside = side_by_side(team.normal).turned.rotated(unit(x[2]))
    objects = problem.shapes.object_radii.shape[0]
    columns = [normal.x, normal.y, normal.dot(arm.turned)]
    for i in range(n):
        along = normal.dot(aside[i])
        first = objects + ROBOT_DISCS * i
        columns.append(jnp.zeros_like(along).at[first : first + ROBOT_DISCS].set(along[first : first + ROBOT_DISCS]))
    return jnp.concatenate([pairs, jnp.stack(columns, axis=1)])


@apart
def _summed(
    problem: PathProblem,
    x: Array,
    u: Array,
    penalty: Penalty,
    pushed: tuple[Array, Array, Array, Array],
    placed: tuple[Array, Array, Array],
    ways: Array,
) -> tuple[Array, Array]:
    """Hessian [nz, nz, N] and gradient [nz, N] of a stage's cost."""
    n, (weight, error) = x.shape[0] - 3, _separable(problem, x, u)
    (way_rows, push_rows, push_slope, push_curvature), (place_rows, place_slope, place_curvature) = pushed, placed
    by_push = [*way_rows], [*push_rows]
    motion = added(
        [row[:, None] * row for row in by_push[0]]
        + [(c * row)[:, None] * row for c, row in zip(push_curvature, by_push[1], strict=True)]
    )
    place = added([(c * row)[:, None] * row for c, row in zip(place_curvature, place_rows, strict=True)])
    slopes = added(
        [r * row for r, row in zip(ways, by_push[0], strict=True)]
        + [s * row for s, row in zip(push_slope, by_push[1], strict=True)]
    )
    climbs = added([s * row for s, row in zip(place_slope, place_rows, strict=True)])
    ends = penalty.curvature[2 * n : 3 * n] + penalty.curvature[3 * n : 4 * n]
    diagonal = (weight + jnp.zeros_like(error)).at[3 : 3 + n].add(ends)
    gradient = weight * error
    gradient = gradient.at[3 : 3 + n].add(penalty.slope[2 * n : 3 * n] - penalty.slope[3 * n : 4 * n])
    gradient = gradient.at[: 3 + n].add(climbs).at[3 : 3 + 2 * n].add(slopes)
    hessian = jnp.eye(error.shape[0], dtype=x.dtype)[..., None] * diagonal
    return hessian.at[: 3 + n, : 3 + n].add(place).at[3 : 3 + 2 * n, 3 : 3 + 2 * n].add(motion), gradient


@apart
def _jacobian(sliding: Sliding, moves: Moves) -> Array:
    """[nx, nz, N]."""
    n, none = sliding.lever.shape[0], jnp.zeros_like(sliding.turn)
    moved = sliding.move.rotated(sliding.halfway)
    by_push = moves.move.rotated(sliding.halfway) + moved.turned * (0.5 * moves.turn)
    idle = [none] * n
    rows = [
        [none + 1.0, none, -moved.y, *by_push.x, *idle],
        [none, none + 1.0, moved.x, *by_push.y, *idle],
        [none, none, none + 1.0, *moves.turn, *idle],
    ]
    eye = jnp.eye(n, dtype=none.dtype)
    walked = jnp.concatenate([jnp.zeros((n, 3), none.dtype), eye, 0.0 * eye, eye], axis=1)
    return jnp.concatenate([jnp.stack([jnp.stack(row) for row in rows]), walked[..., None] + none])
