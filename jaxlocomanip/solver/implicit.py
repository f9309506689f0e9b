"""Derivatives of an optimal plan with respect to everything in its problem, by the implicit function theorem.

A local optimum satisfies the stationarity conditions of the Lagrangian

    L = sum_k l_k(x_k, u_k) + Phi(x_N) + sum_k lambda_{k+1}' (f_k(x_k, u_k) - x_{k+1}) + lambda_0' (x_0 - x0),

whose matrix K, the *exact* Hessian of L bordered by the Jacobian of the dynamics, is that of a linear-quadratic
subproblem. So a derivative is one more Riccati solve, K [dz, dlambda] = -d(stationarity), in either direction; the
iterations that led to the plan are neither stored nor differentiated. The Gauss-Newton Hessian of the solver would
not do: it gives the same optimum but not its derivative, unless residuals, multipliers and barrier slopes vanish.

    plan = implicit.solve(problem, x0, start(guess, options), options).plan     # solves; jax.grad, jax.jvp, jit, vmap
    plan = implicit.plan_of(problem, x0, plan)                                  # the same for a plan that is there
"""

from __future__ import annotations

import dataclasses
from typing import Any, Protocol, runtime_checkable

import jax
import jax.numpy as jnp
from jax import Array
from jax.flatten_util import ravel_pytree

from jaxlocomanip.numerics import all_finite, pytree, select
from jaxlocomanip.solver import riccati, sqp
from jaxlocomanip.solver.ocp import Plan, Problem, Stage, StageModel, stage_models, stage_values
from jaxlocomanip.solver.riccati import LinearQuadratic
from jaxlocomanip.solver.sqp import Iterate, Options, Status

POLISH = 6
"""Newton steps at most after the solver: from where its merit function sees no difference any more, to rounding"""


@pytree
class Solution:
    """An optimal plan."""

    plan: Plan
    """differentiable in the problem and in x0"""
    status: Array
    """[] int, `sqp.Status`"""
    step: Array
    """[] largest component of the last Newton step: how far the plan was from stationary"""
    iterations: Array
    """[] int, iterations of the solver"""


@runtime_checkable
class Curved(Protocol):
    """A problem that knows the curvature of its stages; of others it comes from automatic differentiation."""

    def curvature(self, plan: Plan, multipliers: Array) -> Array:
        """What the stages' models leave out: Hessians [N, nz, nz] of multiplier' f + r' r + P'(h)' h.

        The first r and P' are held; multipliers [N, nx] are those of the next states.
        """
        ...


@pytree
class Stationarity:
    """What must vanish or hold at an optimum, or a right-hand side of the system that its derivative solves."""

    states: Array
    """[N + 1, nx] by x_k"""
    inputs: Array
    """[N, nu] by u_k"""
    dynamics: Array
    """[N + 1, nx] by lambda_k: of x_0 and of each step"""


def solve(problem: Problem, x0: Array, guess: Iterate, options: Options, limit: int = 200) -> Solution:
    """Iterate to a stationary plan, which is differentiable.

    The solver runs until its step is below `options.tolerance`; Newton steps on the stationarity conditions follow,
    as long as each is smaller than the one before. They are kept where the solver or they themselves converged: far
    from an optimum the exact Hessian may be indefinite, and a full step lead anywhere.

    Memory does not grow with the iterations. Under `vmap` all lanes iterate until the last one has finished.

    A plan that did not converge has the derivative of `plan_of` at the point where it stopped: finite, wrong by as
    much as `step` is large, and to be judged by `status`.

    Args:
      problem: the optimal control problem.
      x0: [nx] initial state.
      guess: result of `sqp.start` or of an earlier solve.
      options: solver settings.
      limit: calls of the solver at most, each of `options.iterations` iterations.
    """
    fixed, first, warm = jax.lax.stop_gradient((problem, x0, guess))
    done, count = sqp.converge(fixed, first, warm, options, limit)
    polished, step = polish(fixed, first, done.plan)
    stationary = (step < options.tolerance) | (done.status == Status.CONVERGED)
    plan = select(stationary, polished, done.plan)
    status = jnp.where(stationary, Status.CONVERGED, done.status)
    status = jnp.where(all_finite(plan), status, Status.NONFINITE).astype(jnp.int32)
    return Solution(plan_of(problem, x0, plan), status, step, count * options.iterations)


def polish(problem: Problem, x0: Array, plan: Plan) -> tuple[Plan, Array]:
    """Newton steps on the stationarity conditions from a plan that nearly meets them, and the last step's size [].

    A step that is not smaller than the one before it is not taken, nor are any after it.
    """
    start = Plan(plan.xs.at[0].set(x0), plan.us)

    def going(carry: tuple[Plan, Array, Array, Array]) -> Array:
        return carry[3] & (carry[2] < POLISH)

    def step(carry: tuple[Plan, Array, Array, Array]) -> tuple[Plan, Array, Array, Array]:
        plan, last, count, _ = carry
        lq, _ = kkt(problem, plan)
        direction = riccati.solve(lq, jnp.zeros_like(x0), 0.0, definite=False)
        size = jnp.maximum(jnp.max(jnp.abs(direction.dxs)), jnp.max(jnp.abs(direction.dus)))
        better = size < last
        new = Plan(plan.xs + direction.dxs, plan.us + direction.dus)
        return select(better, new, plan), jnp.where(better, size, last), count + 1, better

    far = jnp.full((), jnp.inf, plan.xs.dtype)
    polished, size, _, _ = jax.lax.while_loop(going, step, (start, far, jnp.zeros((), jnp.int32), jnp.ones((), bool)))
    return polished, size


@jax.custom_jvp
def plan_of(problem: Problem, x0: Array, plan: Plan) -> Plan:
    """The plan itself, as a function of its problem and initial state.

    Both modes of differentiation, `jit` and `vmap` apply. The tangent of the argument `plan` is not used: an optimum
    does not depend on where it was found.

    The derivative is exact where the plan is stationary and the matrix of its conditions invertible (a strict local
    minimum is enough). Elsewhere it is that matrix's answer at the plan as it is, with an error that grows with the
    distance to the optimum. A plan with numbers that are not finite, or a derivative that is not, counts as constant;
    but in reverse mode by a problem that is itself not finite, of which zero times infinity spoils the slopes.
    Whatever the problem holds fixed is held fixed: for the planner, which corner or edge each disc is held against.

    Args:
      problem: the optimal control problem.
      x0: [nx] initial state.
      plan: a local optimum, of the problem, from x0.
    """
    del problem, x0
    return plan


@plan_of.defjvp
def _plan_of_jvp(primals: tuple[Any, ...], tangents: tuple[Any, ...]) -> tuple[Plan, Plan]:
    problem, x0, plan = primals
    lq, costates = kkt(problem, plan)

    def conditions(problem: Problem, x0: Array) -> Stationarity:
        return stationarity(problem, x0, plan, costates)

    _, change = jax.jvp(conditions, (problem, x0), tangents[:2])
    solution = _solve_linear(lq, jax.tree.map(jnp.negative, change))
    return plan, Plan(solution.states, solution.inputs)


def costates(problem: Problem, plan: Plan) -> tuple[Array, StageModel]:
    """Multipliers lambda [N + 1, nx] of the dynamics that make L stationary in the states, by the adjoint recursion.

    Also the Gauss-Newton models of the stages, leaves [N, ...].
    """
    models = stage_models(problem, plan)
    nx = plan.xs.shape[1]
    last = terminal_slope(problem, plan.xs[-1])

    def backward(after: Array, k: tuple[Array, Array]) -> tuple[Array, Array]:
        gradient, dynamics = k
        now = gradient[:nx] + jnp.sum(after[:, None] * dynamics[:, :nx], axis=0)
        return now, now

    _, earlier = jax.lax.scan(backward, last, (models.gradient, models.dynamics), reverse=True)
    return jnp.concatenate([earlier, last[None]]), models


def kkt(problem: Problem, plan: Plan) -> tuple[LinearQuadratic, Array]:
    """The subproblem whose solution is the Newton step of the stationarity conditions, and the multipliers.

    Its Hessian is that of the Lagrangian, exact, and may be indefinite.
    """
    multipliers, models = costates(problem, plan)
    if isinstance(problem, Curved):
        hessian = models.hessian + problem.curvature(plan, multipliers[1:])
    else:
        nx = plan.xs.shape[1]

        def slope(z: Array, multiplier: Array, data: Any) -> Array:
            return stage_slope(problem, z[:nx], z[nx:], multiplier, data)[0]

        zs = jnp.concatenate([plan.xs[:-1], plan.us], axis=1)
        exact = jax.vmap(jax.jacfwd(slope))(zs, multipliers[1:], problem.stages)
        hessian = 0.5 * (exact + exact.transpose(0, 2, 1))
    final_hessian = jax.jacfwd(lambda x: terminal_slope(problem, x))(plan.xs[-1])
    final_gradient = terminal_slope(problem, plan.xs[-1])
    defect = models.next_state - plan.xs[1:]
    lq = LinearQuadratic(hessian, models.gradient, models.dynamics, defect, final_hessian, final_gradient)
    return lq, multipliers


def stage_slope(problem: Problem, x: Array, u: Array, multiplier: Array, data: Any) -> tuple[Array, Array]:
    """Gradient [nz] of l_k + lambda_{k+1}' f_k by z = [x, u], and the next state [nx]."""
    nx = x.shape[0]

    def values(z: Array) -> Stage:
        return problem.stage(z[:nx], z[nx:], data)

    stage, pullback = jax.vjp(values, jnp.concatenate([x, u]))
    slope = problem.penalty(stage.inequality, data).slope
    (by_z,) = pullback(Stage(multiplier, stage.residual, slope))
    return by_z, stage.next_state


def terminal_slope(problem: Problem, x: Array) -> Array:
    """Gradient [nx] of the terminal cost."""
    residual, pullback = jax.vjp(problem.terminal, x)
    return pullback(residual)[0]


def stationarity(problem: Problem, x0: Array, plan: Plan, multipliers: Array) -> Stationarity:
    """Derivatives of L by states, inputs and multipliers, less what does not depend on the problem or on x0."""

    def values(plan: Plan) -> tuple[tuple[Array, Array], Array]:
        # Values of all stages at once: how a problem is evaluated fastest.
        costs, following = stage_values(problem, plan)
        return (costs, following), following

    _, pullback, following = jax.vjp(values, plan, has_aux=True)
    (by_plan,) = pullback((jnp.ones_like(following[:, 0]), multipliers[1:]))
    by_x = by_plan.xs.at[-1].add(terminal_slope(problem, plan.xs[-1]))
    return Stationarity(by_x, by_plan.us, jnp.concatenate([x0[None], following]))


def _solve_linear(lq: LinearQuadratic, right: Stationarity) -> Stationarity:
    """Solve K w = right, linear in `right` and its own transpose: K is symmetric."""
    # One vector, because a transpose is only taken of right-hand sides that are linear in all their parts.
    flat, shaped = ravel_pytree(right)
    nx = right.states.shape[1]

    def product(vector: Array) -> Array:
        w = shaped(vector)
        z = jnp.concatenate([w.states[:-1], w.inputs], axis=1)
        by_z = jnp.einsum("kij,kj->ki", lq.hessian, z) + jnp.einsum("kij,ki->kj", lq.dynamics, w.dynamics[1:])
        last = lq.final_hessian @ w.states[-1]
        following = jnp.einsum("kij,kj->ki", lq.dynamics, z)
        by_x = jnp.concatenate([by_z[:, :nx], last[None]]) - w.dynamics
        rows = jnp.concatenate([jnp.zeros((1, nx), z.dtype), following]) - w.states
        return ravel_pytree(Stationarity(by_x, by_z[:, nx:], rows))[0]

    def by_riccati(_: Any, vector: Array) -> Array:
        b = shaped(vector)
        gradient = -jnp.concatenate([b.states[:-1], b.inputs], axis=1)
        system = dataclasses.replace(lq, gradient=gradient, defect=-b.dynamics[1:], final_gradient=-b.states[-1])
        found = riccati.solve(system, -b.dynamics[0], 0.0, definite=False)
        w = ravel_pytree(Stationarity(found.dxs, found.dus, found.costates))[0]
        return jnp.where(jnp.all(jnp.isfinite(w)), w, 0.0)

    return shaped(jax.lax.custom_linear_solve(product, flat, by_riccati, by_riccati, symmetric=True))
