"""Distributions as data: what a study file says of a parameter, as a function from (0, 1) to values.

    mass = 6.0                                    # always the same
    friction = { uniform = [0.15, 0.6] }          # between the two
    mass_ratio = { log_uniform = [0.5, 2.0] }     # with a uniform logarithm
    count = { integer = [2, 4] }                  # a whole number, both ends included
    speed = { normal = [0.3, 0.1], within = [0.0, 0.5] }  # cut off at the ends; 4 deviations where they are left out
    shape = { choice = ["box", "circle"] }        # each equally likely

Every draw is the inverse distribution function of one uniform number, so that a changed distribution changes no other.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from statistics import NormalDist
from typing import Any, Protocol

from jaxlocomanip import checked
from jaxlocomanip.checked import InputError

KINDS = ("uniform", "log_uniform", "normal", "integer", "choice")
"""Names of distributions."""

Check = Callable[[str, Any], Any]
"""(field, value) -> the checked value; raises `InputError`"""


class Distribution(Protocol):
    """What a parameter is drawn from."""

    def at(self, u: float) -> Any:
        """The value at the quantile u in (0, 1)."""
        ...


@dataclass(frozen=True)
class Constant:
    """Always one value."""

    value: Any

    def at(self, u: float) -> Any:
        """The value."""
        del u
        return self.value


@dataclass(frozen=True)
class Uniform:
    """Uniform between two numbers."""

    low: float
    high: float

    def at(self, u: float) -> float:
        """The value at the quantile u."""
        return self.low + (self.high - self.low) * u


@dataclass(frozen=True)
class LogUniform:
    """The logarithm is uniform between those of two positive numbers."""

    low: float
    high: float

    def at(self, u: float) -> float:
        """The value at the quantile u."""
        return math.exp(math.log(self.low) + math.log(self.high / self.low) * u)


@dataclass(frozen=True)
class Normal:
    """Normal with its tails cut off."""

    mean: float
    std: float
    low: float
    high: float

    def at(self, u: float) -> float:
        """The value at the quantile u."""
        if self.std == 0.0:
            return self.mean
        bell = NormalDist(self.mean, self.std)
        below, above = bell.cdf(self.low), bell.cdf(self.high)
        quantile = min(max(below + (above - below) * u, math.ulp(0.0)), math.nextafter(1.0, 0.0))
        return min(max(bell.inv_cdf(quantile), self.low), self.high)


@dataclass(frozen=True)
class Integer:
    """A whole number, both ends included."""

    low: int
    high: int

    def at(self, u: float) -> int:
        """The value at the quantile u."""
        return min(self.low + int(u * (self.high - self.low + 1)), self.high)


@dataclass(frozen=True)
class Choice:
    """One of several values, each equally likely."""

    values: tuple[Any, ...]

    def at(self, u: float) -> Any:
        """The value at the quantile u."""
        return self.values[min(int(u * len(self.values)), len(self.values) - 1)]


def parse_distribution(field: str, value: Any, check: Check) -> Distribution:
    """A distribution of values that all pass a check.

    Args:
      field: name in error messages.
      value: a constant or a table with one of `KINDS`.
      check: of single values; applied to constants, choices and both ends of ranges.

    Raises:
      InputError: not a distribution, or one with values that are not allowed.
    """
    if not isinstance(value, Mapping):
        return Constant(check(field, value))
    named = [kind for kind in KINDS if kind in value]
    if len(named) != 1:
        raise InputError(f"{field} = {dict(value)!r}: must be a value or a table with one of {', '.join(KINDS)}")
    (kind,) = named
    checked.known_keys(field, value, (kind, "within") if kind == "normal" else (kind,))
    if kind == "choice":
        return Choice(_choices(f"{field}.choice", value["choice"], check))
    if kind == "normal":
        return _normal(field, value, check)
    return _range(f"{field}.{kind}", kind, value[kind], check)


def _choices(field: str, values: Any, check: Check) -> tuple[Any, ...]:
    if not isinstance(values, list | tuple) or not values:
        raise InputError(f"{field} = {values!r}: must be a list of at least one value")
    return tuple(check(f"{field}[{i}]", value) for i, value in enumerate(values))


def _ends(field: str, given: Any, check: Check, whole: bool = False) -> tuple[Any, Any]:
    if not isinstance(given, list | tuple) or len(given) != 2:
        raise InputError(f"{field} = {given!r}: must be two numbers, the lower one first")
    # Lists and names have no order: only numbers have ranges.
    low, high = (checked.number(f"{field}[{i}]", end) for i, end in enumerate(given))
    for i, end in enumerate(given):
        check(f"{field}[{i}]", end)
        if not whole:
            # As a fraction, too: what has to be a whole number has no range with anything between.
            check(f"{field}[{i}]", float(end))
    if low > high:
        raise InputError(f"{field} = {list(given)!r}: the lower end must come first")
    return given[0], given[1]


def _range(field: str, kind: str, given: Any, check: Check) -> Distribution:
    low, high = _ends(field, given, check, whole=kind == "integer")
    if kind == "integer":
        if not all(isinstance(end, int) for end in (low, high)):
            raise InputError(f"{field} = {list(given)!r}: must be two whole numbers")
        return Integer(low, high)
    if kind == "log_uniform":
        checked.number(f"{field}[0]", low, 0.0, strictly=True)
        return LogUniform(float(low), float(high))
    return Uniform(float(low), float(high))


def _normal(field: str, table: Mapping[str, Any], check: Check) -> Normal:
    mean, std = checked.vector(f"{field}.normal", table["normal"], 2)
    checked.number(f"{field}.normal[1]", std, 0.0)
    ends = table.get("within", [mean - 4.0 * std, mean + 4.0 * std])
    low, high = _ends(f"{field}.within", ends, check)
    if not low <= mean <= high:
        raise InputError(f"{field}.within = {list(ends)!r}: must hold the mean, {mean:g}")
    return Normal(mean, std, float(low), float(high))
