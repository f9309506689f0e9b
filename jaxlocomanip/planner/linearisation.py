"""Gauss-Newton model of a stage of `problem.PushProblem` with its known zeros left out.

Most inequalities are bounds on single variables and the tracking cost is diagonal, the step depends on few inputs,
and a barrier condition depends on the centre, velocity and acceleration of one disc. Differentiating those small
pieces and composing them costs a fraction of forward differentiation of the whole stage, and gives the same numbers
(tests hold them together).
"""

from __future__ import annotations

from typing import TYPE_CHECKING

import jax
import jax.numpy as jnp
from jax import Array

from jaxlocomanip.planar import dynamics
from jaxlocomanip.planar.geometry import cross, perpendicular, rotate
from jaxlocomanip.planner import constraints
from jaxlocomanip.planner.constraints import Discs, Motion
from jaxlocomanip.planner.penalty import relaxed_barrier
from jaxlocomanip.planner.shapes import ROBOT_DISCS
from jaxlocomanip.solver.ocp import StageModel

if TYPE_CHECKING:
    from jaxlocomanip.planner.problem import PushProblem, StageData


def stage_model(problem: PushProblem, x: Array, u: Array, data: StageData) -> StageModel:
    """Hessian, gradient, dynamics and cost of one stage (see `solver.ocp.StageModel`)."""
    n = x.shape[0] - 6
    force, rate, offset = u[:n], u[n:], x[6:]
    dt = problem.config.horizon.dt
    following, dynamics_rows, wrench_rows, wrench_B = _step(problem, x, u)
    acceleration = (following[3:6] - x[3:6]) / dt
    motion = Motion(x[:3], x[3:6], acceleration, force, offset, rate)
    diagonal, gradient, cost = _separable(problem, x, u, motion, data)
    rows, h = _coupled(problem, motion, wrench_B, dynamics_rows, wrench_rows, data)
    skip = 6 * n
    rest = jax.tree.map(lambda v: v[skip:], problem.barriers)
    penalty = relaxed_barrier(h, dt * rest.weight, rest.switch, rest.reach)
    weighted = penalty.curvature[:, None] * rows
    hessian = jnp.diag(diagonal) + jnp.sum(weighted[:, :, None] * rows[:, None, :], axis=0)
    gradient = gradient + jnp.sum(penalty.slope[:, None] * rows, axis=0)
    return StageModel(hessian, gradient, dynamics_rows, following, cost + jnp.sum(penalty.value))


def _step(problem: PushProblem, x: Array, u: Array) -> tuple[Array, Array, Array, Array]:
    """Next state [nx], its Jacobian [nx, nz], the wrench's Jacobian [3, nz] and the wrench [3], body axes."""
    n = x.shape[0] - 6
    horizon, team = problem.config.horizon, problem.shapes.team
    points = team.contact_points(x[6:])
    arms = cross(points, team.normal)
    wrench_B = dynamics.body_wrench(points, team.normal, u[:n])

    def advance(y: Array) -> tuple[Array, Array]:
        pose = jnp.concatenate([x[:2], y[:1]])
        new = jnp.concatenate(dynamics.step(problem.body, pose, y[1:4], y[4:], horizon.dt, horizon.smoothing))
        return new, new

    inputs = jnp.concatenate([x[2:6], wrench_B])
    jacobian, new = jax.jacfwd(advance, has_aux=True)(inputs)
    zeros = jnp.zeros((3, n), x.dtype)
    by_offset = zeros.at[2].set(u[:n] * cross(team.tangent, team.normal))
    by_force = jnp.concatenate([team.normal.T, arms[None]])
    wrench_rows = jnp.concatenate([jnp.zeros((3, 6), x.dtype), by_offset, by_force, zeros], axis=1)
    place = jnp.eye(6, 2, dtype=x.dtype)
    pushed = jnp.sum(jacobian[:, 4:, None] * wrench_rows[None, :, 6:], axis=1)
    top = jnp.concatenate([place, jacobian[:, :4], pushed], axis=1)
    eye = jnp.eye(n, dtype=x.dtype)
    bottom = jnp.concatenate([jnp.zeros((n, 6), x.dtype), eye, jnp.zeros((n, n), x.dtype), horizon.dt * eye], axis=1)
    following = jnp.concatenate([new, x[6:] + horizon.dt * u[n:]])
    return following, jnp.concatenate([top, bottom]), wrench_rows, wrench_B


def _separable(problem: PushProblem, x: Array, u: Array, motion: Motion, data: StageData) -> tuple[Array, Array, Array]:
    """Diagonal Hessian [nz], gradient [nz] and cost [] of the tracking terms and the bounds."""
    from jaxlocomanip.planner.problem import roots, tracking_error

    n = x.shape[0] - 6
    dt, weights = problem.config.horizon.dt, problem.config.weights
    ones = jnp.ones(n, x.dtype)
    error = jnp.concatenate(
        [
            tracking_error(x, data.pose, data.twist),
            motion.offset - data.offset,
            motion.force - data.force,
            motion.offset_rate,
        ]
    )
    track = dt * jnp.concatenate(
        [
            roots(weights.pose, weights.twist) ** 2,
            weights.offset * ones,
            weights.force * ones,
            weights.offset_rate * ones,
        ]
    )
    groups = constraints.bounds(motion, problem.shapes)[:3]
    h = jnp.stack([g.reshape(2, n) for g in (groups[1], groups[0], groups[2])])
    order = jnp.array([1, 0, 2])
    rows = jax.tree.map(lambda v: v[: 6 * n].reshape(3, 2, n)[order], problem.barriers)
    penalty = relaxed_barrier(h, dt * rows.weight, rows.switch, rows.reach)
    slope = (penalty.slope[:, 0] - penalty.slope[:, 1]).reshape(-1)
    curvature = jnp.sum(penalty.curvature, axis=1).reshape(-1)
    none = jnp.zeros(6, x.dtype)
    sign = jnp.concatenate([none, slope])
    diagonal = track + jnp.concatenate([none, curvature])
    cost = 0.5 * jnp.sum(track * error**2) + jnp.sum(penalty.value)
    return diagonal, track * error + sign, cost


def _coupled(
    problem: PushProblem,
    motion: Motion,
    wrench_B: Array,
    dynamics_rows: Array,
    wrench_rows: Array,
    data: StageData,
) -> tuple[Array, Array]:
    """Jacobian [m, nz] and values [m] of the team, CLF, object and robot conditions, in that order."""
    shapes = problem.shapes
    n = motion.force.shape[0]
    pairs = jnp.zeros((shapes.team.pair_bounds.shape[0], 6 + 3 * n), motion.pose.dtype)
    pairs = pairs.at[:, 6 : 6 + n].set(-shapes.team.pair_rows)
    room = shapes.team.pair_bounds - shapes.team.pair_rows @ motion.offset

    clf, (by_pose, by_twist, by_wrench) = jax.value_and_grad(problem.lyapunov, argnums=(0, 1, 2))(
        motion.pose, motion.twist, wrench_B, data
    )
    clf_row = jnp.concatenate([by_pose, by_twist, jnp.zeros(3 * n, by_pose.dtype)])
    clf_row = clf_row + jnp.sum(by_wrench[:, None] * wrench_rows, axis=0)

    object_rows, object_h = _object_rows(problem, motion, dynamics_rows, data)
    robot_rows, robot_h = _robot_rows(problem, motion, data)
    rows = jnp.concatenate([pairs, clf_row[None], object_rows, robot_rows])
    return rows, jnp.concatenate([room, clf[None], object_h, robot_h])


def _chain(discs: Discs, origin: Array, omega: Array, alpha: Array, by: tuple[Array, Array, Array]) -> Array:
    """[m, 9] derivative by (q, qd, qdd) of conditions with gradients `by` centre, speed and pull [m, 2]."""
    arms = discs.centers - origin
    turned = perpendicular(arms)
    center, speed, pull = by
    by_heading = (
        jnp.sum(center * turned, axis=-1)
        - omega * jnp.sum(speed * arms, axis=-1)
        + jnp.sum(pull * (-alpha * arms - omega**2 * turned), axis=-1)
    )
    by_omega = jnp.sum(speed * turned, axis=-1) - 2.0 * omega * jnp.sum(pull * arms, axis=-1)
    by_alpha = jnp.sum(pull * turned, axis=-1)
    return jnp.concatenate([center, by_heading[:, None], speed, by_omega[:, None], pull, by_alpha[:, None]], axis=1)


def _object_rows(problem: PushProblem, motion: Motion, dynamics_rows: Array, data: StageData) -> tuple[Array, Array]:
    settings = problem.config.constraints
    discs = constraints.object_discs(motion, problem.shapes)
    slope = jax.value_and_grad(constraints.object_condition, argnums=(0, 1, 2))
    every = jax.vmap(jax.vmap(slope, (None, None, None, 0, None)), (0, 0, 0, 0, None))
    h, by = every(discs.centers, discs.speeds, discs.pulls, data.obstacles.objects, settings)
    count = h.shape[1]
    spread = jax.tree.map(lambda v: jnp.repeat(v, count, axis=0), discs)
    flat = tuple(v.reshape(-1, 2) for v in by)
    nine = _chain(spread, motion.pose[:2], motion.twist[2], motion.acceleration[2], flat)
    dt = problem.config.horizon.dt
    velocity = jnp.eye(3, dynamics_rows.shape[1], 3, dtype=nine.dtype)
    acceleration_rows = (dynamics_rows[3:6] - velocity) / dt
    rows = jnp.sum(nine[:, 6:, None] * acceleration_rows[None], axis=1)
    return rows.at[:, :6].add(nine[:, :6]), h.reshape(-1)


def _robot_rows(problem: PushProblem, motion: Motion, data: StageData) -> tuple[Array, Array]:
    settings, team = problem.config.constraints, problem.shapes.team
    n = motion.force.shape[0]
    discs = constraints.robot_discs(motion, problem.shapes)
    slope = jax.value_and_grad(constraints.robot_condition, argnums=(0, 1))
    every = jax.vmap(jax.vmap(slope, (None, None, 0, None)), (0, 0, 0, None))
    h, by = every(discs.centers, discs.speeds, data.obstacles.robots, settings)
    count = h.shape[1]
    center, speed = (v.reshape(-1, 2) for v in by)
    spread = jax.tree.map(lambda v: jnp.repeat(v, count, axis=0), discs)
    nine = _chain(spread, motion.pose[:2], motion.twist[2], jnp.zeros((), h.dtype), (center, speed, 0.0 * center))
    tangent = jnp.repeat(rotate(motion.pose[2], team.tangent), ROBOT_DISCS * count, axis=0)
    slide = jnp.repeat(motion.offset_rate, ROBOT_DISCS * count)
    by_heading = slide * jnp.sum(speed * perpendicular(tangent), axis=-1)
    by_offset = jnp.sum(center * tangent + motion.twist[2] * speed * perpendicular(tangent), axis=-1)
    by_rate = jnp.sum(speed * tangent, axis=-1)
    owner = jnp.repeat(jnp.eye(n, dtype=h.dtype), ROBOT_DISCS * count, axis=0)
    rows = jnp.concatenate(
        [
            nine[:, :2],
            nine[:, 2:3] + by_heading[:, None],
            nine[:, 3:6],
            owner * by_offset[:, None],
            jnp.zeros_like(owner),
            owner * by_rate[:, None],
        ],
        axis=1,
    )
    return rows, h.reshape(-1)
