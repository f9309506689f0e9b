"""What an optimal control problem must offer to the solver.

    minimise   sum_{k<N} 1/2 |r_k(x_k, u_k)|^2 + sum_i P(h_k,i(x_k, u_k))  +  1/2 |r_N(x_N)|^2
    subject to x_{k+1} = f_k(x_k, u_k),  x_0 given,

with P a convex penalty of the inequalities h >= 0. A problem is a pytree (its arrays are arguments of the compiled
program, never closed over) whose per-stage data have a leading axis [N].
"""

from __future__ import annotations

from typing import Any, Protocol, runtime_checkable

import jax
import jax.numpy as jnp
from jax import Array

from jaxlocomanip.numerics import pytree


@pytree
class Stage:
    """What one stage evaluates to."""

    next_state: Array
    """[nx] f_k(x, u)"""
    residual: Array
    """[nr] r_k(x, u), weighted"""
    inequality: Array
    """[nh] h_k(x, u), wanted >= 0"""


@pytree
class Penalty:
    """Elementwise penalty of inequalities."""

    value: Array
    """[nh] P(h)"""
    slope: Array
    """[nh] P'(h)"""
    curvature: Array
    """[nh] P''(h), >= 0"""


@pytree
class StageModel:
    """Gauss-Newton model of one stage in z = [x, u]."""

    hessian: Array
    """[nz, nz] J_r' J_r + J_h' diag(P'') J_h"""
    gradient: Array
    """[nz] of the stage cost"""
    dynamics: Array
    """[nx, nz] Jacobian of f_k"""
    next_state: Array
    """[nx] f_k"""
    cost: Array
    """[] stage cost"""


@pytree
class Plan:
    """State and input trajectory."""

    xs: Array
    """[N + 1, nx]"""
    us: Array
    """[N, nu]"""


class Problem(Protocol):
    """A discretised optimal control problem."""

    @property
    def stages(self) -> Any:
        """Pytree of per-stage data, each leaf with leading axis [N]."""
        ...

    def stage(self, x: Array, u: Array, data: Any) -> Stage:
        """Evaluate one stage: x [nx], u [nu], data one slice of `stages`."""
        ...

    def penalty(self, h: Array, data: Any) -> Penalty:
        """Penalise the inequalities h [nh] of one stage."""
        ...

    def model(self, x: Array, u: Array, data: Any) -> StageModel:
        """Gauss-Newton model of one stage; `forward_model` serves any problem, a structured one may be faster."""
        ...

    def terminal(self, x: Array) -> Array:
        """Weighted terminal residual r_N(x) [nf]."""
        ...


@runtime_checkable
class WholeHorizon(Protocol):
    """What a problem may offer beside `Problem`: all stages of a horizon at once, where that is faster."""

    def values(self, plan: Plan) -> tuple[Array, Array]:
        """Cost [N] and next state [N, nx] of every stage."""
        ...

    def models(self, plan: Plan) -> StageModel:
        """Gauss-Newton models of all stages, leaves [N, ...]."""
        ...


def stage_values(problem: Problem, plan: Plan) -> tuple[Array, Array]:
    """Cost [N] and next state [N, nx] of every stage."""
    if isinstance(problem, WholeHorizon):
        return problem.values(plan)
    return jax.vmap(lambda x, u, data: stage_cost(problem, x, u, data))(plan.xs[:-1], plan.us, problem.stages)


def stage_models(problem: Problem, plan: Plan) -> StageModel:
    """Gauss-Newton models of all stages, leaves [N, ...]."""
    if isinstance(problem, WholeHorizon):
        return problem.models(plan)
    return jax.vmap(problem.model)(plan.xs[:-1], plan.us, problem.stages)


def stage_cost(problem: Problem, x: Array, u: Array, data: Any) -> tuple[Array, Array]:
    """Cost [] and next state [nx] of one stage."""
    values = problem.stage(x, u, data)
    cost = 0.5 * jnp.sum(values.residual**2) + jnp.sum(problem.penalty(values.inequality, data).value)
    return cost, values.next_state


def forward_model(problem: Problem, x: Array, u: Array, data: Any) -> StageModel:
    """Gauss-Newton model of one stage by forward differentiation of `problem.stage`."""
    nx = x.shape[0]

    def values(z: Array) -> tuple[Stage, Stage]:
        stage = problem.stage(z[:nx], z[nx:], data)
        return stage, stage

    jacobian, value = jax.jacfwd(values, has_aux=True)(jnp.concatenate([x, u]))
    penalty = problem.penalty(value.inequality, data)
    rows = jacobian.inequality
    return StageModel(
        hessian=jacobian.residual.T @ jacobian.residual + rows.T @ (penalty.curvature[:, None] * rows),
        gradient=jacobian.residual.T @ value.residual + rows.T @ penalty.slope,
        dynamics=jacobian.next_state,
        next_state=value.next_state,
        cost=0.5 * jnp.sum(value.residual**2) + jnp.sum(penalty.value),
    )
