"""Gauss-Newton model of all stages of a `problem.PushProblem` at once, its known zeros left out.

Most inequalities are bounds on single variables and the tracking cost is diagonal, the step depends on few inputs,
and a barrier condition depends on the centre, velocity and acceleration of one disc. Differentiating those small
pieces and composing them costs a fraction of forward differentiation of the whole stage, and gives the same numbers
(tests hold them together). Variables are z = [p, theta, v, omega, d, f, ddot]; arrays have stages last. What several
pieces read is computed apart from them (`numerics.apart`).
"""

from __future__ import annotations

import dataclasses
from typing import TYPE_CHECKING

import jax
import jax.numpy as jnp
from jax import Array

from jaxlocomanip.numerics import apart, pytree
from jaxlocomanip.planar import dynamics
from jaxlocomanip.planar.geometry import Feature, cross
from jaxlocomanip.planar.vector import Vector, trailing, unit, vector
from jaxlocomanip.planner import barriers, constraints
from jaxlocomanip.planner.barriers import Approach, DiscMotion, Discs
from jaxlocomanip.planner.constraints import Motion
from jaxlocomanip.planner.penalty import relaxed_barrier
from jaxlocomanip.solver.layout import added
from jaxlocomanip.solver.ocp import Penalty, StageModel

if TYPE_CHECKING:
    from jaxlocomanip.planner.problem import PushProblem, StageData


@pytree
class Step:
    """The prediction of all stages and its derivatives."""

    following: Array
    """[nx, N]"""
    jacobian: Array
    """[nx, nz, N]"""
    wrench: Array
    """[3, N] body axes"""
    wrench_rows: Array
    """[2 N_r, 3, N] derivatives of the wrench by the offsets and the forces"""


def model(problem: PushProblem, x: Array, u: Array, data: StageData) -> StageModel:
    """Models of the stages at states [nx, N] and inputs [nu, N]; leaves [N, ...]."""
    n = x.shape[0] - 6
    dt = problem.config.horizon.dt
    step = linear_step(problem, x, u)
    acceleration = (step.following[3:6] - x[3:6]) / dt
    motion = Motion(x[:3], x[3:6], acceleration, u[:n], x[6:], u[n:])
    diagonal, gradient, cost = _separable(problem, x, u, motion, data)
    rows, h = _coupled(problem, motion, step, data)
    rest = jax.tree.map(lambda v: trailing(v[6 * n :], h), problem.barriers)
    penalty = relaxed_barrier(h, dt * rest.weight, rest.switch, rest.reach)
    scaled, gradient = _weighed(rows, penalty, gradient)
    cost = cost + jnp.sum(penalty.value, axis=0)
    found = StageModel(_hessian(rows, scaled, diagonal), gradient, step.jacobian, step.following, cost)
    return jax.tree.map(lambda leaf: jnp.moveaxis(leaf, -1, 0), found)


@apart
def _weighed(rows: Array, penalty: Penalty, gradient: Array) -> tuple[Array, Array]:
    """Rows [m, nz, N] times their curvatures, and the gradient [nz, N] with theirs added."""
    slopes = [slope * row for row, slope in zip(rows, penalty.slope, strict=True)]
    return penalty.curvature[:, None] * rows, gradient + added(slopes)


@apart
def _hessian(rows: Array, scaled: Array, diagonal: Array) -> Array:
    """Hessian [nz, nz, N] of the coupled terms, and the diagonal [nz, N] of the separable ones."""
    products = [factor[:, None] * row for row, factor in zip(rows, scaled, strict=True)]
    return jnp.eye(diagonal.shape[0], dtype=diagonal.dtype)[..., None] * diagonal + added(products)


@apart
def linear_step(problem: PushProblem, x: Array, u: Array) -> Step:
    """Next states and their Jacobian."""
    n = x.shape[0] - 6
    horizon, team = problem.config.horizon, problem.shapes.team
    wrench_B = problem.wrench(x, u)
    state = dynamics.State(vector(x), x[2], vector(x[3:]), x[5])
    after, slopes = dynamics.advance_slopes(
        problem.body, state, vector(wrench_B), wrench_B[2], horizon.dt, horizon.smoothing
    )
    turns = trailing(cross(team.tangent, team.normal), u[:n]) * u[:n]
    arms, none = problem.arms(x[6:]), jnp.zeros_like(x[0])
    by_offset = [jnp.stack([none, none, turns[i]]) for i in range(n)]
    by_force = [jnp.stack([none + team.normal[i, 0], none + team.normal[i, 1], arms[i]]) for i in range(n)]
    wrench_rows = jnp.stack([*by_offset, *by_force])
    by_state, by_wrench = [_components(slope) for slope in slopes[:4]], [_components(slope) for slope in slopes[4:]]
    pushed = [[sum(by_wrench[k][i] * row[k] for k in range(3)) for i in range(6)] for row in (*by_offset, *by_force)]
    place = [[none + float(i == j) for i in range(6)] for j in range(2)]
    moving = [*place, *by_state, *pushed, *[[none] * 6] * n]
    eye = jnp.eye(n, dtype=x.dtype)
    slid = jnp.concatenate([jnp.zeros((n, 6), x.dtype), eye, 0.0 * eye, horizon.dt * eye], axis=1)
    top = jnp.stack([column[i] for i in range(6) for column in moving]).reshape(6, 6 + 3 * n, -1)
    jacobian = jnp.concatenate([top, slid[..., None] + none])
    following = jnp.concatenate([jnp.stack(_components(after)), x[6:] + horizon.dt * u[n:]])
    return Step(following, jacobian, wrench_B, wrench_rows)


def _components(state: dynamics.State) -> list[Array]:
    return [state.position.x, state.position.y, state.heading, state.velocity.x, state.velocity.y, state.omega]


@apart
def _separable(problem: PushProblem, x: Array, u: Array, motion: Motion, data: StageData) -> tuple[Array, Array, Array]:
    """Diagonal Hessian [nz, N], gradient [nz, N] and cost [N] of the tracking terms and the bounds."""
    n = x.shape[0] - 6
    dt = problem.config.horizon.dt
    error = problem.errors(x, u, data)
    track = dt * trailing(problem.weights(), error)
    penalties = []
    for k, h in enumerate(constraints.bounds(motion, problem.shapes)[:3]):
        rows = jax.tree.map(lambda v, k=k, h=h: trailing(v[2 * n * k : 2 * n * (k + 1)], h), problem.barriers)
        penalties.append(relaxed_barrier(h, dt * rows.weight, rows.switch, rows.reach))
    none = jnp.zeros_like(x[:6])
    force, offset, rate = penalties
    order = (offset, force, rate)
    slope = jnp.concatenate([none, *(p.slope[:n] - p.slope[n:] for p in order)])
    curvature = jnp.concatenate([none, *(p.curvature[:n] + p.curvature[n:] for p in order)])
    cost = 0.5 * jnp.sum(track * error**2, axis=0) + sum(jnp.sum(p.value, axis=0) for p in order)
    return track + curvature, track * error + slope, cost


def _coupled(problem: PushProblem, motion: Motion, step: Step, data: StageData) -> tuple[Array, Array]:
    """Jacobian [m, nz, N] and values [m, N] of the team, CLF, object and robot conditions, in that order."""
    team = problem.shapes.team
    n, stages = motion.force.shape
    pairs = jnp.zeros((team.pair_bounds.shape[0], 6 + 3 * n, stages), motion.pose.dtype)
    pairs = pairs.at[:, 6 : 6 + n].set(-team.pair_rows[..., None])
    clf_row, clf = _lyapunov_row(problem, motion, step, data)
    disc_rows, h = _disc_rows(problem, motion, step, data)
    rows = jnp.concatenate([pairs, clf_row[None], disc_rows])
    return rows, jnp.concatenate([constraints.room(motion.offset, problem.shapes), clf[None], h])


@apart
def _lyapunov_row(problem: PushProblem, motion: Motion, step: Step, data: StageData) -> tuple[Array, Array]:
    """Jacobian [nz, N] and values [N] of the CLF condition."""
    n = motion.force.shape[0]
    given = motion.pose, motion.twist, step.wrench
    clf, pullback = jax.vjp(lambda pose, twist, wrench: problem.lyapunov(pose, twist, wrench, data), *given)
    by_pose, by_twist, by_wrench = pullback(jnp.ones_like(clf))
    pushed = [row[0] * by_wrench[0] + row[1] * by_wrench[1] + row[2] * by_wrench[2] for row in step.wrench_rows]
    return jnp.stack([*by_pose, *by_twist, *pushed, *([jnp.zeros_like(clf)] * n)]), clf


def _disc_rows(problem: PushProblem, motion: Motion, step: Step, data: StageData) -> tuple[Array, Array]:
    """Jacobian [D N_o, nz, N] and values [D N_o, N] of the conditions of all discs."""
    settings, shapes, dt = problem.config.constraints, problem.shapes, problem.config.horizon.dt
    n = motion.force.shape[0]
    heading = unit(motion.pose[2])
    obstacles = data.obstacles

    def geometry(given: tuple[Discs, Array, Array, Feature]) -> tuple[Approach, DiscMotion]:
        disc, slid, sliding, feature = given
        near = dataclasses.replace(obstacles, feature=feature)
        moving = barriers.disc_motion(disc, slid, sliding, motion, heading)
        return barriers.approach(disc, moving.center, near), moving

    every = barriers.discs(shapes, settings)
    sliding = barriers.by_disc(motion.offset_rate, shapes)
    given = every, barriers.by_disc(motion.offset, shapes), sliding, obstacles.feature
    seen, moving = apart(jax.vmap(geometry))(given)
    # From here on all discs at once: leaves [D, N_o or 1, N].
    disc, moving, sliding = jax.tree.map(lambda leaf: leaf[:, None], (every, moving, sliding))
    disc = jax.tree.map(lambda leaf: leaf[..., None], disc)
    h = apart(barriers.condition)(disc, moving, seen, obstacles, settings)
    gradient = _gradients(disc, moving, seen, obstacles, settings)
    columns = _columns(gradient, moving, motion, sliding)
    own = barriers.by_disc(jnp.eye(n, dtype=h.dtype), shapes)[:, None, :, None]
    acceleration = (step.jacobian[3:6] - jnp.eye(3, 6 + 3 * n, 3, dtype=h.dtype)[..., None]) / dt
    rows = _full_rows(gradient.pull, acceleration, columns, own)
    return rows.reshape(-1, *rows.shape[2:]), h.reshape(-1, h.shape[2])


@apart
def _full_rows(pull: Vector, acceleration: Array, columns: _Columns, own: Array) -> Array:
    """[D, N_o, nz, N], of what the discs' accelerations contribute and of the columns."""
    n = own.shape[2]
    full = [
        pull.x * acceleration[0, i] + pull.y * acceleration[1, i] + columns.alpha * acceleration[2, i]
        for i in range(6 + 3 * n)
    ]
    for i, column in enumerate(columns.state):
        full[i] = full[i] + column
    for i in range(n):
        full[6 + i] = full[6 + i] + own[:, :, i] * columns.offset
        full[6 + 2 * n + i] = full[6 + 2 * n + i] + own[:, :, i] * columns.rate
    return jnp.stack(full, axis=2)


@pytree
class Gradients:
    """Derivatives of conditions by a disc's centre, velocity and acceleration; leaves [D, N_o, N]."""

    center: Vector
    speed: Vector
    pull: Vector


@apart
def _gradients(
    disc: Discs, moving: DiscMotion, seen: Approach, obstacles: barriers.Obstacles, settings: constraints.Constraints
) -> Gradients:
    """The normal turns as the disc passes, by the curvature: that is where terms across the normal come from."""
    speed = Vector(moving.speed.x - obstacles.drift.x, moving.speed.y - obstacles.drift.y)
    closing, passing = seen.normal.dot(speed), seen.normal.cross(speed)
    scale, bend = settings.cbf_scale, seen.curvature * passing
    pulled = seen.normal.cross(moving.pull)
    across = seen.curvature * (disc.beta * passing + disc.second * (pulled - 2.0 * closing * bend))

    def vector_of(along: Array, across: Array) -> Vector:
        return seen.normal * (scale * along) + seen.normal.turned * (scale * across)

    return Gradients(
        vector_of(disc.alpha - disc.second * bend * bend, across),
        vector_of(disc.beta, 2.0 * disc.second * bend),
        seen.normal * (scale * disc.second),
    )


@pytree
class _Columns:
    """Derivatives of conditions by what moves the discs; leaves [D, N_o, N]."""

    state: tuple[Array, ...]
    """by p, theta, v and omega, at a given acceleration"""
    alpha: Array
    """by the angular acceleration"""
    offset: Array
    """by the contact offset of the disc's robot"""
    rate: Array
    """by its rate"""


@apart
def _columns(gradient: Gradients, moving: DiscMotion, motion: Motion, sliding: Array) -> _Columns:
    center, speed, pull = gradient.center, gradient.speed, gradient.pull
    arm, slide, omega = moving.arm, moving.slide, motion.twist[2]
    ahead, aside = pull.dot(arm.turned), pull.dot(arm)
    by_heading = center.dot(arm.turned) - omega * speed.dot(arm) + sliding * speed.dot(slide.turned)
    by_heading = by_heading - motion.acceleration[2] * aside - omega * omega * ahead
    by_omega = speed.dot(arm.turned) - 2.0 * omega * aside
    by_offset = center.dot(slide) + omega * speed.dot(slide.turned)
    return _Columns((center.x, center.y, by_heading, speed.x, speed.y, by_omega), ahead, by_offset, speed.dot(slide))
