"""Foot forces that give a body wanted accelerations, inside friction pyramids.

    minimise   1/2 |W u - a|^2_S  +  1/2 R |u - u_ref|^2     subject to   u in C

with the accelerations of N steps and 6 axes coupled over time by S (one [N, N] matrix per axis), W block-diagonal over
the steps, and C the product of truncated friction pyramids, one per foot and step; C of a swinging foot is {0}. By
Woodbury's identity only the 6N x 6N matrix c S^-1 + W W' is inverted, c = R + rho, half the size of the problem's
Hessian in forces and well enough conditioned for single precision.

The solver is ADMM with over-relaxation: a least-squares step and an exact projection onto C in turn. What it returns
is the projection, so forces are feasible at any iteration count.
"""

from __future__ import annotations

import jax
import jax.numpy as jnp
from jax import Array

from jaxlocomanip.locomotion.algebra import inverse
from jaxlocomanip.numerics import Floats, pytree

RELAXATION = 1.6
"""of ADMM, in (0, 2)"""


@pytree
class ForceProblem:
    """One problem."""

    response: Array
    """[N, 6, 12] W, accelerations per force; columns of swinging feet are zero"""
    wanted: Array
    """[N, 6] a, accelerations that track best"""
    compliance: Array
    """[6, N, N] S^-1 of each axis, symmetric positive definite"""
    reference: Array
    """[N, 4, 3] u_ref, N; zero for swinging feet"""
    force_weight: Array
    """[] R, 1/N^2"""
    friction: Array
    """[] of the pyramid"""
    low: Array
    """[N, 4] N, bounds on the normal force; both zero for a swinging foot"""
    high: Array
    """[N, 4] N"""


def project(force: Array, friction: Floats, low: Array, high: Array) -> Array:
    """Nearest points [..., 3] of truncated pyramids |x|, |y| <= mu z, low <= z <= high.

    The distance's derivative in z is a minimum of three increasing lines: its root is the largest of theirs.
    """
    side = jnp.abs(force[..., :2])
    large, both, z = jnp.max(side, axis=-1), jnp.sum(side, axis=-1), force[..., 2]
    one = (z + friction * large) / (1.0 + friction**2)
    two = (z + friction * both) / (1.0 + 2.0 * friction**2)
    normal = jnp.clip(jnp.maximum(z, jnp.maximum(one, two)), low, high)
    bound = (friction * normal)[..., None]
    return jnp.concatenate([jnp.clip(force[..., :2], -bound, bound), normal[..., None]], axis=-1)


def solve(problem: ForceProblem, penalty: Floats, iterations: int) -> Array:
    """A fixed number of ADMM iterations from the reference.

    The last solution is no better start: forces jump with every change of contacts.

    Args:
      problem: the problem.
      penalty: rho / R > 0; multipliers of active constraints converge faster with more, everything else with less.
      iterations: count.

    Returns:
      Feasible forces [N, 4, 3] N.
    """
    steps = problem.response.shape[0]
    response, weight = problem.response, 1.0 + penalty
    kernel = inverse(_kernel(problem, weight))
    reference = problem.reference.reshape(steps, 12)

    def correct(mean: Array) -> Array:
        missing = problem.wanted - jnp.einsum("nij,nj->ni", response, mean)
        push = (kernel @ missing.reshape(-1)).reshape(steps, 6)
        return mean + jnp.einsum("nij,ni->nj", response, push)

    def step(_: Array, carry: tuple[Array, Array]) -> tuple[Array, Array]:
        feasible, dual = carry
        best = correct((reference + penalty * (feasible - dual)) / weight)
        ahead = RELAXATION * best + (1.0 - RELAXATION) * feasible + dual
        projected = project(ahead.reshape(steps, 4, 3), problem.friction, problem.low, problem.high)
        return projected.reshape(steps, 12), ahead - projected.reshape(steps, 12)

    feasible, _ = jax.lax.fori_loop(0, iterations, step, (reference, jnp.zeros_like(reference)))
    return feasible.reshape(steps, 4, 3)


def _kernel(problem: ForceProblem, weight: Floats) -> Array:
    """[6N, 6N] c S^-1 + W W', steps major."""
    steps = problem.response.shape[0]
    axes, times = jnp.eye(6, dtype=problem.wanted.dtype), jnp.eye(steps, dtype=problem.wanted.dtype)
    smooth = problem.force_weight * weight * jnp.einsum("ikl,ij->kilj", problem.compliance, axes)
    gram = jnp.einsum("kia,kja->kij", problem.response, problem.response)
    spread = jnp.einsum("kij,kl->kilj", gram, times)
    return (smooth + spread).reshape(6 * steps, 6 * steps)
