"""What the Gauss-Newton Hessian of a stage of `problem.PushProblem` leaves out: curvature of dynamics and conditions.

That is the Hessian by z = [x, u] of lambda' f(z) + sum_i P'(h_i) h_i(z) with the slopes P' held, needed for derivatives
of the optimum (`solver.implicit`). Composed of small pieces, like the model itself: the friction step in three
variables, the Lyapunov condition in nine, a barrier in the motion of one disc; rigid motion between them is written
out. The tests hold it against automatic differentiation.
"""

from __future__ import annotations

import dataclasses
from typing import TYPE_CHECKING, NamedTuple

import jax
import jax.numpy as jnp
from jax import Array

from jaxlocomanip.planar import dynamics
from jaxlocomanip.planar.geometry import cross, perpendicular, rotate
from jaxlocomanip.planar.vector import unit, vector
from jaxlocomanip.planner import barriers
from jaxlocomanip.planner.constraints import Motion
from jaxlocomanip.planner.penalty import relaxed_barrier
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
    discs, by_pull = _disc_part(problem, motion, by_z, by_acceleration, data)

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
    return discs + _congruent(core + conditioned, rows) + bilinear + bilinear.T


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
    basis = jnp.eye(9, dtype=x.dtype)
    by_spin = jnp.sum(jax.jacfwd(after)(free.value)[2][:, None] * free.rows, axis=0)
    by_heading = basis[_THETA] + 0.5 * h * (basis[_OMEGA] + by_spin)
    bend = _dot(to_p, end) + new[2] * _dot(to_v, perpendicular(end))
    total = _congruent(curved, free.rows) + bend * by_heading[:, None] * by_heading
    total = total + _mixed(_dot(to_v, end), by_heading, by_spin)
    # The old velocity bends with the heading, the push with the heading half-way.
    at_old = at_free[:2] + 0.5 * h * to_p
    turn = -omega * _dot(at_old, perpendicular(arm)) - _dot(to_p, arm)
    total = (
        total + turn * basis[_THETA][:, None] * basis[_THETA] - _mixed(_dot(at_old, arm), basis[_THETA], basis[_OMEGA])
    )
    half = basis[_THETA] + 0.5 * h * basis[_OMEGA]
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


def _disc_part(
    problem: PushProblem, motion: Motion, by_z: Array, by_acceleration: Array, data: StageData
) -> tuple[Array, Array]:
    """Curvature [nz, nz] of the discs' conditions at given curvature of the acceleration, gradient [3] by it."""
    n = motion.force.shape[0]
    curved, gradient, moving, sliding = _weighted(problem, motion, data)
    at_center, at_speed, at_pull = gradient[:, :2], gradient[:, 2:4], gradient[:, 4:]
    omega, alpha = motion.twist[2], motion.acceleration[2]
    arm, along = (jnp.stack([v.x, v.y], axis=1) for v in (moving.arm, moving.slide))
    turned, across, rate = perpendicular(arm), perpendicular(along), sliding
    owned = barriers.by_disc(jnp.eye(n, dtype=arm.dtype), problem.shapes)
    offset = jnp.sum(owned[:, :, None] * by_z[6 : 6 + n], axis=1)
    slide = jnp.sum(owned[:, :, None] * by_z[6 + 2 * n :], axis=1)
    theta, spin = (jnp.broadcast_to(by_z[i], offset.shape) for i in (_THETA, _OMEGA))
    swing = jnp.broadcast_to(by_acceleration[2], offset.shape)
    rows = jnp.concatenate(
        [
            by_z[:2] + turned[..., None] * theta[:, None] + along[..., None] * offset[:, None],
            by_z[3:5]
            + (rate[:, None] * across - omega * arm)[..., None] * theta[:, None]
            + turned[..., None] * spin[:, None]
            + omega * across[..., None] * offset[:, None]
            + along[..., None] * slide[:, None],
            by_acceleration[:2]
            - (alpha * arm + omega**2 * turned)[..., None] * theta[:, None]
            - 2.0 * omega * arm[..., None] * spin[:, None]
            + turned[..., None] * swing[:, None],
        ],
        axis=1,
    )
    out, around, lead = _dot(at_pull, arm), _dot(at_pull, turned), _dot(at_speed, across)
    bend = -_dot(at_center, arm) - omega * _dot(at_speed, turned) - rate * _dot(at_speed, along)
    bend = bend - alpha * around + omega**2 * out
    total = _congruent(curved, rows) + 0.5 * _mixed(bend, theta, theta) - _mixed(out, spin, spin)
    total = total + _mixed(-_dot(at_speed, arm) - 2.0 * omega * around, theta, spin) - _mixed(out, theta, swing)
    total = total + _mixed(_dot(at_center, across) - omega * _dot(at_speed, along), theta, offset)
    total = total + _mixed(lead, spin, offset) + _mixed(lead, theta, slide)
    return jnp.sum(total, axis=0), jnp.append(jnp.sum(at_pull, axis=0), jnp.sum(around))


def _weighted(problem: PushProblem, motion: Motion, data: StageData) -> tuple[Array, Array, barriers.DiscMotion, Array]:
    """Hessians [D, 6, 6] and gradients [D, 6] of the discs' conditions by centre, velocity and acceleration.

    They are weighted by P' and summed over obstacles. Also the motion of the discs, leaves [D], and their rates of
    sliding [D].
    """
    settings, shapes, heading = problem.config.constraints, problem.shapes, unit(motion.pose[2])
    every, sliding = barriers.discs(shapes, settings), barriers.by_disc(motion.offset_rate, shapes)
    moving = jax.vmap(barriers.disc_motion, (0, 0, 0, None, None))(
        every, barriers.by_disc(motion.offset, shapes), sliding, motion, heading
    )

    def condition(v: Array, disc: barriers.Discs, obstacle: barriers.Obstacles) -> Array:
        now = dataclasses.replace(moving, center=vector(v), speed=vector(v[2:]), pull=vector(v[4:]))
        return barriers.condition(disc, now, barriers.approach(disc, now.center, obstacle), obstacle, settings)

    def slope(v: Array, disc: barriers.Discs, obstacle: barriers.Obstacles) -> tuple[Array, tuple[Array, Array]]:
        value, gradient = jax.value_and_grad(condition)(v, disc, obstacle)
        return gradient, (value, gradient)

    per_obstacle = jax.vmap(jax.jacfwd(slope, has_aux=True), (None, None, 0))
    seen = barriers.Obstacles(feature=0, place=None, drift=None, rounding=None)  # pyright: ignore[reportArgumentType]
    parts = (moving.center, moving.speed, moving.pull)
    six = jnp.stack([component for v in parts for component in (v.x, v.y)], axis=1)
    curved, (values, gradients) = jax.vmap(per_obstacle, (0, 0, seen))(six, every, data.obstacles)
    first = 6 * motion.force.shape[0] + shapes.team.pair_bounds.shape[0] + 1
    weight = _slopes(problem, values.reshape(-1), first).reshape(values.shape)
    curved, gradient = jnp.sum(weight[..., None, None] * curved, axis=1), jnp.sum(weight[..., None] * gradients, axis=1)
    return curved, gradient, moving, sliding
