"""Scenario files: TOML (or plain dictionaries) checked field by field and built into arrays.

A `ScenarioSpec` mirrors the file; `build` turns it into a `scenario.Scenario`. Unknown keys are refused with the
nearest known name, and values outside their range with the field, the value and what is allowed.
"""

from __future__ import annotations

import tomllib
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from jaxlocomanip import checked
from jaxlocomanip.checked import InputError
from jaxlocomanip.obstacle_spec import ObstacleSpec, Point, box, parse_obstacle
from jaxlocomanip.robots.model import ROBOT_TYPES

BOX_FACES = ("-y", "+x", "+y", "-x")
"""Names of a box's faces in the order of its edges, counter-clockwise from the lower one."""

LONGEST_DELAY = 0.1
"""s, between a command and the robots' reaction"""
FARTHEST = 100.0
"""m from the origin, and rad, where single precision still knows the way of a slow object within a tick"""

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
        truth=_truth(data.get("truth", {}), body),
        start=_pose("start.pose", start["pose"]),
        goal=_goal(data["goal"]),
        robots=tuple(_robot(i, r, body) for i, r in enumerate(_tables("robots", data["robots"], 1))),
        obstacles=tuple(parse_obstacle(i, o) for i, o in enumerate(_tables("obstacles", data.get("obstacles", []), 0))),
        sensing=_sensing(data.get("sensing", {})),
        change_faces=checked.flag("change_faces", data.get("change_faces", False)),
    )


def _tables(field: str, value: Any, at_least: int) -> list[Any]:
    if not isinstance(value, list | tuple) or len(value) < at_least:
        raise InputError(f"{field}: must be a list of at least {at_least} tables")
    return list(value)


def _pose(field: str, value: Any) -> Pose:
    x, y, heading = checked.vector(field, value, 3, FARTHEST)
    return x, y, heading


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
        mass=checked.positive("object.mass", table["mass"]),
        height=checked.positive("object.height", table.get("height", 0.5)),
        inertia=checked.positive("object.inertia", table["inertia"]) if "inertia" in table else None,
        friction=checked.number("object.friction", table["friction"], 0.0, 2.0) if "friction" in table else None,
        com=_within("object.com", table.get("com", (0.0, 0.0)), shape),
    )


def _within(field: str, value: Any, polygon: tuple[Point, ...]) -> Point:
    """A point that is not outside of a convex counter-clockwise polygon."""
    x, y = checked.pair(field, value)
    for (ax, ay), (bx, by) in zip(polygon, (*polygon[1:], polygon[0]), strict=True):
        if (bx - ax) * (y - ay) - (by - ay) * (x - ax) < 0.0:
            raise InputError(f"{field} = {[x, y]}: must lie within the object's footprint")
    return x, y


def _truth(table: Any, body: ObjectSpec) -> TruthSpec:
    table = checked.known_keys("truth", table, checked.field_names(TruthSpec))
    return TruthSpec(
        mass=checked.positive("truth.mass", table["mass"]) if "mass" in table else None,
        inertia=checked.positive("truth.inertia", table["inertia"]) if "inertia" in table else None,
        friction=checked.number("truth.friction", table["friction"], 0.0, 2.0) if "friction" in table else None,
        com=_within("truth.com", table["com"], body.footprint) if "com" in table else None,
    )


def _goal(table: Any) -> GoalSpec:
    table = checked.known_keys("goal", table, checked.field_names(GoalSpec), ("pose",))
    return GoalSpec(
        pose=_pose("goal.pose", table["pose"]),
        position_tolerance=checked.positive("goal.position_tolerance", table.get("position_tolerance", 0.15)),
        heading_tolerance=checked.positive("goal.heading_tolerance", table.get("heading_tolerance", 0.3)),
    )


def _robot(index: int, table: Any, body: ObjectSpec) -> RobotSpec:
    where = f"robots[{index}]"
    table = checked.known_keys(where, table, checked.field_names(RobotSpec), ("type", "face"))
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


def _sensing(table: Any) -> SensingSpec:
    table = checked.known_keys("sensing", table, checked.field_names(SensingSpec))
    limits = {"position_std": 0.1, "heading_std": 0.3, "obstacle_std": 0.5, "command_delay": LONGEST_DELAY}
    return SensingSpec(**{k: checked.number(f"sensing.{k}", v, 0.0, limits[k]) for k, v in table.items()})
