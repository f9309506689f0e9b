"""What the Gauss-Newton Hessian of a stage of `problem.PushProblem` leaves out: curvature of dynamics and conditions.

That is the Hessian by z = [x, u] of lambda' f(z) + sum_i P'(h_i) h_i(z) with the slopes P' held, needed for derivatives
of the optimum (`solver.implicit`). Composed of small pieces, like the model itself: the friction step in three
variables, the Lyapunov condition in nine, a barrier in the motion of one disc; rigid motion between them is written
out. The tests hold it against automatic differentiation.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import TYPE_CHECKING, NamedTuple

import jax
import jax.numpy as jnp
from jax import Array

from jaxlocomanip.planar import dynamics
from jaxlocomanip.planar.geometry import cross, perpendicular, rotate
from jaxlocomanip.planner import constraints
from jaxlocomanip.planner.constraints import Motion
from jaxlocomanip.planner.penalty import relaxed_barrier
from jaxlocomanip.planner.shapes import ROBOT_DISCS
from jaxlocomanip.solver.ocp import StageModel

if TYPE_CHECKING:
    from jaxlocomanip.planner.problem import PushProblem, StageData

_THETA, _OMEGA = 2, 5


def stage_curvature(
    problem: PushProblem, x: Array, u: Array, multiplier: Array, model: StageModel, data: StageData
) -> Array:
    """[nz, nz] curvature at one stage.

    Args:
      problem: the optimal control problem.
      x: [nx] state.
      u: [nu] input.
      multiplier: lambda [nx] of the next state.
      model: of this stage, for its next state and Jacobian.
      data: one slice of `problem.stages`.
    """
    n = x.shape[0] - 6
    dt, team = problem.config.horizon.dt, problem.shapes.team
    acceleration = (model.next_state[3:6] - x[3:6]) / dt
    motion = Motion(x[:3], x[3:6], acceleration, u[:n], x[6:], u[n:])
    by_z = jnp.eye(x.shape[0] + 2 * n, dtype=x.dtype)
    by_acceleration = (model.dynamics[3:6] - by_z[3:6]) / dt
    objects, by_pull = _object_part(problem, motion, by_z, by_acceleration, data)
    robots = _robot_part(problem, motion, by_z, data)

    # The acceleration is part of the next state, so what pulls at it adds to the multiplier.
    pulled = multiplier[:6].at[3:].add(by_pull / dt)
    points = team.contact_points(x[6:])
    wrench_B = dynamics.body_wrench(points, team.normal, u[:n])
    core, by_wrench = _step_part(problem, x, wrench_B, pulled)
    conditioned, by_wrench_too = _lyapunov_part(problem, motion, wrench_B, data)
    lever = cross(team.tangent, team.normal)
    arms = cross(points, team.normal)
    wrench_rows = jnp.sum(team.normal.T[:, :, None] * by_z[None, 6 + n : 6 + 2 * n], axis=1)
    turning = jnp.sum((u[:n] * lever)[:, None] * by_z[6 : 6 + n] + arms[:, None] * by_z[6 + n : 6 + 2 * n], axis=0)
    rows = jnp.concatenate([by_z[:6], wrench_rows, turning[None]])
    pairs = (by_wrench + by_wrench_too)[2] * lever
    bilinear = jnp.sum(pairs[:, None, None] * by_z[6 : 6 + n, :, None] * by_z[6 + n : 6 + 2 * n, None, :], axis=0)
    return objects + robots + _congruent(core + conditioned, rows) + bilinear + bilinear.T


def _congruent(matrix: Array, rows: Array) -> Array:
    """rows' matrix rows, [..., m, m] and [..., m, nz] -> [..., nz, nz]."""
    # Sums, because products of tiny matrices are slow library calls under `vmap`.
    half = jnp.sum(matrix[..., :, :, None] * rows[..., None, :, :], axis=-2)
    return jnp.sum(rows[..., :, :, None] * half[..., :, None, :], axis=-3)


def _mixed(value: Array, one: Array, other: Array) -> Array:
    """value (one other' + other one'), [...] and [..., nz] -> [..., nz, nz]."""
    product = value[..., None, None] * one[..., :, None] * other[..., None, :]
    return product + jnp.swapaxes(product, -1, -2)


def _dot(a: Array, b: Array) -> Array:
    return jnp.sum(a * b, axis=-1)


class _Free(NamedTuple):
    """The velocity at the centre of mass before friction acts."""

    value: Array
    """[3]"""
    rows: Array
    """[3, 9] Jacobian by (pose, twist, wrench in body axes)"""
    push: Array
    """[2] force half-way through the step, world axes"""
    gain: Array
    """[] step length over mass"""


def _free(problem: PushProblem, x: Array, wrench_B: Array) -> _Free:
    body, h = problem.body, problem.config.horizon.dt
    omega = x[_OMEGA]
    arm = rotate(x[_THETA], body.com)
    turned = perpendicular(arm)
    middle, gain, spin = x[_THETA] + 0.5 * h * omega, h / body.mass, h / body.central_inertia
    push = rotate(middle, wrench_B[:2])
    moment = wrench_B[2] - cross(body.com, wrench_B[:2])
    value = jnp.append(x[3:5] + omega * turned + gain * push, omega + spin * moment)
    by_theta = jnp.append(-omega * arm + gain * perpendicular(push), 0.0)
    by_omega = jnp.append(turned + 0.5 * h * gain * perpendicular(push), 1.0)
    along = gain * rotate(middle, jnp.eye(2, dtype=x.dtype))
    lever = spin * jnp.stack([body.com[1], -body.com[0]])
    by_push = jnp.concatenate([along, lever[:, None]], axis=1)
    by_moment = jnp.zeros(3, x.dtype).at[2].set(spin)
    none, axes = jnp.zeros((2, 3), x.dtype), jnp.eye(2, 3, dtype=x.dtype)
    rows = jnp.concatenate([none, by_theta[None], axes, by_omega[None], by_push, by_moment[None]]).T
    return _Free(value, rows, push, gain)


def _step_part(problem: PushProblem, x: Array, wrench_B: Array, multiplier: Array) -> tuple[Array, Array]:
    """Hessian [9, 9] of multiplier [6]' (pose, twist after the step) by (pose, twist, wrench), gradient [3] by wrench.

    The wrench is in body axes.
    """
    body, horizon = problem.body, problem.config.horizon
    h, theta, omega = horizon.dt, x[_THETA], x[_OMEGA]
    inertia = jnp.stack([body.mass, body.mass, body.central_inertia])
    to_p, to_v = multiplier[:2], multiplier[3:5]
    arm, free = rotate(theta, body.com), _free(problem, x, wrench_B)

    def after(v: Array) -> Array:
        return dynamics.friction_step(inertia, body.friction_force, body.friction_moment, v, h, horizon.smoothing)

    new = after(free.value)
    heading = theta + 0.5 * h * (omega + new[2])
    end = rotate(heading, body.com)
    at_heading = multiplier[2] - _dot(to_p, perpendicular(end)) + new[2] * _dot(to_v, end)
    at_spin = 0.5 * h * at_heading - _dot(to_v, perpendicular(end)) + multiplier[5]
    at_new = jnp.append(0.5 * h * to_p + to_v, at_spin)

    def pulled(v: Array) -> tuple[Array, Array]:
        (slope,) = jax.vjp(after, v)[1](at_new)
        return slope, slope

    curved, at_free = jax.jacfwd(pulled, has_aux=True)(free.value)
    unit = jnp.eye(9, dtype=x.dtype)
    by_spin = jnp.sum(jax.jacfwd(after)(free.value)[2][:, None] * free.rows, axis=0)
    by_heading = unit[_THETA] + 0.5 * h * (unit[_OMEGA] + by_spin)
    bend = _dot(to_p, end) + new[2] * _dot(to_v, perpendicular(end))
    total = _congruent(curved, free.rows) + bend * by_heading[:, None] * by_heading
    total = total + _mixed(_dot(to_v, end), by_heading, by_spin)
    # The old velocity bends with the heading, the push with the heading half-way.
    at_old = at_free[:2] + 0.5 * h * to_p
    turn = -omega * _dot(at_old, perpendicular(arm)) - _dot(to_p, arm)
    total = total + turn * unit[_THETA][:, None] * unit[_THETA] - _mixed(_dot(at_old, arm), unit[_THETA], unit[_OMEGA])
    half = unit[_THETA] + 0.5 * h * unit[_OMEGA]
    total = total - free.gain * _dot(at_free[:2], free.push) * half[:, None] * half
    across = rotate(-theta - 0.5 * h * omega, -perpendicular(at_free[:2]))
    spread = free.gain * jnp.zeros(9, x.dtype).at[6:8].set(across)
    total = total + _mixed(jnp.ones_like(theta), half, spread)
    return total, jnp.sum(at_free[:, None] * free.rows[:, 6:], axis=0)


def _lyapunov_part(problem: PushProblem, motion: Motion, wrench_B: Array, data: StageData) -> tuple[Array, Array]:
    """Weighted Hessian [9, 9] of the Lyapunov condition by (pose, twist, wrench), gradient [3] by the wrench."""
    team = problem.shapes.team
    place = 6 * motion.force.shape[0] + team.pair_bounds.shape[0]

    def condition(y: Array) -> Array:
        return problem.lyapunov(y[:3], y[3:6], y[6:], data)

    y = jnp.concatenate([motion.pose, motion.twist, wrench_B])
    value, gradient = jax.value_and_grad(condition)(y)
    weight = _slopes(problem, value[None], place)[0]
    return weight * jax.jacfwd(jax.grad(condition))(y), weight * gradient[6:]


def _slopes(problem: PushProblem, h: Array, first: int) -> Array:
    """P' [m] of the inequalities h [m] that begin at row `first`."""
    rows = jax.tree.map(lambda v: v[first : first + h.shape[0]], problem.barriers)
    return relaxed_barrier(h, problem.config.horizon.dt * rows.weight, rows.switch, rows.reach).slope


def _object_part(
    problem: PushProblem, motion: Motion, by_z: Array, by_acceleration: Array, data: StageData
) -> tuple[Array, Array]:
    """Curvature [nz, nz] of the object's conditions at given curvature of the acceleration, gradient [3] by it."""
    settings, shapes = problem.config.constraints, problem.shapes
    discs = constraints.object_discs(motion, shapes)
    first = 6 * motion.force.shape[0] + shapes.team.pair_bounds.shape[0] + 1

    def condition(v: Array, obstacle: constraints.Obstacle) -> Array:
        return constraints.object_condition(v[:2], v[2:4], v[4:], obstacle, settings)

    six = jnp.concatenate([discs.centers, discs.speeds, discs.pulls], axis=1)
    curved, gradient = _weighted(problem, condition, six, data.obstacles.objects, first)
    at_center, at_speed, at_pull = gradient[:, :2], gradient[:, 2:4], gradient[:, 4:]
    omega, alpha = motion.twist[2], motion.acceleration[2]
    arm = discs.centers - motion.pose[:2]
    turned = perpendicular(arm)
    theta, spin, swing = by_z[_THETA], by_z[_OMEGA], by_acceleration[2]
    rows = jnp.concatenate(
        [
            by_z[:2] + turned[..., None] * theta,
            by_z[3:5] - omega * arm[..., None] * theta + turned[..., None] * spin,
            by_acceleration[:2]
            - (alpha * arm + omega**2 * turned)[..., None] * theta
            - 2.0 * omega * arm[..., None] * spin
            + turned[..., None] * swing,
        ],
        axis=1,
    )
    total = jnp.sum(_congruent(curved, rows), axis=0)
    out, around = _dot(at_pull, arm), _dot(at_pull, turned)
    bend = jnp.sum(-_dot(at_center, arm) - omega * _dot(at_speed, turned) - alpha * around + omega**2 * out)
    total = total + bend * theta[:, None] * theta - 2.0 * jnp.sum(out) * spin[:, None] * spin
    total = total + _mixed(jnp.sum(-_dot(at_speed, arm) - 2.0 * omega * around), theta, spin)
    total = total + _mixed(-jnp.sum(out), theta, swing)
    return total, jnp.append(jnp.sum(at_pull, axis=0), jnp.sum(around))


def _robot_part(problem: PushProblem, motion: Motion, by_z: Array, data: StageData) -> Array:
    """Curvature [nz, nz] of the robots' conditions."""
    settings, shapes = problem.config.constraints, problem.shapes
    n = motion.force.shape[0]
    discs = constraints.robot_discs(motion, shapes)
    objects = shapes.object_radii.shape[0] * shapes.obstacle_mask.shape[0]
    first = 6 * n + shapes.team.pair_bounds.shape[0] + 1 + objects

    def condition(v: Array, obstacle: constraints.Obstacle) -> Array:
        return constraints.robot_condition(v[:2], v[2:], obstacle, settings)

    four = jnp.concatenate([discs.centers, discs.speeds], axis=1)
    curved, gradient = _weighted(problem, condition, four, data.obstacles.robots, first)
    at_center, at_speed = gradient[:, :2], gradient[:, 2:]
    omega = motion.twist[2]
    arm = discs.centers - motion.pose[:2]
    turned = perpendicular(arm)
    along = jnp.repeat(rotate(motion.pose[2], shapes.team.tangent), ROBOT_DISCS, axis=0)
    across = perpendicular(along)
    rate = jnp.repeat(motion.offset_rate, ROBOT_DISCS)
    theta, spin = by_z[_THETA], by_z[_OMEGA]
    offset = jnp.repeat(by_z[6 : 6 + n], ROBOT_DISCS, axis=0)
    slide = jnp.repeat(by_z[6 + 2 * n :], ROBOT_DISCS, axis=0)
    rows = jnp.concatenate(
        [
            by_z[:2] + turned[..., None] * theta + along[..., None] * offset[:, None],
            by_z[3:5]
            + (rate[:, None] * across - omega * arm)[..., None] * theta
            + turned[..., None] * spin
            + omega * across[..., None] * offset[:, None]
            + along[..., None] * slide[:, None],
        ],
        axis=1,
    )
    bend = -_dot(at_center, arm) - omega * _dot(at_speed, turned) - rate * _dot(at_speed, along)
    total = _congruent(curved, rows) + bend[:, None, None] * theta[:, None] * theta
    total = total + _mixed(
        -_dot(at_speed, arm), jnp.broadcast_to(theta, offset.shape), jnp.broadcast_to(spin, offset.shape)
    )
    lead = _dot(at_speed, across)
    total = total + _mixed(
        _dot(at_center, across) - omega * _dot(at_speed, along), jnp.broadcast_to(theta, offset.shape), offset
    )
    total = total + _mixed(lead, jnp.broadcast_to(spin, offset.shape), offset)
    return jnp.sum(total + _mixed(lead, jnp.broadcast_to(theta, offset.shape), slide), axis=0)


def _weighted(
    problem: PushProblem,
    condition: Callable[[Array, constraints.Obstacle], Array],
    motions: Array,
    obstacles: constraints.Obstacle,
    first: int,
) -> tuple[Array, Array]:
    """Hessians [K, m, m] and gradients [K, m] of conditions of discs in motion [K, m], by P' summed over obstacles."""

    def slope(v: Array, obstacle: constraints.Obstacle) -> tuple[Array, tuple[Array, Array]]:
        value, gradient = jax.value_and_grad(condition)(v, obstacle)
        return gradient, (value, gradient)

    every = jax.vmap(jax.vmap(jax.jacfwd(slope, has_aux=True), (None, 0)), (0, 0))
    curved, (values, gradients) = every(motions, obstacles)
    weight = _slopes(problem, values.reshape(-1), first).reshape(values.shape)
    return jnp.sum(weight[..., None, None] * curved, axis=1), jnp.sum(weight[..., None] * gradients, axis=1)
