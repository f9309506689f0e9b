"""Whose body is whose in a world that has bodies in space."""

from __future__ import annotations

from typing import NamedTuple

from jaxlocomanip.checked import InputError
from jaxlocomanip.recording import palette
from jaxlocomanip.recording.history import History, robot_names
from jaxlocomanip.recording.palette import RGB
from jaxlocomanip.recording.quadruped import Part, parts
from jaxlocomanip.robots.model import ROBOT_TYPES


class Member(NamedTuple):
    """One robot of a team, with its rows among the world's bodies."""

    name: str
    kind: str
    """robot type"""
    color: RGB
    first: int
    """number of its trunk among the bodies"""
    parts: list[Part]


def team(episode: History) -> list[Member]:
    """The robots of an episode whose world has bodies.

    Raises:
      InputError: the bodies are not those of the packaged robots.
    """
    scenario, log = episode
    members, first = [], 1  # the object comes before the robots
    for i, name in enumerate(robot_names(scenario)):
        kind, color = ROBOT_TYPES[int(scenario.team.kind[i])], palette.robot_color(i)
        members.append(Member(name, kind, color, first, parts(kind, color)))
        first += len(members[-1].parts)
    count = log.view.bodies.position.shape[1]
    if count != first:
        raise InputError(f"log.view.bodies has {count} bodies: the object and this team's packaged robots have {first}")
    return members
