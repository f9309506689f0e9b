"""Gauss-Newton sequential quadratic programming on a multiple-shooting problem.

Each iteration linearises every stage at once, solves the linear-quadratic subproblem by Riccati recursion and takes the
step of a fixed ladder of lengths with the least l1 merit

    phi = cost + nu sum_k |f_k(x_k, u_k) - x_{k+1}|_1,   nu > max |costate|.

Merits are compared by their changes, stage by stage: close to a minimum these are far less than what rounding does to
the whole. If no length decreases the merit the iterate stays and the Levenberg damping grows. Iteration counts are
fixed, so a batch of problems is one compiled program; a lane whose numbers become non-finite keeps its last finite
iterate.
"""

from __future__ import annotations

import dataclasses
from enum import IntEnum

import jax
import jax.numpy as jnp
from jax import Array

from jaxlocomanip.numerics import all_finite, pytree, select, static
from jaxlocomanip.solver.ocp import Plan, Problem, stage_models, stage_values
from jaxlocomanip.solver.riccati import LinearQuadratic
from jaxlocomanip.solver.riccati import solve as solve_lq


class Status(IntEnum):
    """How a solve ended."""

    CONVERGED = 0
    ITERATION_LIMIT = 1
    NO_DESCENT = 2
    NONFINITE = 3

    @property
    def sentence(self) -> str:
        """For people."""
        return {
            Status.CONVERGED: "converged: the last step is below the tolerance",
            Status.ITERATION_LIMIT: "stopped at the iteration limit while still descending",
            Status.NO_DESCENT: "no step length decreased the merit function",
            Status.NONFINITE: "infinite or NaN values met; the last finite iterate was kept",
        }[self]


@pytree
class Options:
    """Settings of the solver."""

    iterations: int = static(1)
    """iterations a call (static)"""
    step_lengths: tuple[float, ...] = static((1.0, 0.5, 0.2, 0.05))
    """ladder of step lengths tried side by side (static)"""
    tolerance: float = 1e-3
    """max |step| that counts as converged, in the units of states and inputs"""
    damping: float = 1e-6
    """least Levenberg damping of the inputs"""


@pytree
class Iterate:
    """State of the solver, carried from iteration to iteration and from tick to tick."""

    plan: Plan
    damping: Array
    """[] Levenberg damping"""
    cost: Array
    """[] objective at the plan"""
    defect: Array
    """[] l1 norm of the dynamics defects"""
    step: Array
    """[] max |step| last taken by the subproblem, before scaling by its length"""
    length: Array
    """[] step length last accepted (0: none)"""
    status: Array
    """[] int, `Status`"""


def start(plan: Plan, options: Options) -> Iterate:
    """Iterate at an initial guess."""
    zero = jnp.zeros((), plan.xs.dtype)
    return Iterate(plan, zero + options.damping, zero, zero, zero, zero, jnp.zeros((), jnp.int32))


def solve(problem: Problem, x0: Array, iterate: Iterate, options: Options, rival: Plan | None = None) -> Iterate:
    """`options.iterations` iterations from a warm start.

    Args:
      problem: the optimal control problem.
      x0: [nx] initial state; replaces the plan's.
      iterate: result of `start` or of an earlier solve.
      options: solver settings.
      rival: another plan from x0, tried beside the step lengths of the first iteration and kept if its merit is
        least. A local method cannot leave a minimum such as "push later, for ever"; a second start can.
    """
    current = dataclasses.replace(iterate, plan=Plan(iterate.plan.xs.at[0].set(x0), iterate.plan.us))
    rest = options.iterations
    if rival is not None:
        current, rest = _iteration(problem, current, options, rival), rest - 1
    if rest == 0:
        return current

    def body(carry: Iterate, _: None) -> tuple[Iterate, None]:
        new = _iteration(problem, carry, options, None)
        # A problem may compute its cost in another precision than that of its states.
        return jax.tree.map(lambda leaf, old: leaf.astype(old.dtype), new, carry), None

    return jax.lax.scan(body, current, None, length=rest)[0]


def converge(problem: Problem, x0: Array, iterate: Iterate, options: Options, limit: int) -> tuple[Iterate, Array]:
    """`solve` called until the step is below `options.tolerance`, `limit` times at most; and how often, [].

    For plans that are wanted once, not every tick. A batch goes on until its last lane is through. There are no reverse
    derivatives; `implicit` has those of a converged plan.
    """
    fresh = dataclasses.replace(iterate, status=jnp.full_like(iterate.status, Status.ITERATION_LIMIT))

    def unfinished(carry: tuple[Iterate, Array]) -> Array:
        status, count = carry[0].status, carry[1]
        return ((status == Status.ITERATION_LIMIT) | (status == Status.NO_DESCENT)) & (count < limit)

    def again(carry: tuple[Iterate, Array]) -> tuple[Iterate, Array]:
        return solve(problem, x0, carry[0], options), carry[1] + 1

    return jax.lax.while_loop(unfinished, again, (fresh, jnp.zeros((), jnp.int32)))


def evaluate(problem: Problem, plan: Plan) -> tuple[Array, Array]:
    """Objective [] and l1 norm [] of the dynamics defects of a plan."""
    costs, nexts = stage_values(problem, plan)
    final = 0.5 * jnp.sum(problem.terminal(plan.xs[-1]) ** 2)
    return jnp.sum(costs) + final, jnp.sum(jnp.abs(nexts - plan.xs[1:]))


def rollout(problem: Problem, x0: Array, us: Array) -> Plan:
    """The plan that inputs [N, nu] lead to from x0 [nx]; its defects are zero."""

    def step(x: Array, k: tuple[Array, object]) -> tuple[Array, Array]:
        new = problem.stage(x, *k).next_state
        return new, new

    _, xs = jax.lax.scan(step, x0, (us, problem.stages))
    return Plan(jnp.concatenate([x0[None], xs]), us)


def linearise(problem: Problem, plan: Plan) -> tuple[LinearQuadratic, Array, Array]:
    """Gauss-Newton model at a plan (penalty Hessian J' diag(P'') J), its stages' costs [N] and last residual [nf]."""
    models = stage_models(problem, plan)
    residual = problem.terminal(plan.xs[-1])
    rows = jax.jacfwd(problem.terminal)(plan.xs[-1])
    defect = models.next_state - plan.xs[1:]
    lq = LinearQuadratic(models.hessian, models.gradient, models.dynamics, defect, rows.T @ rows, rows.T @ residual)
    return lq, models.cost, residual


def _iteration(problem: Problem, iterate: Iterate, options: Options, rival: Plan | None) -> Iterate:
    plan = iterate.plan
    lq, stage_costs, residual = linearise(problem, plan)
    direction = solve_lq(lq, jnp.zeros_like(plan.xs[0]), iterate.damping)
    defect = jnp.sum(jnp.abs(lq.defect))
    weight = 1.5 * jnp.max(jnp.abs(direction.costates))
    lengths = jnp.asarray(options.step_lengths, plan.xs.dtype)
    tried = jax.vmap(lambda a: Plan(plan.xs + a * direction.dxs, plan.us + a * direction.dus))(lengths)
    if rival is not None:
        tried = jax.tree.map(lambda many, one: jnp.concatenate([many, one[None]]), tried, rival)
        lengths = jnp.append(lengths, 0.0)

    def change(other: Plan) -> tuple[Array, Array]:
        costs, nexts = stage_values(problem, other)
        final = problem.terminal(other.xs[-1])
        cost = jnp.sum(costs - stage_costs) + 0.5 * jnp.sum((final - residual) * (final + residual))
        return cost, jnp.sum(jnp.abs(nexts - other.xs[1:]))

    changed, defects = jax.vmap(change)(tried)
    merits = jnp.where(jnp.isfinite(changed + defects), changed + weight * (defects - defect), jnp.inf)
    best = jnp.argmin(merits)
    step = jnp.maximum(jnp.max(jnp.abs(direction.dxs)), jnp.max(jnp.abs(direction.dus)))
    finite = all_finite(direction) & jnp.isfinite(merits[best])
    small = step < options.tolerance
    accept = finite & ((merits[best] < 0.0) | small)
    progress = jnp.where(small, Status.CONVERGED, jnp.where(accept, Status.ITERATION_LIMIT, Status.NO_DESCENT))
    less = jnp.maximum(iterate.damping / 10.0, options.damping)
    chosen = jax.tree.map(lambda leaf: leaf[best], tried)
    cost = jnp.sum(stage_costs) + 0.5 * jnp.sum(residual**2)
    return Iterate(
        plan=select(accept, chosen, plan),
        damping=jnp.where(accept, less, jnp.minimum(iterate.damping * 30.0 + 1e-5, 1e6)),
        cost=jnp.where(accept, cost + changed[best], cost),
        defect=jnp.where(accept, defects[best], defect),
        step=step,
        length=jnp.where(accept, lengths[best], 0.0),
        status=jnp.where(finite, progress, Status.NONFINITE).astype(jnp.int32),
    )
