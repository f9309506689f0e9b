"""The equality-constrained linear-quadratic subproblem, solved by a Riccati recursion.

minimise   sum_{k<N} 1/2 z_k' H_k z_k + g_k' z_k  +  1/2 dx_N' H_N dx_N + g_N' dx_N,   z_k = [dx_k, du_k]
subject to dx_{k+1} = F_k z_k + c_k,   dx_0 given.

Batches have their lanes last, and what each step of a stage reads is computed apart (`layout`).
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from typing import Any

import jax
import jax.numpy as jnp
from jax import Array

from jaxlocomanip.numerics import Floats, apart, pytree, tiny
from jaxlocomanip.solver.layout import applied, lanes_last, times, transposed_applied, transposed_times

UNROLLED = 2
"""stages that one turn of the compiled loops takes for a problem alone; of many lanes, one stage is work enough"""


@pytree
class LinearQuadratic:
    """Data of the subproblem, nz = nx + nu."""

    hessian: Array
    """[N, nz, nz] symmetric H_k"""
    gradient: Array
    """[N, nz] g_k"""
    dynamics: Array
    """[N, nx, nz] F_k = [A_k, B_k]"""
    defect: Array
    """[N, nx] c_k = f_k(x_k, u_k) - x_{k+1}"""
    final_hessian: Array
    """[nx, nx]"""
    final_gradient: Array
    """[nx]"""


@pytree
class Direction:
    """Solution of the subproblem."""

    dxs: Array
    """[N + 1, nx]"""
    dus: Array
    """[N, nu]"""
    costates: Array
    """[N + 1, nx] multipliers of the dynamics, gradient of the cost to go at dx_k"""
    feedback: Array
    """[N, nu, nx] du = feedforward + feedback dx"""


def solve(lq: LinearQuadratic, dx0: Array, regularisation: Floats, definite: bool = True) -> Direction:
    """Backward Riccati sweep, then a forward pass; sequential in k.

    Args:
      lq: the subproblem; H_k + F_k' P F_k must be positive definite in u once regularised (but see `definite`).
      dx0: [nx] initial deviation.
      regularisation: >= 0, added to the diagonal of the input Hessian.
      definite: false for the stationary point of a subproblem that may have no minimum; then H_k + F_k' P F_k need only
        be invertible in u, and so must be its lower right minors.
    """
    sweeps = _minimum if definite else _stationary_point
    return sweeps(lq, dx0, jnp.asarray(regularisation, dx0.dtype))


def _sweeps(lq: LinearQuadratic, dx0: Array, damping: Array, trusted: Callable[[Array], Array]) -> Direction:
    """Both sweeps; all arrays may have trailing axes."""
    nx, nz = lq.dynamics.shape[1:3]
    unroll = UNROLLED if dx0.ndim == 1 else 1

    def backward(cost_to_go: tuple[Array, Array], k: tuple[Array, ...]) -> tuple[tuple[Array, Array], tuple[Any, ...]]:
        hessian, gradient, dynamics, defect = k
        matrix, vector = _total(hessian, gradient, dynamics, *_transported(*cost_to_go, dynamics, defect))
        policy = []
        for _ in range(nz - nx):
            pivot = trusted(matrix[-1, -1] + damping)
            row, constant = matrix[-1, :-1] / pivot, vector[-1] / pivot
            matrix, vector = _eliminated(matrix, vector, row, constant)
            policy.append((row, constant))
        return (matrix, vector), (policy[::-1], *cost_to_go)

    start = lq.final_hessian, lq.final_gradient
    stages = lq.hessian, lq.gradient, lq.dynamics, lq.defect
    first, (policy, values, slopes) = jax.lax.scan(backward, start, stages, reverse=True, unroll=unroll)
    feedback, feedforward = _feedback(policy, nx)

    def forward(dx: Array, k: tuple[Array, ...]) -> tuple[Array, tuple[Array, Array]]:
        dynamics, defect, gain, offset = k
        du = _input(gain, offset, dx)
        new = _following(dynamics, defect, dx, du)
        return new, (new, du)

    _, (dxs, dus) = jax.lax.scan(forward, dx0, (lq.dynamics, lq.defect, feedback, feedforward), unroll=unroll)
    costates = jax.vmap(applied)(values, dxs) + slopes
    first_costate = applied(first[0], dx0) + first[1]
    return Direction(jnp.concatenate([dx0[None], dxs]), dus, jnp.concatenate([first_costate[None], costates]), feedback)


@apart
def _transported(value: Array, slope: Array, dynamics: Array, defect: Array) -> tuple[Array, Array]:
    """P F [nx, nz] and P c + p [nx]."""
    return times(value, dynamics), applied(value, defect) + slope


@apart
def _total(hessian: Array, gradient: Array, dynamics: Array, transported: Array, pushed: Array) -> tuple[Array, Array]:
    """H + F' P F [nz, nz] and g + F' (P c + p) [nz]."""
    return hessian + transposed_times(dynamics, transported), gradient + transposed_applied(dynamics, pushed)


@apart
def _eliminated(matrix: Array, vector: Array, row: Array, constant: Array) -> tuple[Array, Array]:
    """Hessian and gradient of a quadratic whose last variable is -(row z + constant), where it is stationary."""
    column = matrix[:-1, -1]
    return matrix[:-1, :-1] - column[:, None] * row, vector[:-1] - column * constant


def _feedback(policy: Sequence[tuple[Array, Array]], nx: int) -> tuple[Array, Array]:
    """Feedback [N, nu, nx] and feedforward [N, nu], of a policy by states and earlier inputs."""
    gains: list[Array] = []
    offsets: list[Array] = []
    for row, constant in policy:
        gain, offset = -row[:, :nx], -constant
        for i, (earlier, its_offset) in enumerate(zip(gains, offsets, strict=True)):
            gain, offset = gain - row[:, nx + i, None] * earlier, offset - row[:, nx + i] * its_offset
        gains.append(gain)
        offsets.append(offset)
    return jnp.stack(gains, axis=1), jnp.stack(offsets, axis=1)


@apart
def _input(gain: Array, offset: Array, dx: Array) -> Array:
    return offset + applied(gain, dx)


@apart
def _following(dynamics: Array, defect: Array, dx: Array, du: Array) -> Array:
    nx = dx.shape[0]
    return defect + applied(dynamics[:, :nx], dx) + applied(dynamics[:, nx:], du)


def _positive(pivot: Array) -> Array:
    return jnp.maximum(pivot, tiny(pivot.dtype))


def _nonzero(pivot: Array) -> Array:
    return jnp.where(pivot < 0.0, -1.0, 1.0) * jnp.maximum(jnp.abs(pivot), tiny(pivot.dtype))


@lanes_last
def _minimum(lq: LinearQuadratic, dx0: Array, damping: Array) -> Direction:
    return _sweeps(lq, dx0, damping, _positive)


@lanes_last
def _stationary_point(lq: LinearQuadratic, dx0: Array, damping: Array) -> Direction:
    return _sweeps(lq, dx0, damping, _nonzero)
