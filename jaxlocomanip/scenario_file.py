"""Scenarios as TOML text: the inverse of `specification.load_scenario`."""

from __future__ import annotations

import json
from collections.abc import Mapping
from typing import Any

from jaxlocomanip.obstacle_spec import MotionSpec, ObstacleSpec
from jaxlocomanip.specification import ObjectSpec, ScenarioSpec


def scenario_to_toml(spec: ScenarioSpec) -> str:
    """A scenario as TOML text, which `parse_scenario` and `load_scenario` read back to an equal one."""
    lines = [f"name = {_text(spec.name)}", f"duration = {_text(spec.duration)}"]
    if spec.change_faces:
        lines.append("change_faces = true")
    _table(lines, "[object]", _object(spec.object))
    _table(lines, "[truth]", _given(spec.truth))
    _table(lines, "[start]", {"pose": spec.start})
    _table(lines, "[goal]", _given(spec.goal))
    _table(lines, "[sensing]", _given(spec.sensing))
    for robot in spec.robots:
        _table(lines, "[[robots]]", _given(robot))
    for obstacle in spec.obstacles:
        _table(lines, "[[obstacles]]", _obstacle(obstacle))
    return "\n".join(lines) + "\n"


def _table(lines: list[str], head: str, values: Mapping[str, Any]) -> None:
    if values:
        lines += ["", head, *(f"{key} = {_text(value)}" for key, value in values.items())]


def _given(spec: Any) -> dict[str, Any]:
    """Fields that have a value."""
    return {key: value for key, value in vars(spec).items() if value is not None}


def _object(spec: ObjectSpec) -> dict[str, Any]:
    others = _given(spec)
    footprint = others.pop("footprint")
    if others.pop("is_box"):
        low, high = footprint[0], footprint[2]
        return {"size": (high[0] - low[0], high[1] - low[1]), **others}
    return {"footprint": footprint, **others}


def _obstacle(spec: ObstacleSpec) -> dict[str, Any]:
    own: dict[str, Any] = {
        "box": {"size": spec.size, "yaw": spec.yaw},
        "circle": {"radius": spec.radius},
        "polygon": {"vertices": spec.vertices},
    }[spec.shape]
    motion = {} if spec.motion is None else {"motion": _motion(spec.motion)}
    return {"shape": spec.shape, "position": spec.position, **own, "velocity": spec.velocity, **motion}


def _motion(spec: MotionSpec) -> dict[str, Any]:
    if spec.kind == "sine":
        return {"kind": spec.kind, "amplitude": spec.amplitude, "period": spec.period}
    return {"kind": spec.kind, "times": spec.times, "points": spec.points}


def _text(value: Any) -> str:
    if isinstance(value, Mapping):
        return f"{{ {', '.join(f'{key} = {_text(one)}' for key, one in value.items())} }}"
    if isinstance(value, tuple):
        return f"[{', '.join(_text(one) for one in value)}]"
    if isinstance(value, str):
        return json.dumps(value, ensure_ascii=False)  # the escapes of JSON are those of TOML
    # repr is the shortest text that reads back as the same double.
    return repr(value) if isinstance(value, int) else repr(float(value))
