"""What a study may vary: every parameter by name, with what is allowed, what it is if left out, and what it means."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass
from types import MappingProxyType
from typing import Any

from jaxlocomanip import checked
from jaxlocomanip.checked import InputError
from jaxlocomanip.robots.model import ROBOT_TYPES
from jaxlocomanip.sampling.distributions import Check
from jaxlocomanip.specification import BOX_FACES, FARTHEST, LONGEST_DELAY

CONSECUTIVE = "consecutive"
"""faces in a row around the object, from `team.first_face` on"""
MOTIONS = ("line", "sine")
"""How obstacles move."""
MOST_OBSTACLES = 32
"""obstacles that a lane has at most"""
ANGLE = 2.0 * math.pi
"""rad, largest angle that makes sense to state"""


@dataclass(frozen=True)
class Parameter:
    """A quantity that a study may fix, draw, or step through."""

    check: Check
    default: Any
    meaning: str


def _number(low: float, high: float, strictly: bool = False) -> Check:
    return lambda field, value: checked.number(field, value, low, high, strictly)


def _whole(low: int, high: int) -> Check:
    return lambda field, value: checked.whole(field, value, low, high)


def _name(*allowed: str) -> Check:
    return lambda field, value: checked.one_of(field, value, allowed)


def _size(field: str, value: Any) -> tuple[float, ...]:
    pair = checked.vector(field, value, 2)
    return tuple(checked.number(f"{field}[{i}]", v, 0.1, 5.0) for i, v in enumerate(pair))


def _faces(field: str, value: Any) -> str | tuple[str, ...]:
    if value == CONSECUTIVE:
        return CONSECUTIVE
    if isinstance(value, str) or not isinstance(value, list | tuple) or not 1 <= len(value) <= len(BOX_FACES):
        raise InputError(f"{field} = {value!r}: must be '{CONSECUTIVE}' or a list of 1 to 4 of {', '.join(BOX_FACES)}")
    return tuple(checked.one_of(f"{field}[{i}]", face, BOX_FACES) for i, face in enumerate(value))


def _layout(field: str, value: Any) -> tuple[Mapping[str, Any], ...]:
    """Obstacles one by one, in the frame of the straight line from start to goal."""
    if not isinstance(value, list | tuple) or len(value) > MOST_OBSTACLES:
        raise InputError(f"{field} = {value!r}: must be a list of at most {MOST_OBSTACLES} tables")
    made = []
    for i, table in enumerate(value):
        where = f"{field}[{i}]"
        keys = ("shape", "along", "lateral", "half_size", "yaw")
        table = checked.known_keys(where, table, keys, keys[:4])
        sizes = checked.vector(f"{where}.half_size", table["half_size"], 2)
        made.append(
            MappingProxyType(
                {
                    "shape": checked.one_of(f"{where}.shape", table["shape"], ("box", "circle")),
                    "along": checked.number(f"{where}.along", table["along"], -5.0, 5.0),
                    "lateral": checked.number(f"{where}.lateral", table["lateral"], -100.0, 100.0),
                    "half_size": tuple(checked.number(f"{where}.half_size", s, 0.01, 10.0) for s in sizes),
                    "yaw": checked.number(f"{where}.yaw", table.get("yaw", 0.0), -ANGLE, ANGLE),
                }
            )
        )
    return tuple(made)


PARAMETERS: Mapping[str, Parameter] = MappingProxyType(
    {
        "duration": Parameter(_number(0.1, 3600.0), 60.0, "s"),
        "object.size": Parameter(_size, (0.5, 0.5), "m, the object is a box"),
        "object.height": Parameter(_number(0.05, 5.0), 0.5, "m"),
        "object.mass": Parameter(_number(0.1, 1000.0), 6.0, "kg, as believed"),
        "object.friction": Parameter(_number(0.0, 2.0), None, "as believed; left out: unknown to the planner"),
        "truth.mass_ratio": Parameter(_number(0.05, 20.0), 1.0, "true over believed mass"),
        "truth.friction": Parameter(_number(0.0, 2.0), 0.35, "Coulomb coefficient of object on floor"),
        "truth.com_offset": Parameter(
            _number(-0.95, 0.95), 0.0, "of half the size, of the true centre of mass; drawn for each axis"
        ),
        "truth.inertia_ratio": Parameter(
            _number(0.1, 10.0), 1.0, "true inertia about the centre of mass over that of an evenly filled box"
        ),
        "start.x": Parameter(_number(-FARTHEST, FARTHEST), 0.0, "m"),
        "start.y": Parameter(_number(-FARTHEST, FARTHEST), 0.0, "m"),
        "start.heading": Parameter(_number(-ANGLE, ANGLE), 0.0, "rad"),
        "goal.distance": Parameter(_number(0.0, 100.0), 5.0, "m, from the start"),
        "goal.bearing": Parameter(
            _number(0.0, 1.0), 0.5, "direction from start to goal: from one end to the other of where the team can push"
        ),
        "goal.heading": Parameter(_number(-ANGLE, ANGLE), 0.0, "rad, relative to the start's"),
        "goal.position_tolerance": Parameter(_number(0.0, 10.0, True), 0.15, "m"),
        "goal.heading_tolerance": Parameter(_number(0.0, ANGLE, True), 0.3, "rad"),
        "team.size": Parameter(_whole(1, len(BOX_FACES)), 2, "robots; not drawn anew after a rejection"),
        "team.types": Parameter(_name(*ROBOT_TYPES), "aliengo", "drawn for each robot"),
        "team.faces": Parameter(
            _faces,
            CONSECUTIVE,
            "'consecutive', or a list with one face for each robot (then `team.size` does not count)",
        ),
        "team.first_face": Parameter(_name(*BOX_FACES), "-x", "of consecutive faces, which go on counter-clockwise"),
        "team.change_faces": Parameter(
            checked.flag, False, "the team may walk around the object to push at other faces"
        ),
        "team.offsets": Parameter(_number(-5.0, 5.0), 0.0, "m, contact offset at the start; drawn for each robot"),
        "obstacles.count": Parameter(_whole(0, MOST_OBSTACLES), 0, "obstacles beside the fixed ones"),
        "obstacles.shape": Parameter(_name("box", "circle"), "box", "drawn for each obstacle, like all below"),
        "obstacles.half_size": Parameter(_number(0.01, 10.0), 0.3, "m, of each side of a box; radius of a circle"),
        "obstacles.yaw": Parameter(_number(-ANGLE, ANGLE), 0.0, "rad, of a box"),
        "obstacles.along": Parameter(_number(-5.0, 5.0), 0.5, "place along the straight line, 0: start, 1: goal"),
        "obstacles.lateral": Parameter(_number(-100.0, 100.0), 0.0, "m, to the left of the straight line"),
        "obstacles.fixed": Parameter(_layout, (), "obstacles one by one: tables of the five keys above"),
        "motion.count": Parameter(_whole(0, MOST_OBSTACLES), 0, "how many of the obstacles move, the fixed ones last"),
        "motion.kind": Parameter(_name(*MOTIONS), "line", "drawn for each moving obstacle, like all below"),
        "motion.speed": Parameter(_number(0.001, 10.0), 0.3, "m/s; of a sine its largest"),
        "motion.heading": Parameter(_number(-ANGLE, ANGLE), 0.0, "rad, direction relative to the straight line"),
        "motion.amplitude": Parameter(_number(0.01, 100.0), 1.0, "m, of a sine about the obstacle's place"),
        "motion.meeting": Parameter(_number(0.0, 3600.0), 0.0, "s, when an obstacle on a line is at its place"),
        "sensing.position_std": Parameter(_number(0.0, 0.1), 0.0, "m"),
        "sensing.heading_std": Parameter(_number(0.0, 0.3), 0.0, "rad"),
        "sensing.obstacle_std": Parameter(_number(0.0, 0.5), 0.0, "m"),
        "sensing.command_delay": Parameter(_number(0.0, LONGEST_DELAY), 0.0, "s"),
    }
)
"""By dotted name: `truth.mass_ratio` is the key `mass_ratio` of the table `[truth]`."""
