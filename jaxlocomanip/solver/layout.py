"""How many small dense operations are laid out for the compiler.

A product of an 8x8 and an 8x12 matrix is too little for a library call, and a loop over its entries too short for the
processor's vector registers. Over many lanes it is neither: with the lanes as the *last* axis every operation on an
entry is one long loop over contiguous numbers. Functions here and in `riccati` are therefore written for arrays
[m, n, ...] whose trailing axes, if any, are only ever multiplied and added element by element.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from typing import Any

import jax
import jax.numpy as jnp
from jax import Array
from jax.custom_batching import custom_vmap
from jax.experimental.layout import Layout, with_layout_constraint


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


def stages_inside(values: Array) -> Array:
    """[n, N, ...] from [N, n, ...], moved in memory, where the compiler would have all readers stride over it."""
    swapped = jnp.swapaxes(values, 0, 1)
    return with_layout_constraint(swapped, Layout(tuple(range(swapped.ndim))))


def times(a: Array, b: Array) -> Array:
    """A B [m, n, ...] of A [m, k, ...] and B [k, n, ...]."""
    return added([a[:, k, None] * b[k] for k in range(b.shape[0])])


def transposed_times(a: Array, b: Array) -> Array:
    """A' B [m, n, ...] of A [k, m, ...] and B [k, n, ...]."""
    return added([a[k, :, None] * b[k] for k in range(b.shape[0])])


def applied(a: Array, b: Array) -> Array:
    """A b [m, ...] of A [m, k, ...] and b [k, ...]."""
    return added([a[:, k] * b[k] for k in range(b.shape[0])])


def transposed_applied(a: Array, b: Array) -> Array:
    """A' b [m, ...] of A [k, m, ...] and b [k, ...]."""
    return added([a[k] * b[k] for k in range(b.shape[0])])


def added(terms: Sequence[Array]) -> Array:
    """Sum of arrays, one after the other: a reduction over a first axis would not run along the last."""
    total = terms[0]
    for term in terms[1:]:
        total = total + term
    return total
