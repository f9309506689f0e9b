"""Derivatives that fade on their way back in time, as in truncated backpropagation."""

from __future__ import annotations

import jax
import jax.numpy as jnp
from jax import Array

from jaxlocomanip.numerics import Floats, T, pytree
from jaxlocomanip.planner.config import PlannerConfig


@pytree
class Kept:
    """Shares of derivatives that are left a tick earlier."""

    motion: Array
    """[] of those by the state of world and planner"""
    plan: Array
    """[] of those by the last tick's plan"""


def shares_kept(config: PlannerConfig, memory: Floats, plans: Floats = 1.0) -> Kept:
    """What is left of derivatives a tick earlier, by time constant, s, and share of those by plans."""
    motion = jnp.exp(-config.horizon.tick / jnp.asarray(memory, jnp.result_type(float)))
    return Kept(motion, motion * plans)


def fade(tree: T, kept: Array) -> T:
    """The same numbers, of whose derivatives a share [] is kept."""
    return jax.tree.map(lambda leaf: _fade(leaf, kept) if jnp.issubdtype(leaf.dtype, jnp.floating) else leaf, tree)


@jax.custom_jvp
def _fade(value: Array, kept: Array) -> Array:
    """The value, of whose derivative a share is kept."""
    del kept
    return value


@_fade.defjvp
def _fade_jvp(primals: tuple[Array, Array], tangents: tuple[Array, Array]) -> tuple[Array, Array]:
    (value, kept), (change, _) = primals, tangents
    return value, kept * change
