"""What the Gauss-Newton Hessian of `problem.PushProblem` leaves out: curvature of dynamics and conditions.

That is the Hessian by z = [x, u] of lambda' f(z) + sum_i P'(h_i) h_i(z) with the slopes P' held, needed for derivatives
of the optimum (`solver.implicit`). Composed of small pieces, like the model itself: the friction step in three
variables, the Lyapunov condition in nine, a barrier in the motion of one disc; rigid motion between them is written
out, and so are the barriers. Arrays have stages last, as in `linearisation`. The tests hold it against automatic
differentiation.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import TYPE_CHECKING

import jax
import jax.numpy as jnp
from jax import Array

from jaxlocomanip.numerics import apart
from jaxlocomanip.planar import dynamics
from jaxlocomanip.planar.geometry import cross
from jaxlocomanip.planar.vector import Vector, trailing, unit, vector
from jaxlocomanip.planner import disc_curvature, linearisation
from jaxlocomanip.planner.constraints import Motion
from jaxlocomanip.planner.penalty import relaxed_barrier
from jaxlocomanip.solver.layout import added, times, transposed_times

if TYPE_CHECKING:
    from jaxlocomanip.planner.problem import PushProblem, StageData

_THETA, _OMEGA = 2, 5


def curvature(problem: PushProblem, x: Array, u: Array, multiplier: Array, data: StageData) -> Array:
    """[nz, nz, N] curvature of all stages.

    Args:
      problem: the optimal control problem.
      x: [nx, N] states.
      u: [nu, N] inputs.
      multiplier: lambda [nx, N] of the next states.
      data: of the stages.
    """
    n = x.shape[0] - 6
    dt, team = problem.config.horizon.dt, problem.shapes.team
    step = linearisation.linear_step(problem, x, u)
    motion = Motion(x[:3], x[3:6], (step.following[3:6] - x[3:6]) / dt, u[:n], x[6:], u[n:])
    by_acceleration = (step.jacobian[3:6] - jnp.eye(3, 6 + 3 * n, 3, dtype=x.dtype)[..., None]) / dt

    def weights(h: Array, first: int) -> Array:
        return _slopes(problem, h, first)

    place = 6 * n + team.pair_bounds.shape[0]
    discs, by_pull = disc_curvature.disc_part(problem, motion, by_acceleration, data, lambda h: weights(h, place + 1))
    # The acceleration is part of the next state, so what pulls at it adds to the multiplier.
    pulled = jnp.concatenate([multiplier[:3], multiplier[3:6] + by_pull / dt])
    core, by_wrench = _step_part(problem, x, step.wrench, pulled)
    clf, by_motion, conditioned = _lyapunov_part(problem, motion, step.wrench, data)
    weight = weights(clf[None], place)[0]
    levers = trailing(cross(team.tangent, team.normal), u[:n]) * (by_wrench[2] + weight * by_motion[8])
    return discs + _by_inputs(core + weight * conditioned, step.wrench_rows, levers)


@apart
def _by_inputs(core: Array, wrench_rows: Array, levers: Array) -> Array:
    """[nz, nz, N] of a Hessian [9, 9, N] by pose, twist and wrench.

    Args:
      core: the Hessian.
      wrench_rows: [2 N_r, 3, N] derivatives of the wrench by offsets and forces.
      levers: [N_r, N] mixed derivatives by each robot's offset and force, at a given Hessian by the wrench.
    """
    rows = jnp.swapaxes(wrench_rows, 0, 1)
    n = levers.shape[0]
    pairs = jnp.eye(n, dtype=core.dtype)[..., None] * levers[:, None]
    none = jnp.zeros_like(pairs)
    bilinear = jnp.concatenate([jnp.concatenate([none, pairs], 1), jnp.concatenate([pairs, none], 1)])
    across = times(core[:6, 6:], rows)
    inputs = transposed_times(rows, times(core[6:, 6:], rows)) + bilinear
    above = jnp.concatenate([core[:6, :6], across], axis=1)
    below = jnp.concatenate([jnp.swapaxes(across, 0, 1), inputs], axis=1)
    # Rates of the offsets enter nothing but the discs, and linearly.
    return jnp.pad(jnp.concatenate([above, below]), ((0, n), (0, n), (0, 0)))


def _mixed(one: Array, other: Array) -> Array:
    """One other' + other one', [m, N] -> [m, m, N]."""
    product = one[:, None] * other
    return product + jnp.swapaxes(product, 0, 1)


def _hessian(function: Callable[[Array], Array], at: Array) -> Array:
    """[m, m, N] derivatives of a function [m, N] -> [m, N], every column of N for itself."""
    basis = jnp.broadcast_to(jnp.eye(at.shape[0], dtype=at.dtype)[..., None], (at.shape[0], *at.shape))
    return jax.vmap(lambda way: jax.jvp(function, (at,), (way,))[1])(basis)


def _free(problem: PushProblem, x: Array, push: Vector, moment: Array) -> tuple[Array, list[Array]]:
    """The velocity at the centre of mass before friction acts, [3, N], and its derivatives by pose, twist and wrench.

    Those are [9, N] of each component; the wrench is in body axes, and `push` its force half-way through the step.
    """
    body, h = problem.body, problem.config.horizon.dt
    omega, com = x[_OMEGA], vector(body.com)
    arm, middle = com.rotated(unit(x[_THETA])), unit(x[_THETA] + 0.5 * h * omega)
    gain, spin = h / body.mass, h / body.central_inertia
    none, one = jnp.zeros_like(omega), jnp.ones_like(omega)
    by_theta, by_omega = push.turned * gain - arm * omega, arm.turned + push.turned * (0.5 * h * gain)
    along, aside = middle * gain, middle.turned * gain
    value = vector(x[3:5]) + arm.turned * omega + push * gain
    rows = [
        jnp.stack([none, none, by_theta.x, one, none, by_omega.x, along.x, aside.x, none]),
        jnp.stack([none, none, by_theta.y, none, one, by_omega.y, along.y, aside.y, none]),
        jnp.stack([none, none, none, none, none, one, spin * com.y * one, -spin * com.x * one, spin * one]),
    ]
    return jnp.stack([value.x, value.y, omega + spin * moment]), rows


@apart
def _step_part(problem: PushProblem, x: Array, wrench_B: Array, multiplier: Array) -> tuple[Array, Array]:
    """Hessian [9, 9, N] of multiplier [6, N]' (pose, twist after the step) by (pose, twist, wrench in body axes).

    Also its gradient [3, N] by the wrench.
    """
    body, horizon = problem.body, problem.config.horizon
    h, theta, omega, com = horizon.dt, x[_THETA], x[_OMEGA], vector(problem.body.com)
    inertia = jnp.stack([body.mass, body.mass, body.central_inertia])
    to_p, to_v = vector(multiplier), vector(multiplier[3:])
    arm, middle = com.rotated(unit(theta)), unit(theta + 0.5 * h * omega)
    push = vector(wrench_B).rotated(middle)
    free, free_rows = _free(problem, x, push, wrench_B[2] - com.cross(vector(wrench_B)))
    rows = jnp.stack(free_rows)

    def after(v: Array) -> Array:
        return dynamics.friction_step(inertia, body.friction_force, body.friction_moment, v, h, horizon.smoothing)

    new, pullback = jax.vjp(after, free)
    heading = theta + 0.5 * h * (omega + new[2])
    end = com.rotated(unit(heading))
    at_heading = multiplier[2] - to_p.dot(end.turned) + new[2] * to_v.dot(end)
    at_spin = 0.5 * h * at_heading - to_v.dot(end.turned) + multiplier[5]
    at_new = jnp.stack([0.5 * h * to_p.x + to_v.x, 0.5 * h * to_p.y + to_v.y, at_spin])
    curved = _hessian(lambda v: jax.vjp(after, v)[1](at_new)[0], free)
    (at_free,) = pullback(at_new)
    (of_spin,) = pullback(jnp.zeros_like(free).at[2].set(1.0))
    by_spin = added([change * row for change, row in zip(of_spin, free_rows, strict=True)])
    basis = jnp.eye(9, dtype=x.dtype)[..., None]
    by_heading = basis[_THETA] + 0.5 * h * (basis[_OMEGA] + by_spin)
    bend = to_p.dot(end) + new[2] * to_v.dot(end.turned)
    at_push, at_old = vector(at_free), vector(at_free) + to_p * (0.5 * h)
    # The old velocity bends with the heading, the push with the heading half-way.
    turn = -omega * at_old.dot(arm.turned) - to_p.dot(arm)
    half = basis[_THETA] + 0.5 * h * basis[_OMEGA]
    gain = h / body.mass
    across = at_push.turned.rotated(Vector(middle.x, -middle.y)) * -gain
    spread = basis[6] * across.x + basis[7] * across.y - 0.5 * gain * at_push.dot(push) * half
    total = transposed_times(rows, times(curved, rows)) + _mixed(by_heading, 0.5 * bend * by_heading)
    total = total + _mixed(by_heading, to_v.dot(end) * by_spin) + _mixed(half, spread)
    total = total + _mixed(basis[_THETA], 0.5 * turn * basis[_THETA] - at_old.dot(arm) * basis[_OMEGA])
    return total, added([change * row[6:] for change, row in zip(at_free, free_rows, strict=True)])


@apart
def _lyapunov_part(
    problem: PushProblem, motion: Motion, wrench_B: Array, data: StageData
) -> tuple[Array, Array, Array]:
    """The Lyapunov condition [N], its gradient [9, N] and Hessian [9, 9, N] by (pose, twist, wrench in body axes)."""

    def condition(y: Array) -> Array:
        return problem.lyapunov(y[:3], y[3:6], y[6:], data)

    def slope(y: Array) -> Array:
        value, pullback = jax.vjp(condition, y)
        return pullback(jnp.ones_like(value))[0]

    y = jnp.concatenate([motion.pose, motion.twist, wrench_B])
    return condition(y), slope(y), _hessian(slope, y)


def _slopes(problem: PushProblem, h: Array, first: int) -> Array:
    """P' [m, N] of the inequalities h [m, N] that begin at row `first`."""
    rows = jax.tree.map(lambda v: trailing(v[first : first + h.shape[0]], h), problem.barriers)
    return relaxed_barrier(h, problem.config.horizon.dt * rows.weight, rows.switch, rows.reach).slope
