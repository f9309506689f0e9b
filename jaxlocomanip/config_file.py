"""Planner settings as TOML, checked field by field, and ablations by name.

The file has one table per group of `planner.config`:

    preset = "robust"  # optional; what the file does not mention comes from here
    [horizon]
    steps = 40
    [constraints.force]
    weight = 0.05

A missing table or key keeps the preset's value; an unknown one is refused.
"""

from __future__ import annotations

import dataclasses
from collections.abc import Mapping, Sequence
from pathlib import Path
from types import MappingProxyType
from typing import Any, TypeVar, get_type_hints

from jaxlocomanip import checked
from jaxlocomanip.checked import InputError
from jaxlocomanip.packaged import is_name
from jaxlocomanip.planner.config import Barrier, PlannerConfig
from jaxlocomanip.planner.presets import PRESETS, preset
from jaxlocomanip.specification import read_toml

T = TypeVar("T")

_LARGE = 1e9  # far from overflow in float32, also when squared
_SMALL = 1e-6  # a positive number that stays one in float32, also when squared
_DEFAULT_RANGE = (0.0, _LARGE)

SWITCHES = (
    "Constraints.clf_normalised",
    "Reference.plan_path",
    "Reference.second_start",
    "Reference.change_faces",
    "Adaptation.on_prediction",
    "Adaptation.breakaway",
    "SafetyFilter.enabled",
    "Protection.object",
    "Protection.robots",
)
"""Settings, by class and field, of which only 0 and 1 mean anything."""

RANGES: Mapping[str, tuple[float, float]] = MappingProxyType(
    {
        "Horizon.steps": (2, 500),
        "Horizon.tick": (1e-3, 1.0),
        "Horizon.sqp_iterations": (1, 50),
        "Horizon.dt": (1e-3, 1.0),
        "Horizon.smoothing": (_SMALL, 1.0),
        "Barrier.switch": (_SMALL, _LARGE),
        **dict.fromkeys(SWITCHES, (0.0, 1.0)),
        "Reference.speed": (1e-3, 10.0),
        "Reference.turn_rate": (1e-3, 10.0),
        "Reference.walk_fraction": (1e-3, 1.0),
        "Reference.lead": (1e-3, _LARGE),
        "Reference.settle": (1e-3, _LARGE),
        "Reference.clearance": (0.1, _LARGE),
        "Reference.replan": (1e-3, 3600.0),
        "Adaptation.prior_friction": (0.0, 2.0),
        "Adaptation.max_friction": (0.0, 2.0),
        "Adaptation.mass_range": (1.0, 100.0),
        "Estimation.pose_gain": (0.0, 1.0),
        "Estimation.twist_gain": (0.0, 1.0),
        "Estimation.obstacle_noise": (_SMALL, _LARGE),
        "SafetyFilter.friction": (1e-3, 2.0),
    }
)
"""Allowed values, both ends included, by class and field; whatever is not listed must be >= 0."""

FEATURES: Mapping[str, Mapping[str, float]] = MappingProxyType(
    {
        # Without the prior the planner reckons with exactly what the scenario states.
        "adaptation": {"adaptation.gain": 0.0, "adaptation.prior_friction": 0.0},
        "faces": {"reference.change_faces": 0.0},
        "robot-cbf": {"protection.robots": 0.0},
        "object-cbf": {"protection.object": 0.0},
        "clf": {"constraints.clf.weight": 0.0},
        "path": {"reference.plan_path": 0.0},
        "filter": {"safety.enabled": 0.0},
    }
)
"""What can be switched off by name, and the settings that do it."""


def load_config(path: str | Path) -> PlannerConfig:
    """Read and check a file of planner settings.

    Raises:
      InputError: the file is missing, unreadable, not TOML, or has a bad value; the text names both.
    """
    return config_from_table(read_toml(path), str(path))


def config_from_table(table: Mapping[str, Any], source: str = "config") -> PlannerConfig:
    """Check planner settings given as nested dictionaries (the shape of the TOML file).

    Args:
      table: settings; those left out come from the preset it names, `robust` by default.
      source: prefix of error messages.

    Raises:
      InputError: unknown key, wrong type, or value out of range.
    """
    try:
        base = preset(checked.one_of("preset", table.get("preset", "robust"), list(PRESETS)))
        settings = {key: value for key, value in table.items() if key != "preset"}
        return _consistent(_filled(base, settings, ""))
    except InputError as error:
        raise InputError(f"{source}: {error}") from None


def config_to_toml(config: PlannerConfig) -> str:
    """All settings as TOML text, which `load_config` reads back to an equal configuration."""
    lines: list[str] = []
    for name in _names(config):
        _write(lines, getattr(config, name), name)
    return "\n".join(lines) + "\n"


def without(config: PlannerConfig, names: Sequence[str]) -> PlannerConfig:
    """The configuration with features of `FEATURES` switched off and nothing else changed.

    Raises:
      InputError: unknown feature.
    """
    for name in names:
        for path, value in FEATURES[checked.one_of("without", name, list(FEATURES))].items():
            config = _replaced(config, path.split("."), value)
    return config


def named_config(name: str) -> PlannerConfig:
    """Planner settings of a preset by its name, else from a file.

    Raises:
      InputError: neither a preset nor a readable, correct file.
    """
    return preset(name) if is_name("config", name, PRESETS) else load_config(name)


def with_settings(config: PlannerConfig, settings: Mapping[str, Any]) -> PlannerConfig:
    """The configuration with single settings replaced, given by dotted name (`reference.speed`).

    Raises:
      InputError: unknown name, wrong type, or value out of range.
    """
    for name, value in settings.items():
        table: Any = value
        for part in reversed(name.split(".")):
            table = {part: table}
        config = _filled(config, table, "")
    return _consistent(config)


def _consistent(config: PlannerConfig) -> PlannerConfig:
    """The configuration if its settings fit together."""
    arrive, leave = config.reference.arrive, config.reference.leave
    if arrive > leave:
        raise InputError(f"reference.arrive = {arrive:g}: must be <= reference.leave = {leave:g}")
    for name in _names(config.constraints):
        barrier = getattr(config.constraints, name)
        if isinstance(barrier, Barrier) and not barrier.reach > barrier.switch:
            where, switch = f"constraints.{name}", f"{barrier.switch:g}"
            raise InputError(f"{where}.reach = {barrier.reach:g}: must be > {where}.switch = {switch}")
    return config


def _names(node: Any) -> list[str]:
    return [f.name for f in dataclasses.fields(node)]


def _filled(node: T, table: Any, where: str) -> T:
    """A group of settings with the values of its table put in."""
    table = checked.known_keys(where or "config", table, _names(node))
    hints = get_type_hints(type(node))
    values: dict[str, Any] = {}
    for name, given in table.items():
        field = f"{where}.{name}" if where else name
        present = getattr(node, name)
        low, high = RANGES.get(f"{type(node).__name__}.{name}", _DEFAULT_RANGE)
        if dataclasses.is_dataclass(present):
            values[name] = _filled(present, given, field)
        elif isinstance(present, tuple):
            numbers = checked.vector(field, given, len(present))
            values[name] = tuple(checked.number(f"{field}[{i}]", v, low, high) for i, v in enumerate(numbers))
        elif hints[name] is bool:
            values[name] = checked.flag(field, given)
        elif hints[name] is int:
            values[name] = checked.whole(field, given, int(low), int(high))
        else:
            values[name] = checked.number(field, given, low, high)
    return dataclasses.replace(node, **values)  # type: ignore[type-var]


def _write(lines: list[str], node: Any, where: str) -> None:
    """Append the table of one group and those of its subgroups."""
    groups = [name for name in _names(node) if dataclasses.is_dataclass(getattr(node, name))]
    lines += ([""] if lines else []) + [f"[{where}]"]
    for name in _names(node):
        if name not in groups:
            lines.append(f"{name} = {_text(getattr(node, name))}")
    for name in groups:
        _write(lines, getattr(node, name), f"{where}.{name}")


def _text(value: Any) -> str:
    if isinstance(value, tuple):
        return f"[{', '.join(_text(v) for v in value)}]"
    if isinstance(value, bool):
        return str(value).lower()
    # repr is the shortest text that reads back as the same double; a tuned setting may be a scalar array.
    return repr(value) if isinstance(value, int) else repr(float(value))


def _replaced(node: T, path: list[str], value: float) -> T:
    """The nested dataclass with one setting replaced; a tuple is filled with the value."""
    present = getattr(node, path[0])
    if len(path) > 1:
        new = _replaced(present, path[1:], value)
    else:
        new = (value,) * len(present) if isinstance(present, tuple) else value
    return dataclasses.replace(node, **{path[0]: new})  # type: ignore[type-var]
