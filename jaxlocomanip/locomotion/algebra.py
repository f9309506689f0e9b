"""Small linear algebra of one robot's control, in plain lax operations."""

from __future__ import annotations

import jax
import jax.numpy as jnp
from jax import Array

from jaxlocomanip.numerics import Floats


def skew(v: Array) -> Array:
    """[..., 3, 3] matrix of the cross product with v [..., 3]."""
    x, y, z = v[..., 0], v[..., 1], v[..., 2]
    zero = jnp.zeros_like(x)
    rows = ((zero, -z, y), (z, zero, -x), (-y, x, zero))
    return jnp.stack([jnp.stack(row, axis=-1) for row in rows], axis=-2)


def yaw_matrix(angle: Array) -> Array:
    """[..., 3, 3] rotation about z by an angle [...] in rad."""
    c, s = jnp.cos(angle), jnp.sin(angle)
    zero, one = jnp.zeros_like(c), jnp.ones_like(c)
    rows = ((c, -s, zero), (s, c, zero), (zero, zero, one))
    return jnp.stack([jnp.stack(row, axis=-1) for row in rows], axis=-2)


def yaw_of(rotation: Array) -> Array:
    """[] rad, heading of the x axis of a rotation [3, 3]."""
    return jnp.arctan2(rotation[1, 0], rotation[0, 0])


def determinant3(matrix: Array) -> Array:
    """[...] determinant of matrices [..., 3, 3]."""
    return jnp.sum(matrix[..., 0, :] * jnp.cross(matrix[..., 1, :], matrix[..., 2, :]), axis=-1)


def inverse3(matrix: Array, floor: Floats = 0.0) -> Array:
    """[..., 3, 3] inverse by the adjugate.

    Args:
      matrix: [..., 3, 3].
      floor: [...] least size of the determinant; a singular matrix gives a bounded result.
    """
    a, b, c = matrix[..., 0, :], matrix[..., 1, :], matrix[..., 2, :]
    columns = jnp.stack([jnp.cross(b, c), jnp.cross(c, a), jnp.cross(a, b)], axis=-1)
    value = determinant3(matrix)
    bounded = jnp.where(value < 0.0, -1.0, 1.0) * jnp.maximum(jnp.abs(value), floor)
    return columns / bounded[..., None, None]


def inverse(matrix: Array) -> Array:
    """Inverse of a symmetric positive definite matrix [..., n, n] by Gauss-Jordan sweeps, one pivot after the other.

    Nothing but rank-one updates: n small steps, which a compiler fuses, whatever the batch.
    """
    size = matrix.shape[-1]

    def sweep(k: Array, rest: Array) -> Array:
        row = jax.lax.dynamic_index_in_dim(rest, k, axis=-2, keepdims=False)
        here = jnp.arange(size) == k
        pivot = jnp.sum(jnp.where(here, row, 0.0), axis=-1)[..., None]
        scaled = jnp.where(here, 1.0, row) / pivot
        # Row k becomes scaled, the others lose their part of it; column k becomes the elimination itself.
        column = jax.lax.dynamic_index_in_dim(rest, k, axis=-1, keepdims=False)
        cleared = jnp.where(here[:, None] | here[None, :], 0.0, rest)
        factor = jnp.where(here, -1.0, column)
        return cleared - factor[..., :, None] * scaled[..., None, :]

    return jax.lax.fori_loop(0, size, sweep, matrix)
