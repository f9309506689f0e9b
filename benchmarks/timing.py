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
      min, median and p90 in ms, the number of calls, and the ratio to itself, 1 (see `in_turn`).
    """
    return in_turn({"": (program, *arguments)}, calls)[""]


def in_turn(programs: dict[str, tuple[Any, ...]], calls: int) -> dict[str, dict[str, float | int]]:
    """The same for programs that are to be compared: each round calls every one, so all see the same machine.

    Args:
      programs: by name, a result of `compiled` and its arguments.
      calls: rounds that count.

    Returns:
      For each name the figures of `milliseconds`, and `ratio`: the median of its time to the first program's, round
      by round.
    """
    placed = {name: (program, jax.device_put(arguments)) for name, (program, *arguments) in programs.items()}
    taken = np.empty((WARM_UP + calls, len(placed)))
    for i in range(len(taken)):
        for j, (program, arguments) in enumerate(placed.values()):
            start = time.perf_counter()
            jax.block_until_ready(program(*arguments))
            taken[i, j] = time.perf_counter() - start
    counted = 1e3 * taken[WARM_UP:]
    ratios = np.median(counted / counted[:, :1], axis=0)
    return {name: _figures(counted[:, j], float(ratios[j])) for j, name in enumerate(placed)}


def _figures(taken: np.ndarray, ratio: float) -> dict[str, float | int]:
    low, median, high = (round(float(v), 4) for v in (taken.min(), np.median(taken), np.quantile(taken, 0.9)))
    return {"min": low, "median": median, "p90": high, "calls": len(taken), "ratio": round(ratio, 3)}


def compiled(function: Callable[..., Any]) -> Callable[..., Any]:
    """A pure function, compiled at its first call; arguments that it ignores are handed over all the same."""
    return jax.jit(function, keep_unused=True)
