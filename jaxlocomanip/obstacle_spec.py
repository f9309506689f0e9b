"""Obstacles of a scenario file: `[[obstacles]]` and their motions, checked field by field."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Any

from jaxlocomanip import checked
from jaxlocomanip.checked import InputError

Point = tuple[float, float]

FARTHEST_OBSTACLE = 1e4
"""m from the origin, where single precision still knows millimetres"""


@dataclass(frozen=True)
class MotionSpec:
    """`motion` of an obstacle: a sine about its position or waypoints in the world."""

    kind: str
    amplitude: Point = (0.0, 0.0)
    period: float = 1.0
    times: tuple[float, ...] = ()
    points: tuple[Point, ...] = ()


@dataclass(frozen=True)
class ObstacleSpec:
    """`[[obstacles]]`: a box, circle or convex polygon, at rest or moving."""

    shape: str
    position: Point
    size: Point | None = None
    yaw: float = 0.0
    radius: float = 0.0
    vertices: tuple[Point, ...] = ()
    velocity: Point = (0.0, 0.0)
    motion: MotionSpec | None = None


def box(size: Any, field: str, yaw: float = 0.0) -> tuple[Point, ...]:
    """Corners of a box of size (x, y) turned by yaw, counter-clockwise from the lower left one."""
    x, y = (checked.positive(f"{field}[{i}]", v) / 2.0 for i, v in enumerate(checked.pair(field, size)))
    c, s = math.cos(yaw), math.sin(yaw)
    return tuple((c * a - s * b, s * a + c * b) for a, b in ((-x, -y), (x, -y), (x, y), (-x, y)))


def parse_obstacle(index: int, table: Any) -> ObstacleSpec:
    """Check one table of `[[obstacles]]`.

    Raises:
      InputError: unknown or missing key, wrong type, or value out of range.
    """
    where = f"obstacles[{index}]"
    table = checked.known_keys(where, table, checked.field_names(ObstacleSpec), ("shape", "position"))
    shape = checked.one_of(f"{where}.shape", table["shape"], ("box", "circle", "polygon"))
    own = {"box": ("size", "yaw"), "circle": ("radius",), "polygon": ("vertices",)}[shape]
    checked.known_keys(f"{where} (a {shape})", table, ("shape", "position", "velocity", "motion", *own), own[:1])
    yaw = checked.number(f"{where}.yaw", table.get("yaw", 0.0), -100.0, 100.0)
    vertices = {
        "box": lambda: box(table["size"], f"{where}.size", yaw),
        "circle": lambda: ((0.0, 0.0),),
        "polygon": lambda: checked.convex_polygon(f"{where}.vertices", table["vertices"]),
    }[shape]()
    spec = ObstacleSpec(
        shape=shape,
        position=checked.pair(f"{where}.position", table["position"], FARTHEST_OBSTACLE),
        size=checked.pair(f"{where}.size", table["size"]) if shape == "box" else None,
        yaw=yaw,
        radius=checked.positive(f"{where}.radius", table["radius"]) if shape == "circle" else 0.0,
        vertices=vertices,
        velocity=checked.pair(f"{where}.velocity", table.get("velocity", (0.0, 0.0))),
        motion=_motion(f"{where}.motion", table["motion"]) if "motion" in table else None,
    )
    if spec.motion is not None and spec.motion.kind == "waypoints":
        _refuse_two_motions(where, spec, spec.motion.points[0])
    return spec


def _refuse_two_motions(where: str, spec: ObstacleSpec, first: Point) -> None:
    """Waypoints are places in the world, which leave nothing to a position or a velocity."""
    if spec.velocity != (0.0, 0.0):
        raise InputError(f"{where}.velocity = {list(spec.velocity)}: must be left out where waypoints say the motion")
    if spec.position != first:
        raise InputError(f"{where}.position = {list(spec.position)}: must be the first waypoint, {list(first)}")


def _motion(where: str, table: Any) -> MotionSpec:
    table = checked.known_keys(where, table, checked.field_names(MotionSpec), ("kind",))
    kind = checked.one_of(f"{where}.kind", table["kind"], ("sine", "waypoints"))
    own = {"sine": ("amplitude", "period"), "waypoints": ("times", "points")}[kind]
    checked.known_keys(f"{where} (kind {kind})", table, ("kind", *own), own)
    if kind == "sine":
        return MotionSpec(
            kind,
            checked.pair(f"{where}.amplitude", table["amplitude"]),
            checked.positive(f"{where}.period", table["period"]),
        )
    points = checked.points(f"{where}.points", table["points"], 1, FARTHEST_OBSTACLE)
    times = checked.vector(f"{where}.times", table["times"], len(points))
    if any(b <= a for a, b in zip(times, times[1:], strict=False)):
        raise InputError(f"{where}.times = {list(times)}: must increase")
    return MotionSpec(kind, times=times, points=points)
