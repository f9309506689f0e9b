"""Checks of what pure functions are given, before anything is computed with it.

Shapes are always known. Numbers are known only outside of `jit`, `vmap` and `grad`: inside of them what is traced
passes.
"""

from __future__ import annotations

import math
from typing import Any

import numpy as np
from jax.core import Tracer

from jaxlocomanip.checked import InputError, number
from jaxlocomanip.scenario import Scenario


def known(value: Any) -> bool:
    """Whether it is a number or an array of numbers, and not traced."""
    return not isinstance(value, Tracer)


def shaped(field: str, value: Any, names: str, shape: tuple[int, ...]) -> None:
    """`value` has the shape, which is written as `names`; and its numbers, if they are known, are finite."""
    found = np.shape(value)
    if found != shape:
        raise InputError(f"{field} has shape {list(found)}: must be {names} = {list(shape)}")
    if known(value) and not np.isfinite(value).all():
        where = [int(i) for i in np.argwhere(~np.isfinite(value))[0]]
        raise InputError(f"{field}{where or ''} = {np.asarray(value)[tuple(where)]}: must be finite")


def scalar(
    field: str, value: Any, low: float, high: float = math.inf, strictly: bool = False, endless: bool = False
) -> None:
    """`value` is one number in [low, high], or in (low, high] if `strictly`; infinite only if `endless`."""
    if np.shape(value) != ():
        raise InputError(f"{field} has shape {list(np.shape(value))}: must be one number")
    if known(value) and not (endless and value == math.inf):
        number(field, value if isinstance(value, bool | int | float | str) else float(value), low, high, strictly)


def single(field: str, scenario: Scenario) -> None:
    """The scenario has no batch axis."""
    shape = np.shape(scenario.duration)
    if shape:
        raise InputError(f"{field} = a batch of {shape[0]}: must be a single scenario")
