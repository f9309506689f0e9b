"""From a study's distributions to the tables of one scenario."""

from __future__ import annotations

import math
from typing import Any

import numpy as np

from jaxlocomanip.footprint import footprint_moments
from jaxlocomanip.obstacle_spec import box
from jaxlocomanip.sampling.distributions import Constant
from jaxlocomanip.sampling.draws import Draws
from jaxlocomanip.sampling.parameters import CONSECUTIVE
from jaxlocomanip.sampling.study import Study
from jaxlocomanip.specification import BOX_FACES

_PUSH_ANGLES: dict[str, float] = dict(zip(BOX_FACES, (0.5 * math.pi, math.pi, -0.5 * math.pi, 0.0), strict=True))
"""rad, direction in which a robot at each face of a box pushes"""


class Values:
    """The parameters of one attempt at a lane, drawn when they are asked for."""

    def __init__(self, study: Study, draws: Draws) -> None:
        self._study = study
        self._draws = draws

    def __call__(self, name: str, item: int = 0) -> Any:
        """The value of a parameter; `item` counts robots, axes or obstacles. None where it has no value."""
        distribution = self._study.distribution(name, self._draws.index)
        if distribution is None or isinstance(distribution, Constant):
            return None if distribution is None else distribution.value
        # Every point of a grid or list gets the same draws, so that they are compared on equal terms.
        number = self._draws.index // len(self._study.points)
        return distribution.at(Draws(self._draws.seed, number, self._draws.attempt).uniform(name, item))


def team_faces(study: Study, seed: int, index: int) -> tuple[str, ...] | None:
    """Faces of a lane's robots where the study lists them, else None: from the first attempt, whatever the attempt."""
    faces = Values(study, Draws(seed, index))("team.faces")
    return None if faces == CONSECUTIVE else faces


def team_size(study: Study, seed: int, index: int) -> int:
    """Number of robots of a lane, which no rejection changes, so that it is known before the lane is drawn."""
    faces = team_faces(study, seed, index)
    return len(faces) if faces else Values(study, Draws(seed, index))("team.size")


def scenario_tables(study: Study, draws: Draws) -> dict[str, Any]:
    """The tables of a scenario file for one attempt at a lane."""
    values = Values(study, draws)
    size = values("object.size")
    faces = team_faces(study, draws.seed, draws.index)
    if faces is None:
        first = BOX_FACES.index(values("team.first_face"))
        count = team_size(study, draws.seed, draws.index)
        faces = tuple(BOX_FACES[(first + i) % len(BOX_FACES)] for i in range(count))
    start = (values("start.x"), values("start.y"), values("start.heading"))
    length = values("goal.distance")
    low, width = push_cone([_PUSH_ANGLES[face] for face in faces])
    bearing = start[2] + low + width * values("goal.bearing")
    goal = (
        start[0] + length * math.cos(bearing),
        start[1] + length * math.sin(bearing),
        start[2] + values("goal.heading"),
    )
    body = {"size": size, "height": values("object.height"), "mass": values("object.mass")}
    if (friction := values("object.friction")) is not None:
        body["friction"] = friction
    sensing = ("position_std", "heading_std", "obstacle_std", "command_delay")
    return {
        "name": f"{study.name}-{draws.index:06d}",
        "duration": values("duration"),
        "change_faces": values("team.change_faces"),
        "object": body,
        "truth": _truth(values, size),
        "start": {"pose": start},
        "goal": {
            "pose": goal,
            "position_tolerance": values("goal.position_tolerance"),
            "heading_tolerance": values("goal.heading_tolerance"),
        },
        "robots": [
            {"type": values("team.types", i), "face": face, "offset": values("team.offsets", i)}
            for i, face in enumerate(faces)
        ],
        "obstacles": _obstacles(values, start, length, bearing),
        "sensing": {name: values(f"sensing.{name}") for name in sensing},
    }


def push_cone(angles: list[float]) -> tuple[float, float]:
    """First angle and width, rad, of the directions that pushes at these angles can combine to."""
    turn = 2.0 * math.pi
    ordered = sorted(angle % turn for angle in angles)
    gaps = [(ordered[(i + 1) % len(ordered)] - ordered[i]) % turn or turn for i in range(len(ordered))]
    if len(ordered) == 1:
        return ordered[0], 0.0
    widest = max(range(len(gaps)), key=gaps.__getitem__)
    if gaps[widest] < math.pi - 1e-9:
        return -math.pi, turn
    return ordered[(widest + 1) % len(ordered)], turn - gaps[widest]


def _truth(values: Values, size: tuple[float, float]) -> dict[str, Any]:
    mass = values("truth.mass_ratio") * values("object.mass")
    com = [values("truth.com_offset", axis) * size[axis] / 2.0 for axis in range(2)]
    gyration = footprint_moments(np.array(box(size, "object.size"))).radius_of_gyration
    central = values("truth.inertia_ratio") * mass * gyration**2
    return {
        "mass": mass,
        "friction": values("truth.friction"),
        "com": com,
        "inertia": central + mass * (com[0] ** 2 + com[1] ** 2),
    }


def _obstacles(values: Values, start: Any, length: float, bearing: float) -> list[dict[str, Any]]:
    drawn = [
        {
            "shape": values("obstacles.shape", i),
            "along": values("obstacles.along", i),
            "lateral": values("obstacles.lateral", i),
            "half_size": (values("obstacles.half_size", 2 * i), values("obstacles.half_size", 2 * i + 1)),
            "yaw": values("obstacles.yaw", i),
        }
        for i in range(values("obstacles.count"))
    ]
    placed = [*drawn, *values("obstacles.fixed")]
    moving = min(values("motion.count"), len(placed))
    tables = []
    for i, one in enumerate(placed):
        c, s = math.cos(bearing), math.sin(bearing)
        ahead, left = one["along"] * length, one["lateral"]
        place = (start[0] + c * ahead - s * left, start[1] + s * ahead + c * left)
        a, b = one["half_size"]
        table: dict[str, Any] = {"shape": one["shape"], "position": place}
        if one["shape"] == "circle":
            table["radius"] = a
        else:
            table |= {"size": (2.0 * a, 2.0 * b), "yaw": bearing + one["yaw"]}
        tables.append(_in_motion(values, i, table, bearing) if i < moving else table)
    return tables


def _in_motion(values: Values, i: int, table: dict[str, Any], bearing: float) -> dict[str, Any]:
    """An obstacle's table with its motion: a sine about its place, or a line that passes it at a given time."""
    speed, heading = values("motion.speed", i), bearing + values("motion.heading", i)
    direction = (math.cos(heading), math.sin(heading))
    if values("motion.kind", i) == "sine":
        amplitude = values("motion.amplitude", i)
        way = [amplitude * d for d in direction]
        return table | {"motion": {"kind": "sine", "amplitude": way, "period": 2.0 * math.pi * amplitude / speed}}
    velocity, meeting = [speed * d for d in direction], values("motion.meeting", i)
    place = [p - v * meeting for p, v in zip(table["position"], velocity, strict=True)]
    return table | {"position": place, "velocity": velocity}
