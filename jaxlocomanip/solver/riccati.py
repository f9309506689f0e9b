"""The equality-constrained linear-quadratic subproblem, solved by a Riccati recursion.

minimise   sum_{k<N} 1/2 z_k' H_k z_k + g_k' z_k  +  1/2 dx_N' H_N dx_N + g_N' dx_N,   z_k = [dx_k, du_k]
subject to dx_{k+1} = F_k z_k + c_k,   dx_0 given.
"""

from __future__ import annotations

import jax
import jax.numpy as jnp
from jax import Array

from jaxlocomanip.numerics import Floats, cholesky, cholesky_solve, pytree, symmetric_solve


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
        be invertible in u.
    """
    nx = dx0.shape[0]
    nu = lq.hessian.shape[-1] - nx
    damping = regularisation * jnp.eye(nu, dtype=dx0.dtype)
    # Vectors ride along as last columns of the matrices, and the transpose is taken once for all stages: few, plain
    # matrix products are what a compiler knows how to do fast.
    quadratic = jnp.concatenate([lq.hessian, lq.gradient[..., None]], axis=-1)
    affine = jnp.concatenate([lq.dynamics, lq.defect[..., None]], axis=-1)
    transposed = jnp.swapaxes(lq.dynamics, -1, -2)

    def backward(carry: tuple[Array, Array], k: tuple[Array, ...]) -> tuple[tuple[Array, Array], tuple[Array, ...]]:
        value, slope = carry
        quadratic, affine, transposed = k
        transported = (value @ affine).at[:, -1].add(slope)
        total = quadratic + transposed @ transported
        inputs, right = total[nx:, nx:-1] + damping, jnp.concatenate([total[nx:, :nx], total[nx:, -1:]], axis=1)
        gains = -cholesky_solve(cholesky(inputs), right) if definite else -symmetric_solve(inputs, right)
        new = jnp.concatenate([total[:nx, :nx], total[:nx, -1:]], axis=1) + total[:nx, nx:-1] @ gains
        return (0.5 * (new[:, :nx] + new[:, :nx].T), new[:, nx]), (gains[:, nx], gains[:, :nx], value, slope)

    start = (lq.final_hessian, lq.final_gradient)
    (value0, slope0), (feedforward, feedback, values, slopes) = jax.lax.scan(
        backward, start, (quadratic, affine, transposed), reverse=True
    )

    def forward(dx: Array, k: tuple[Array, ...]) -> tuple[Array, tuple[Array, Array]]:
        dynamics, defect, offset, gain = k
        du = offset + gain @ dx
        new = dynamics @ jnp.concatenate([dx, du]) + defect
        return new, (new, du)

    _, (dxs, dus) = jax.lax.scan(forward, dx0, (lq.dynamics, lq.defect, feedforward, feedback))
    costates = jnp.einsum("kij,kj->ki", values, dxs) + slopes
    first = value0 @ dx0 + slope0
    return Direction(jnp.concatenate([dx0[None], dxs]), dus, jnp.concatenate([first[None], costates]), feedback)
