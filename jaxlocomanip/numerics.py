"""Numerical ground rules: pytree registration, safe norms, angle wrap and small dense linear algebra.

The dense routines are written in plain lax operations and unrolled over the (small, static) matrix size: batched
LAPACK calls inside compiled loops are slow for 4x4 to 12x12 matrices and can dead-lock XLA's CPU thread pool.
"""

from __future__ import annotations

import dataclasses
from collections.abc import Callable
from functools import wraps
from typing import Any, ParamSpec, TypeVar, dataclass_transform

import jax
import jax.numpy as jnp
import numpy as np
from jax import Array
from jax.custom_derivatives import SymbolicZero
from jax.experimental.xla_metadata import set_xla_metadata

P = ParamSpec("P")
T = TypeVar("T")

Floats = Array | float
"""A traced array or a Python number standing for one."""


@dataclass_transform(frozen_default=True)
def pytree(cls: type[T]) -> type[T]:
    """Register a class as a frozen dataclass pytree; fields made by `static()` become metadata."""
    frozen: Any = dataclasses.dataclass(frozen=True)(cls)
    fields = dataclasses.fields(frozen)
    meta = [f.name for f in fields if f.metadata.get("static", False)]
    data = [f.name for f in fields if f.name not in meta]
    return jax.tree_util.register_dataclass(frozen, data_fields=data, meta_fields=meta)


def static(default: Any) -> Any:
    """A dataclass field that is part of the pytree's structure: hashable, known at trace time."""
    return dataclasses.field(default=default, metadata={"static": True})


def tiny(dtype: Any) -> float:
    """Smallest pivot, divisor or squared length trusted in `dtype`; the one source of such floors."""
    return 1e-12 if jnp.dtype(dtype).itemsize >= 8 else 1e-7


def apart(function: Callable[P, T]) -> Callable[P, T]:
    """The same function, compiled apart from what surrounds it, for its results to be computed once and kept.

    Left to itself, XLA on a CPU merges sums of products into whatever reads them and computes them anew for every
    reader: a chain of three small matrix products then costs hundreds. It merges nothing across such a call.
    """
    compiled = jax.jit(function)

    @wraps(function)
    def call(*args: P.args, **kwargs: P.kwargs) -> T:
        with set_xla_metadata(inlineable="false"):
            return compiled(*args, **kwargs)

    return call


def host_array(value: Any) -> Any:
    """Floats as a NumPy array of the precision that JAX computes in."""
    # `Any`: the pytrees are annotated with JAX's array type, of which NumPy's is none.
    return np.asarray(value, dtype=jax.dtypes.canonicalize_dtype(np.float64))


def safe_norm(v: Array, axis: int = -1) -> Array:
    """Euclidean norm with a zero (not NaN) gradient at the origin."""
    squared = jnp.sum(v * v, axis=axis)
    positive = squared > 0.0
    return jnp.where(positive, jnp.sqrt(jnp.where(positive, squared, 1.0)), 0.0)


def smaller(a: Array, b: Floats) -> Array:
    """The smaller of numbers none of which is NaN: one instruction, of which `jnp.minimum` with its NaNs takes many."""
    return jnp.where(a < b, a, b)


def larger(a: Array, b: Floats) -> Array:
    """The larger of numbers none of which is NaN."""
    return jnp.where(a > b, a, b)


def wrap_angle(angle: Array) -> Array:
    """Angle in rad, wrapped to [-pi, pi)."""
    return angle - 2.0 * jnp.pi * jnp.floor((angle + jnp.pi) / (2.0 * jnp.pi))


@jax.custom_jvp
def sine_and_cosine(angle: Array) -> tuple[Array, Array]:
    """Sine and cosine [...] of angles [...] in rad.

    In single precision by reduction to a quarter turn and polynomials (those of the Cephes library), within 1.2e-7 up
    to 1e4 rad: plain arithmetic, of which a processor does many at once, where XLA's own calls a library for each
    number.
    """
    if angle.dtype != jnp.float32:
        return jnp.sin(angle), jnp.cos(angle)
    quarters = jnp.floor(angle * (2.0 / np.pi) + 0.5)
    # A quarter turn in three parts, the first two of few digits, so that their multiples are exact.
    rest = ((angle - quarters * 1.5703125) - quarters * 4.837512969970703125e-4) - quarters * 7.549789948768648e-8
    z = rest * rest
    sine = rest + rest * z * (-1.6666654611e-1 + z * (8.3321608736e-3 - z * 1.9515295891e-4))
    cosine = 1.0 - 0.5 * z + z * z * (4.166664568298827e-2 + z * (-1.388731625493765e-3 + z * 2.443315711809948e-5))
    quadrant = quarters - 4.0 * jnp.floor(0.25 * quarters)
    odd = (quadrant == 1.0) | (quadrant == 3.0)
    sine, cosine = jnp.where(odd, cosine, sine), jnp.where(odd, sine, cosine)
    lower, left = quadrant >= 2.0, (quadrant == 1.0) | (quadrant == 2.0)
    return jnp.where(lower, -sine, sine), jnp.where(left, -cosine, cosine)


@sine_and_cosine.defjvp
def _sine_and_cosine_jvp(
    primals: tuple[Array], tangents: tuple[Array]
) -> tuple[tuple[Array, Array], tuple[Array, Array]]:
    sine, cosine = sine_and_cosine(*primals)
    (change,) = tangents
    return (sine, cosine), (cosine * change, -sine * change)


@jax.custom_jvp
def quotient(x: Array, y: Array) -> Array:
    """x / y, whose derivatives of every order share one more division, the reciprocal of y.

    XLA on a CPU keeps the result of each division as an array of its own, and JAX's rule divides anew in every
    derivative.
    """
    return x / y


def _quotient_jvp(primals: tuple[Array, Array], tangents: tuple[Any, Any]) -> tuple[Array, Any]:
    (x, y), (dx, dy) = primals, tangents
    value = quotient(x, y)
    by_x = quotient(jnp.ones_like(y), y)
    parts = [] if _is_zero(dx) else [by_x * dx]
    if not _is_zero(dy):
        parts.append(-(value * by_x) * dy)
    return value, sum(parts[1:], parts[0])


quotient.defjvp(_quotient_jvp, symbolic_zeros=True)


def _is_zero(tangent: Any) -> bool:
    return isinstance(tangent, SymbolicZero)


@jax.custom_jvp
def logarithm(x: Array) -> Array:
    """Natural logarithm, whose derivatives share the reciprocal of `quotient`."""
    return jnp.log(x)


@logarithm.defjvp
def _logarithm_jvp(primals: tuple[Array], tangents: tuple[Array]) -> tuple[Array, Array]:
    (x,), (change,) = primals, tangents
    return jnp.log(x), quotient(jnp.ones_like(x), x) * change


def smooth_positive(x: Array, width: Floats) -> Array:
    """Smooth positive part (x + sqrt(x^2 + 4 width^2)) / 2, without cancellation for x << 0."""
    root = jnp.sqrt(x * x + 4.0 * width * width)
    below = root - jnp.minimum(x, 0.0)
    small = 2.0 * width * width / jnp.where(below > 0.0, below, 1.0)
    return jnp.where(x > 0.0, 0.5 * (x + root), small)


def all_finite(tree: Any) -> Array:
    """[] bool: every floating leaf is finite."""
    leaves = [leaf for leaf in jax.tree.leaves(tree) if jnp.issubdtype(leaf.dtype, jnp.floating)]
    return jnp.all(jnp.stack([jnp.all(jnp.isfinite(leaf)) for leaf in leaves]))


def select(predicate: Array | bool, on_true: T, on_false: T) -> T:
    """`jnp.where` over two pytrees of one structure with a scalar predicate."""
    return jax.tree.map(lambda a, b: jnp.where(predicate, a, b), on_true, on_false)


def cholesky(matrix: Array) -> Array:
    """Lower Cholesky factor [n, n] of a symmetric positive definite [n, n] matrix, unrolled over columns.

    Pivots are floored, so an indefinite or singular matrix gives a finite factor of a nearby matrix.
    """
    n = matrix.shape[-1]
    floor = tiny(matrix.dtype)
    rest, columns = matrix, []
    for k in range(n):
        pivot = jnp.sqrt(jnp.maximum(rest[k, k], floor))
        below = (jnp.arange(n) > k) * rest[:, k] / pivot
        column = below.at[k].set(pivot)
        columns.append(column)
        rest = rest - jnp.outer(below, below)
    return jnp.stack(columns, axis=1)


def cholesky_solve(factor: Array, rhs: Array) -> Array:
    """Solve (L L') X = rhs for L [n, n] and rhs [n, m], unrolled over rows."""
    n = factor.shape[-1]
    forward: list[Array] = []
    for i in range(n):
        done = sum((factor[i, j] * forward[j] for j in range(i)), jnp.zeros_like(rhs[0]))
        forward.append((rhs[i] - done) / factor[i, i])
    backward: list[Array] = [rhs[0]] * n
    for i in reversed(range(n)):
        done = sum((factor[j, i] * backward[j] for j in range(i + 1, n)), jnp.zeros_like(rhs[0]))
        backward[i] = (forward[i] - done) / factor[i, i]
    return jnp.stack(backward)


def projected_least_squares(
    matrix: Array,
    target: Array,
    project: Callable[[Array], Array],
    ridge: Floats = 1e-4,
    iterations: int = 60,
) -> Array:
    """Minimise |A x - b|^2 + ridge |x|^2 over a convex set, such as x >= 0, by accelerated projected gradient.

    Args:
      matrix: A [m, n], scaled so that its columns have length about one.
      target: b [m].
      project: nearest point [n] of the set, as `jax.nn.relu` for x >= 0.
      ridge: > 0, picks the even split among equivalent solutions.
      iterations: fixed count, so the routine batches.

    Returns:
      x [n].
    """
    gram = matrix.T @ matrix
    step = 1.0 / (jnp.trace(gram) + ridge)
    linear = matrix.T @ target

    def body(carry: tuple[Array, Array], k: Array) -> tuple[tuple[Array, Array], None]:
        x, y = carry
        gradient = gram @ y - linear + ridge * y
        new = project(y - step * gradient)
        return (new, new + k / (k + 3.0) * (new - x)), None

    start = jnp.zeros_like(linear)
    (x, _), _ = jax.lax.scan(body, (start, start), jnp.arange(iterations, dtype=target.dtype))
    return x
