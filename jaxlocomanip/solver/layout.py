"""How many small dense operations are laid out for the compiler.

A product of an 8x8 and an 8x12 matrix is too little for a library call, and a loop over its entries too short for the
processor's vector registers. Over many lanes it is neither: with the lanes as the *last* axis every operation on an
entry is one long loop over contiguous numbers. Functions here and in `riccati` are therefore written for arrays
[m, n, ...] whose trailing axes, if any, are only ever multiplied and added element by element.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator
from functools import wraps
from typing import Any, ParamSpec, TypeVar

import jax
import jax.numpy as jnp
from jax import Array
from jax.custom_batching import custom_vmap
from jax.experimental.xla_metadata import set_xla_metadata

P = ParamSpec("P")
R = TypeVar("R")


def apart(function: Callable[P, R]) -> Callable[P, R]:
    """The same function, compiled apart from what surrounds it, for its results to be computed once and kept.

    Left to itself, XLA on a CPU merges sums of products into whatever reads them and computes them anew for every
    reader: a chain of three small matrix products then costs hundreds. It merges nothing across such a call.
    """
    compiled = jax.jit(function)

    @wraps(function)
    def call(*args: P.args, **kwargs: P.kwargs) -> R:
        with set_xla_metadata(inlineable="false"):
            return compiled(*args, **kwargs)

    return call


def lanes_last(function: Callable[..., Any]) -> Callable[..., Any]:
    """A function of arrays that may have trailing axes, which under `vmap` gets the lanes as one such axis.

    Derivatives are those of the function itself, batched in the usual way.
    """

    @custom_vmap
    def alone(*args: Any) -> Any:
        return function(*args)

    @alone.def_vmap
    def _(size: int, batched: Any, *args: Any) -> Any:  # pyright: ignore
        def last(leaf: Array, has: bool) -> Array:
            return jnp.moveaxis(leaf, 0, -1) if has else jnp.broadcast_to(leaf[..., None], (*jnp.shape(leaf), size))

        results = function(*jax.tree.map(last, args, tuple(batched)))
        return jax.tree.map(lambda leaf: jnp.moveaxis(leaf, -1, 0), results), jax.tree.map(lambda _: True, results)

    @jax.custom_jvp
    def call(*args: Any) -> Any:
        return alone(*args)

    @call.defjvp
    def _(primals: Any, tangents: Any) -> Any:
        return jax.jvp(function, primals, tangents)

    return call


def times(a: Array, b: Array) -> Array:
    """A B [m, n, ...] of A [m, k, ...] and B [k, n, ...]."""
    return _sum(a[:, k, None] * b[k] for k in range(b.shape[0]))


def transposed_times(a: Array, b: Array) -> Array:
    """A' B [m, n, ...] of A [k, m, ...] and B [k, n, ...]."""
    return _sum(a[k, :, None] * b[k] for k in range(b.shape[0]))


def applied(a: Array, b: Array) -> Array:
    """A b [m, ...] of A [m, k, ...] and b [k, ...]."""
    return _sum(a[:, k] * b[k] for k in range(b.shape[0]))


def transposed_applied(a: Array, b: Array) -> Array:
    """A' b [m, ...] of A [k, m, ...] and b [k, ...]."""
    return _sum(a[k] * b[k] for k in range(b.shape[0]))


def _sum(terms: Iterator[Array]) -> Array:
    # Written out: a reduction over the first axis would not run along the last.
    total = next(terms)
    for term in terms:
        total = total + term
    return total
