"""Study files: TOML checked field by field into a `Study`.

A file may extend a study of the package (`extends = "standard"`); its tables then replace single keys of that one's.

A study is a set of points (one for a random study, all combinations of its axes for a grid, its entries for a list), a
number of random draws at each of them, and the variants of the planner that are tried on each of the scenarios.
"""

from __future__ import annotations

import itertools
import tomllib
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from types import MappingProxyType
from typing import Any

from jaxlocomanip import checked
from jaxlocomanip.checked import InputError, nearest
from jaxlocomanip.packaged import Files, is_name
from jaxlocomanip.sampling.distributions import Constant, Distribution, parse_distribution
from jaxlocomanip.sampling.parameters import PARAMETERS
from jaxlocomanip.specification import read_toml

MOST_LANES = 10_000_000
"""scenarios of a study at most"""
_STUDIES = Files("study", "studies")


@dataclass(frozen=True)
class Point:
    """One combination of parameters that a study visits."""

    name: str
    """of an entry of a list, else empty"""
    values: Mapping[str, Distribution]
    """what replaces the study's own distributions"""


@dataclass(frozen=True)
class Axis:
    """A parameter that a grid steps through."""

    parameter: str
    values: tuple[Any, ...]


@dataclass(frozen=True)
class Variant:
    """A planner that a study tries on each of its scenarios."""

    name: str
    config: str | None
    """preset or file; None: that of the run"""
    without: tuple[str, ...]
    settings: Mapping[str, Any]
    """single settings by dotted name"""


@dataclass(frozen=True)
class Study:
    """A checked study file."""

    name: str
    count: int
    """random draws at each point"""
    world: str
    chunk: int
    """scenarios in one compiled batch"""
    parameters: Mapping[str, Distribution]
    """every parameter, but those without a value"""
    axes: tuple[Axis, ...]
    points: tuple[Point, ...]
    variants: tuple[Variant, ...]
    data: Mapping[str, Any]
    """what all of the above was made from: the tables of the file, on top of those that it extends"""

    def point(self, index: int) -> Point:
        """The point that lane `index` belongs to: lanes go round all points, so that each prefix covers them evenly."""
        return self.points[index % len(self.points)]

    def __reduce__(self) -> tuple[Any, ...]:
        """A study is what its tables say; the rest of it cannot be sent to other processes."""
        return study_of, (dict(self.data),)

    def distribution(self, name: str, index: int) -> Distribution | None:
        """What a parameter of lane `index` is drawn from; None where it has no value."""
        return self.point(index).values.get(name, self.parameters.get(name))


def names() -> tuple[str, ...]:
    """Names of the studies that come with the package, in alphabetical order."""
    return _STUDIES.names()


def describe(name: str) -> str:
    """One line on a study of the package: the first line of its file.

    Raises:
      InputError: unknown name.
    """
    return _STUDIES.describe(name)


def find_study(name_or_path: str) -> Study:
    """A study of the package by its name, else from a file.

    Raises:
      InputError: neither a known name nor a readable, correct file.
    """
    if is_name("study", name_or_path, names()):
        return parse_study(_STUDIES.text(name_or_path), name_or_path)
    return _of_file(read_toml(name_or_path), name_or_path)


def parse_study(text: str, source: str = "study") -> Study:
    """Check a study given as TOML text.

    Raises:
      InputError: prefixed with `source`.
    """
    try:
        return _of_file(tomllib.loads(text), source)
    except tomllib.TOMLDecodeError as error:
        raise InputError(f"{source}: is not valid TOML ({error})") from error


def _of_file(data: Mapping[str, Any], source: str) -> Study:
    """Check the tables of a file, which may extend another study."""
    try:
        tables = _extended(data)
    except InputError as error:
        raise InputError(f"{source}: {error}") from None
    return study_of(tables, source)


def study_of(data: Mapping[str, Any], source: str = "study") -> Study:
    """Check a study given as nested dictionaries, without anything that it extends.

    Raises:
      InputError: prefixed with `source`.
    """
    try:
        return _study(data)
    except InputError as error:
        raise InputError(f"{source}: {error}") from None


def _extended(data: Mapping[str, Any]) -> dict[str, Any]:
    """The tables of a study on top of those of the study that it extends, key by key."""
    if "extends" not in data:
        return dict(data)
    base = tomllib.loads(_STUDIES.text(checked.one_of("extends", data["extends"], names())))
    merged = _extended(base)
    for key, value in data.items():
        both = isinstance(value, Mapping) and isinstance(merged.get(key), Mapping)
        merged[key] = {**merged[key], **value} if both else value
    del merged["extends"]
    return merged


_OWN = ("name", "count", "world", "chunk", "axes", "points", "variants")


def _study(data: Mapping[str, Any]) -> Study:
    groups = dict.fromkeys(name.partition(".")[0] for name in PARAMETERS)
    checked.known_keys("study", data, [*_OWN, *groups], ("name",))
    if "axes" in data and "points" in data:
        raise InputError("study: only one of axes (a grid) and points (a list) can be given")
    axes = tuple(_axis(f"axes[{i}]", t) for i, t in enumerate(_tables("axes", data.get("axes", []))))
    points = tuple(_point(f"points[{i}]", t) for i, t in enumerate(_tables("points", data.get("points", []))))
    variants = tuple(_variant(f"variants[{i}]", t) for i, t in enumerate(_tables("variants", data.get("variants", []))))
    _refuse_repeated("axes", [axis.parameter for axis in axes])
    _refuse_repeated("points", [point.name for point in points])
    _refuse_repeated("variants", [variant.name for variant in variants])
    return Study(
        name=checked.name("name", data["name"]),
        count=checked.whole("count", data.get("count", 1000), 1, MOST_LANES),
        world=checked.one_of("world", data.get("world", "planar"), ("planar", "quadruped")),
        chunk=checked.whole("chunk", data.get("chunk", 256), 1, 65536),
        parameters=MappingProxyType(_parameters(data)),
        axes=axes,
        points=points or _grid(axes),
        variants=variants or (Variant("", None, (), MappingProxyType({})),),
        data=MappingProxyType(dict(data)),
    )


def _tables(field: str, value: Any) -> list[Any]:
    if not isinstance(value, list):
        raise InputError(f"{field} = {value!r}: must be a list of tables, [[{field}]]")
    return value


def _refuse_repeated(field: str, given: Sequence[str]) -> None:
    for name in given:
        if given.count(name) > 1:
            raise InputError(f"{field}: '{name}' is given twice")


def _parameters(data: Mapping[str, Any]) -> dict[str, Distribution]:
    """Distributions of all parameters, those of the file and the defaults of the others."""
    made: dict[str, Distribution] = {}
    for name, parameter in PARAMETERS.items():
        if parameter.default is not None:
            made[name] = Constant(parameter.default)
    for group, table in data.items():
        if group in _OWN:
            continue
        if group in PARAMETERS:
            made[group] = parse_distribution(group, table, PARAMETERS[group].check)
            continue
        keys = [name.partition(".")[2] for name in PARAMETERS if name.startswith(f"{group}.")]
        for key, value in checked.known_keys(group, table, keys).items():
            made[f"{group}.{key}"] = _distribution(f"{group}.{key}", value)
    return made


def _distribution(name: str, value: Any, where: str = "") -> Distribution:
    if name not in PARAMETERS:
        raise InputError(f"{where}{name}: unknown parameter{nearest(name, PARAMETERS)}")
    return parse_distribution(f"{where}{name}", value, PARAMETERS[name].check)


def _axis(where: str, table: Any) -> Axis:
    table = checked.known_keys(where, table, ("parameter", "values"), ("parameter", "values"))
    name, values = table["parameter"], table["values"]
    if not isinstance(name, str) or name not in PARAMETERS:
        raise InputError(f"{where}.parameter = {name!r}: unknown parameter{nearest(str(name), PARAMETERS)}")
    if not isinstance(values, list) or not values:
        raise InputError(f"{where}.values = {values!r}: must be a list of at least one value")
    return Axis(name, tuple(PARAMETERS[name].check(f"{where}.values[{i}]", v) for i, v in enumerate(values)))


def _grid(axes: tuple[Axis, ...]) -> tuple[Point, ...]:
    """All combinations of the axes' values, the last axis fastest; one free point where there are no axes."""
    combinations = itertools.product(*(axis.values for axis in axes))
    names = [axis.parameter for axis in axes]
    return tuple(
        Point("", MappingProxyType({n: Constant(v) for n, v in zip(names, values, strict=True)}))
        for values in combinations
    )


def _point(where: str, table: Any) -> Point:
    table = checked.known_keys(where, table, ("name", "set"), ("name", "set"))
    given = checked.known_keys(f"{where}.set", table["set"], PARAMETERS)
    made = {name: _distribution(name, value, f"{where}.set.") for name, value in given.items()}
    return Point(checked.name(f"{where}.name", table["name"]), MappingProxyType(made))


def _variant(where: str, table: Any) -> Variant:
    table = checked.known_keys(where, table, ("name", "config", "without", "settings"), ("name",))
    config, without, settings = table.get("config"), table.get("without", []), table.get("settings", {})
    if config is not None and not isinstance(config, str):
        raise InputError(f"{where}.config = {config!r}: must be the name of a preset or of a file")
    if not isinstance(without, list) or not all(isinstance(name, str) for name in without):
        raise InputError(f"{where}.without = {without!r}: must be a list of names")
    if not isinstance(settings, Mapping):
        raise InputError(f"{where}.settings = {settings!r}: must be a table")
    return Variant(
        checked.name(f"{where}.name", table["name"]), config, tuple(without), MappingProxyType(dict(settings))
    )
