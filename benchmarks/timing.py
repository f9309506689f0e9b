"""Timing of compiled functions."""

from __future__ import annotations

import time
from collections.abc import Callable
from typing import Any

import jax
import numpy as np

WARM_UP = 10
"""calls before the first that counts; the first of them compiles"""


def milliseconds(program: Callable[..., Any], *arguments: Any, calls: int) -> dict[str, float | int]:
    """Time warm calls of a compiled function, each until its results are there.

    Args:
      program: result of `compiled`.
      *arguments: passed to every call; those not yet on the device are put there first.
      calls: number of calls that count.

    Returns:
      min, median and p90 in ms, and the number of calls.
    """
    placed = jax.device_put(arguments)
    for _ in range(WARM_UP):
        jax.block_until_ready(program(*placed))
    taken = np.empty(calls)
    for i in range(calls):
        start = time.perf_counter()
        jax.block_until_ready(program(*placed))
        taken[i] = time.perf_counter() - start
    low, median, high = (1e3 * float(v) for v in (taken.min(), np.median(taken), np.quantile(taken, 0.9)))
    return {"min": round(low, 4), "median": round(median, 4), "p90": round(high, 4), "calls": calls}


def compiled(function: Callable[..., Any]) -> Callable[..., Any]:
    """A pure function, compiled at its first call; arguments that it ignores are handed over all the same."""
    return jax.jit(function, keep_unused=True)
