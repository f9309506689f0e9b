"""Work that only some lanes of a batch need."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import jax
import jax.numpy as jnp
from jax import Array
from jax.custom_batching import custom_vmap

from jaxlocomanip.numerics import select

GROUP, WIDE = 32, 256
"""lanes that are computed together, on a CPU and on an accelerator"""


def where_needed(
    needed: Array,
    function: Callable[..., Any],
    arguments: Any,
    otherwise: Any,
    skips: bool = True,
    group: int = GROUP,
) -> Any:
    """`function(arguments)` where it is needed and `otherwise` elsewhere.

    Alone this is `lax.cond`. Under `vmap` a condition would compute the function for every lane; here the lanes that
    need it are gathered and computed in groups, so that what few lanes need costs little. That cannot be differentiated
    in reverse mode: for this, `skips=False` computes everywhere and selects.

    Args:
      needed: [] bool.
      function: pure function of one pytree.
      arguments: the pytree.
      otherwise: result elsewhere, of the structure, shapes and dtypes of the function's.
      skips: leave out what is not needed.
      group: lanes that a CPU computes together. More than needed are computed where their number is no multiple of it,
        so that one is best for long work that is as fast for a single lane; small operations take many lanes.
    """
    if not skips:
        return select(needed, function(arguments), otherwise)

    # Both rules below call it: compiled by itself it is traced once and not, in nested conditions, 2, 4, 8 times.
    function = jax.jit(function)

    @custom_vmap
    def choose(needed: Array, arguments: Any, otherwise: Any) -> Any:
        return jax.lax.cond(needed, lambda: function(arguments), lambda: otherwise)

    @choose.def_vmap
    def _(size: int, batched: Any, needed: Array, arguments: Any, otherwise: Any) -> Any:  # pyright: ignore
        flags, others = (
            jax.tree.map(lambda leaf, has: leaf if has else jnp.broadcast_to(leaf, (size, *jnp.shape(leaf))), tree, has)
            for tree, has in ((needed, batched[0]), (otherwise, batched[2]))
        )
        if size == 1:
            # In a loop over one lane nothing depends on the loop: the compiler would compute it in any case.
            only = jax.tree.map(lambda leaf, has: leaf[0] if has else leaf, arguments, batched[1])
            done = choose(flags[0], only, jax.tree.map(lambda leaf: leaf[0], others))
            return jax.tree.map(lambda leaf: leaf[None], done), jax.tree.map(lambda _: True, otherwise)
        leaves, structure = jax.tree.flatten(arguments)
        has_lanes = jax.tree.leaves(batched[1])
        together = min(size, group if jax.default_backend() == "cpu" else WIDE)
        over = lambda values: function(structure.unflatten(values))  # noqa: E731
        done = _in_groups(flags, leaves, has_lanes, over, others, together)
        return done, jax.tree.map(lambda _: True, otherwise)

    return choose(needed, arguments, otherwise)


def _in_groups(
    needed: Array,
    leaves: list[Array],
    has_lanes: list[bool],
    function: Callable[[list[Array]], Any],
    results: Any,
    group: int,
) -> Any:
    """The results [B, ...], overwritten where needed [B], a group of lanes at a time."""
    size = needed.shape[0]
    # Lanes in need come first; a last group that is not full is filled with lanes whose results are thrown away.
    order = jnp.argsort(~needed, stable=True)
    order = jnp.concatenate([order, jnp.full(group, size, order.dtype)])
    count = jnp.sum(needed)
    over_lanes = _over_lanes(function, has_lanes, group)

    def unfinished(carry: tuple[Array, Any]) -> Array:
        return carry[0] < count

    def one_group(carry: tuple[Array, Any]) -> tuple[Array, Any]:
        first, results = carry
        place = first + jnp.arange(group)
        lanes = jnp.where(place < count, jax.lax.dynamic_slice(order, (first,), (group,)), size)
        inside = jnp.minimum(lanes, size - 1)
        taken = [leaf[inside] if has else leaf for leaf, has in zip(leaves, has_lanes, strict=True)]
        new = over_lanes(taken)
        put = jax.tree.map(lambda old, value: old.at[lanes].set(value, mode="drop"), results, new)
        return first + group, put

    return jax.lax.while_loop(unfinished, one_group, (jnp.zeros((), count.dtype), results))[1]


def _over_lanes(function: Callable[[list[Array]], Any], has_lanes: list[bool], group: int) -> Callable[..., Any]:
    """The function over a group of lanes; a single one as it is, so that conditions in it stay conditions."""
    if group > 1:
        return jax.vmap(function, in_axes=([0 if has else None for has in has_lanes],))

    def alone(leaves: list[Array]) -> Any:
        only = [leaf[0] if has else leaf for leaf, has in zip(leaves, has_lanes, strict=True)]
        return jax.tree.map(lambda leaf: leaf[None], function(only))

    return alone
