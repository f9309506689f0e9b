"""Scenario files: TOML (or plain dictionaries) checked field by field and built into arrays.

A `ScenarioSpec` mirrors the file; `build` turns it into a `scenario.Scenario`. Unknown keys are refused with the
nearest known name, and values outside their range with the field, the value and what is allowed.
"""

from __future__ import annotations

import math
import tomllib
from collections.abc import Mapping
from dataclasses import dataclass, fields
from pathlib import Path
from typing import Any

from jaxlocomanip import checked
from jaxlocomanip.checked import InputError
from jaxlocomanip.robots.model import ROBOT_TYPES

BOX_FACES = ("-y", "+x", "+y", "-x")
"""Names of a box's faces in the order of its edges, counter-clockwise from the lower one."""

Point = tuple[float, float]
Pose = tuple[float, float, float]


@dataclass(frozen=True)
class ObjectSpec:
    """`[object]`: shape and what the planner believes of the mechanics."""

    footprint: tuple[Point, ...]
    is_box: bool
    mass: float
    height: float = 0.5
    inertia: float | None = None
    friction: float | None = None
    com: Point = (0.0, 0.0)


@dataclass(frozen=True)
class TruthSpec:
    """`[truth]`: what the world is; what is left out equals the belief."""

    mass: float | None = None
    inertia: float | None = None
    friction: float | None = None
    com: Point | None = None


@dataclass(frozen=True)
class GoalSpec:
    """`[goal]`: pose and tolerances."""

    pose: Pose
    position_tolerance: float = 0.15
    heading_tolerance: float = 0.3


@dataclass(frozen=True)
class RobotSpec:
    """`[[robots]]`: type, face (name or edge index) and contact offset along the face."""

    type: str
    face: str | int
    offset: float = 0.0


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


@dataclass(frozen=True)
class SensingSpec:
    """`[sensing]`: white measurement noise and command delay of the world (default: none)."""

    position_std: float = 0.0
    heading_std: float = 0.0
    obstacle_std: float = 0.0
    command_delay: float = 0.0


@dataclass(frozen=True)
class ScenarioSpec:
    """A whole scenario file."""

    name: str
    duration: float
    object: ObjectSpec
    start: Pose
    goal: GoalSpec
    robots: tuple[RobotSpec, ...]
    obstacles: tuple[ObstacleSpec, ...] = ()
    truth: TruthSpec = TruthSpec()
    sensing: SensingSpec = SensingSpec()
    change_faces: bool = False
    """the team may walk around the object to push at other faces"""


def load_scenario(path: str | Path) -> ScenarioSpec:
    """Read and check a scenario file.

    Raises:
      InputError: the file is missing, unreadable, not TOML, or has a bad value; the text names file and field.
    """
    return parse_scenario(read_toml(path), str(path))


def read_toml(path: str | Path) -> dict[str, Any]:
    """A TOML file as a dictionary, with every failure an `InputError` naming the file."""
    try:
        return tomllib.loads(Path(path).read_text(encoding="utf-8"))
    except OSError as error:
        raise InputError(f"{path}: cannot be read ({error.strerror})") from error
    except (tomllib.TOMLDecodeError, UnicodeDecodeError) as error:
        raise InputError(f"{path}: is not valid TOML ({error})") from error


def parse_scenario(data: Mapping[str, Any], source: str = "scenario") -> ScenarioSpec:
    """Check a scenario given as nested dictionaries (the shape of the TOML file).

    Raises:
      InputError: prefixed with `source`.
    """
    try:
        return _scenario(data)
    except InputError as error:
        raise InputError(f"{source}: {error}") from None


def _scenario(data: Mapping[str, Any]) -> ScenarioSpec:
    keys = ("name", "duration", "object", "truth", "start", "goal", "robots", "obstacles", "sensing", "change_faces")
    checked.known_keys("scenario", data, keys, ("name", "object", "start", "goal", "robots"))
    start = checked.known_keys("start", data["start"], ("pose",), ("pose",))
    body = _object(data["object"])
    return ScenarioSpec(
        name=checked.name("name", data["name"]),
        duration=checked.number("duration", data.get("duration", 40.0), 0.1, 3600.0),
        object=body,
        truth=_truth(data.get("truth", {})),
        start=_pose("start.pose", start["pose"]),
        goal=_goal(data["goal"]),
        robots=tuple(_robot(i, r, body) for i, r in enumerate(_tables("robots", data["robots"], 1))),
        obstacles=tuple(_obstacle(i, o) for i, o in enumerate(_tables("obstacles", data.get("obstacles", []), 0))),
        sensing=_sensing(data.get("sensing", {})),
        change_faces=checked.flag("change_faces", data.get("change_faces", False)),
    )


def _names(spec: type) -> list[str]:
    return [f.name for f in fields(spec)]


def _tables(field: str, value: Any, at_least: int) -> list[Any]:
    if not isinstance(value, list | tuple) or len(value) < at_least:
        raise InputError(f"{field}: must be a list of at least {at_least} tables")
    return list(value)


def _pose(field: str, value: Any) -> Pose:
    x, y, heading = checked.vector(field, value, 3)
    return x, y, heading


def _pair(field: str, value: Any) -> Point:
    x, y = checked.vector(field, value, 2)
    return x, y


def _positive(field: str, value: Any, high: float = float("inf")) -> float:
    return checked.number(field, value, 0.0, high, strictly=True)


def box(size: Any, field: str, yaw: float = 0.0) -> tuple[Point, ...]:
    """Corners of a box of size (x, y) turned by yaw, counter-clockwise from the lower left one."""
    x, y = (_positive(f"{field}[{i}]", v) / 2.0 for i, v in enumerate(_pair(field, size)))
    c, s = math.cos(yaw), math.sin(yaw)
    return tuple((c * a - s * b, s * a + c * b) for a, b in ((-x, -y), (x, -y), (x, y), (-x, y)))


def _object(table: Any) -> ObjectSpec:
    keys = ("size", "footprint", "height", "mass", "inertia", "friction", "com")
    table = checked.known_keys("object", table, keys, ("mass",))
    if ("size" in table) == ("footprint" in table):
        raise InputError("object: exactly one of size and footprint must be given")
    is_box = "size" in table
    shape = (
        box(table["size"], "object.size") if is_box else checked.convex_polygon("object.footprint", table["footprint"])
    )
    return ObjectSpec(
        footprint=shape,
        is_box=is_box,
        mass=_positive("object.mass", table["mass"]),
        height=_positive("object.height", table.get("height", 0.5)),
        inertia=_positive("object.inertia", table["inertia"]) if "inertia" in table else None,
        friction=checked.number("object.friction", table["friction"], 0.0, 2.0) if "friction" in table else None,
        com=_pair("object.com", table.get("com", (0.0, 0.0))),
    )


def _truth(table: Any) -> TruthSpec:
    table = checked.known_keys("truth", table, _names(TruthSpec))
    return TruthSpec(
        mass=_positive("truth.mass", table["mass"]) if "mass" in table else None,
        inertia=_positive("truth.inertia", table["inertia"]) if "inertia" in table else None,
        friction=checked.number("truth.friction", table["friction"], 0.0, 2.0) if "friction" in table else None,
        com=_pair("truth.com", table["com"]) if "com" in table else None,
    )


def _goal(table: Any) -> GoalSpec:
    table = checked.known_keys("goal", table, _names(GoalSpec), ("pose",))
    return GoalSpec(
        pose=_pose("goal.pose", table["pose"]),
        position_tolerance=_positive("goal.position_tolerance", table.get("position_tolerance", 0.15)),
        heading_tolerance=_positive("goal.heading_tolerance", table.get("heading_tolerance", 0.3)),
    )


def _robot(index: int, table: Any, body: ObjectSpec) -> RobotSpec:
    where = f"robots[{index}]"
    table = checked.known_keys(where, table, _names(RobotSpec), ("type", "face"))
    face, count = table["face"], len(body.footprint)
    if body.is_box and isinstance(face, str):
        face = checked.one_of(f"{where}.face", face, BOX_FACES)
    elif isinstance(face, bool) or not isinstance(face, int) or not 0 <= face < count:
        names = f" or one of {', '.join(BOX_FACES)}" if body.is_box else ""
        raise InputError(f"{where}.face = {face!r}: must be an edge index from 0 to {count - 1}{names}")
    return RobotSpec(
        type=checked.one_of(f"{where}.type", table["type"], ROBOT_TYPES),
        face=face,
        offset=checked.number(f"{where}.offset", table.get("offset", 0.0)),
    )


def _obstacle(index: int, table: Any) -> ObstacleSpec:
    where = f"obstacles[{index}]"
    table = checked.known_keys(where, table, _names(ObstacleSpec), ("shape", "position"))
    shape = checked.one_of(f"{where}.shape", table["shape"], ("box", "circle", "polygon"))
    own = {"box": ("size", "yaw"), "circle": ("radius",), "polygon": ("vertices",)}[shape]
    checked.known_keys(f"{where} (a {shape})", table, ("shape", "position", "velocity", "motion", *own), own[:1])
    yaw = checked.number(f"{where}.yaw", table.get("yaw", 0.0))
    vertices = {
        "box": lambda: box(table["size"], f"{where}.size", yaw),
        "circle": lambda: ((0.0, 0.0),),
        "polygon": lambda: checked.convex_polygon(f"{where}.vertices", table["vertices"]),
    }[shape]()
    return ObstacleSpec(
        shape=shape,
        position=_pair(f"{where}.position", table["position"]),
        size=_pair(f"{where}.size", table["size"]) if shape == "box" else None,
        yaw=yaw,
        radius=_positive(f"{where}.radius", table["radius"]) if shape == "circle" else 0.0,
        vertices=vertices,
        velocity=_pair(f"{where}.velocity", table.get("velocity", (0.0, 0.0))),
        motion=_motion(f"{where}.motion", table["motion"]) if "motion" in table else None,
    )


def _motion(where: str, table: Any) -> MotionSpec:
    table = checked.known_keys(where, table, _names(MotionSpec), ("kind",))
    kind = checked.one_of(f"{where}.kind", table["kind"], ("sine", "waypoints"))
    own = {"sine": ("amplitude", "period"), "waypoints": ("times", "points")}[kind]
    checked.known_keys(f"{where} (kind {kind})", table, ("kind", *own), own)
    if kind == "sine":
        return MotionSpec(
            kind,
            _pair(f"{where}.amplitude", table["amplitude"]),
            _positive(f"{where}.period", table["period"]),
        )
    points = checked.points(f"{where}.points", table["points"], 1)
    times = checked.vector(f"{where}.times", table["times"], len(points))
    if any(b <= a for a, b in zip(times, times[1:], strict=False)):
        raise InputError(f"{where}.times = {list(times)}: must increase")
    return MotionSpec(kind, times=times, points=points)


def _sensing(table: Any) -> SensingSpec:
    table = checked.known_keys("sensing", table, _names(SensingSpec))
    limits = {"position_std": 0.1, "heading_std": 0.3, "obstacle_std": 0.5, "command_delay": 0.1}
    return SensingSpec(**{k: checked.number(f"sensing.{k}", v, 0.0, limits[k]) for k, v in table.items()})
