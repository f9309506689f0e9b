"""Checking of user input: one-line errors that name the field, the value and what is allowed."""

from __future__ import annotations

import dataclasses
import difflib
import math
import numbers
from collections.abc import Iterable, Mapping, Sequence
from typing import Any


class InputError(ValueError):
    """Bad input by the user; its text is one line naming the field, the value and what is allowed."""


LARGEST = 1e9
"""Numbers beyond this are refused: single precision could not compute with them."""
MOST = 1_000_000
"""of whatever is counted"""
SEED_LIMIT = 2**32 - 1
"""largest seed"""
SMALLEST = 1e-6
"""Positive quantities below this are refused likewise."""


def installing(extra: str) -> str:
    """How to get an extra of this package, for the end of a refusal."""
    return f'pip install ".[{extra}]" in your copy of the repository'


def nearest(name: str, allowed: Iterable[str]) -> str:
    """A hint such as "; did you mean 'mass'?", or nothing where no name is near."""
    close = difflib.get_close_matches(name, list(allowed), n=1, cutoff=0.5)
    return f"; did you mean '{close[0]}'?" if close else ""


def one_of(field: str, value: Any, allowed: Sequence[str]) -> str:
    """`value` if it is one of the allowed names."""
    if value not in allowed:
        raise InputError(f"{field} = {value!r}: must be one of {', '.join(allowed)}{nearest(str(value), allowed)}")
    return str(value)


def field_names(spec: Any) -> list[str]:
    """Names of the fields of a dataclass."""
    return [field.name for field in dataclasses.fields(spec)]


def known_keys(where: str, table: Any, allowed: Iterable[str], required: Iterable[str] = ()) -> Mapping[str, Any]:
    """`table` if it is a table without unknown keys that has the required ones."""
    if not isinstance(table, Mapping):
        raise InputError(f"{where} = {table!r}: must be a table")
    names = list(allowed)
    for key in table:
        if key not in names:
            raise InputError(f"{where}: unknown key '{key}'{nearest(key, names)} (allowed: {', '.join(names)})")
    for key in required:
        if key not in table:
            raise InputError(f"{where}: missing key '{key}'")
    return table


def number(
    field: str,
    value: Any,
    low: float = -math.inf,
    high: float = math.inf,
    strictly: bool = False,
) -> float:
    """`value` as a finite float in [low, high], or in (low, high] if `strictly`."""
    if isinstance(value, bool) or not isinstance(value, int | float):
        raise InputError(f"{field} = {value!r}: must be a number")
    if value != value or abs(value) == math.inf:
        raise InputError(f"{field} = {value!r}: must be finite")
    if strictly and low == 0.0 and 0.0 < value < SMALLEST:
        raise InputError(f"{field} = {value!r}: must be at least {SMALLEST:g}")
    if value < low or value > high or (strictly and value == low):
        bounds = f"{'>' if strictly else '>='} {low:g}" if math.isfinite(low) else ""
        if math.isfinite(high):
            bounds = f"{bounds} and <= {high:g}" if bounds else f"<= {high:g}"
        raise InputError(f"{field} = {_shown(value)}: must be {bounds}")
    if abs(value) > LARGEST:
        raise InputError(f"{field} = {_shown(value)}: must be at most {LARGEST:g} in size")
    return float(value)


def _shown(value: int | float) -> str:
    if isinstance(value, int) and abs(value) > LARGEST:
        return f"an integer of {value.bit_length()} bits"
    return repr(value)


def whole(field: str, value: Any, low: int, high: int) -> int:
    """`value` as an int if it is a whole number in [low, high]."""
    if isinstance(value, bool) or not isinstance(value, numbers.Integral) or not low <= int(value) <= high:
        raise InputError(f"{field} = {value!r}: must be a whole number >= {low} and <= {high}")
    return int(value)


def count(field: str, value: Any, low: int = 1) -> int:
    """`value` as an int if it is a number of things, from `low` to a million."""
    return whole(field, value, low, MOST)


def seed(field: str, value: Any) -> int:
    """`value` if it is a whole number that JAX's 32-bit random keys tell from every other."""
    return whole(field, value, 0, SEED_LIMIT)


def flag(field: str, value: Any) -> bool:
    """`value` if it is true or false."""
    if not isinstance(value, bool):
        raise InputError(f"{field} = {value!r}: must be true or false")
    return value


def name(field: str, value: Any) -> str:
    """`value` as a name that can be a file's: one printable line of 1 to 80 characters without slashes."""
    fine = isinstance(value, str) and 0 < len(value) <= 80 and value.isprintable()
    if not fine or any(c in value for c in "/\\") or value.startswith("."):
        shown = repr(value) if len(repr(value)) <= 100 else repr(value)[:97] + "..."
        raise InputError(f"{field} = {shown}: must be a text usable as a file name, of 1 to 80 printable characters")
    return value


def positive(field: str, value: Any) -> float:
    """`value` as a finite float > 0."""
    return number(field, value, 0.0, strictly=True)


def vector(field: str, value: Any, length: int, largest: float = math.inf) -> tuple[float, ...]:
    """`value` as a tuple of `length` finite floats, at most `largest` in size."""
    if not isinstance(value, list | tuple) or len(value) != length:
        raise InputError(f"{field} = {value!r}: must be {length} numbers")
    return tuple(number(f"{field}[{i}]", v, -largest, largest) for i, v in enumerate(value))


def pair(field: str, value: Any, largest: float = math.inf) -> tuple[float, float]:
    """`value` as two finite floats, at most `largest` in size."""
    x, y = vector(field, value, 2, largest)
    return x, y


def points(field: str, value: Any, at_least: int, largest: float = math.inf) -> tuple[tuple[float, float], ...]:
    """`value` as a tuple of at least `at_least` points (x, y), no coordinate larger than `largest` in size."""
    if not isinstance(value, list | tuple) or len(value) < at_least:
        raise InputError(f"{field} = {value!r}: must be a list of at least {at_least} points [x, y]")
    return tuple(pair(f"{field}[{i}]", point, largest) for i, point in enumerate(value))


def convex_polygon(field: str, value: Any) -> tuple[tuple[float, float], ...]:
    """`value` as the vertices of a strictly convex counter-clockwise polygon."""
    vertices = points(field, value, 3)
    count = len(vertices)
    turning = 0.0
    for i in range(count):
        (ax, ay), (bx, by), (cx, cy) = vertices[i - 2], vertices[i - 1], vertices[i]
        edge, following = (bx - ax, by - ay), (cx - bx, cy - by)
        turn = edge[0] * following[1] - edge[1] * following[0]
        if turn <= 1e-9:
            raise InputError(
                f"{field} = {[list(v) for v in vertices]}: must be strictly convex and counter-clockwise "
                f"(it is not at vertex {(i - 1) % count})"
            )
        turning += math.atan2(turn, edge[0] * following[0] + edge[1] * following[1])
    if turning > 2.0 * math.pi + 1e-6:
        raise InputError(f"{field}: must not wind around itself more than once")
    return vertices
