"""Timing of compiled functions."""

from __future__ import annotations

import time
from collections.abc import Callable
from typing import Any

import jax
import numpy as np

WARM_UP = 10
"""calls before the first that counts"""


def milliseconds(function: Callable[..., Any], *arguments: Any, calls: int) -> dict[str, float | int]:
    """Compile a function and time warm calls, each until its results are there.

    Args:
      function: pure function of pytrees; closes over no arrays.
      *arguments: passed to every call.
      calls: number of calls that count.

    Returns:
      min, median and p90 in ms, the number of calls, and compile_s.
    """
    start = time.perf_counter()
    # Arguments that a function ignores are kept, so that every piece pays for what it is handed.
    program = jax.jit(function, keep_unused=True).lower(*arguments).compile()
    compile_s = time.perf_counter() - start
    for _ in range(WARM_UP):
        jax.block_until_ready(program(*arguments))
    taken = np.empty(calls)
    for i in range(calls):
        start = time.perf_counter()
        jax.block_until_ready(program(*arguments))
        taken[i] = time.perf_counter() - start
    low, median, high = (1e3 * float(v) for v in (taken.min(), np.median(taken), np.quantile(taken, 0.9)))
    return {
        "min": round(low, 4),
        "median": round(median, 4),
        "p90": round(high, 4),
        "calls": calls,
        "compile_s": round(compile_s, 3),
    }
