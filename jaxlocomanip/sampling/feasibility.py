"""Scenarios that no planner could solve, found before they are simulated.

Only the impossible is rejected, and what leaves less room than measured poses need; each rejection has a reason that is
counted:

- `capacity`: the team cannot push the object straight towards the goal with more than its sliding friction, whatever
  heading between the start's and the goal's it has. The set of directions that a team can move a sliding object in at
  one heading is convex, so a detour does not help. Or it finds a way between standing obstacles only in directions in
  which it is not strong enough (`passage`): two robots that move the object only together cannot leave an obstacle that
  stands in their common direction.
- `start`: an obstacle overlaps the object or a robot at t = 0, or standing ones enclose the start: the team cannot
  leave it (`enclosure`).
- `goal`: at exactly the goal pose the object, or a robot at each of its contact offsets that are tried, overlaps a
  standing obstacle, or a moving one during the last seconds that count. The tolerances forgive nothing here: they are
  for the planner's error, and a goal that nobody could stand at is not one. Or standing obstacles enclose the
  goal: the team cannot come within its tolerances from anywhere (`enclosure`).
- `contact`: the robots' contact offsets at the start are off their faces or in each other's way.
- `blocked`: standing obstacles leave only corridors narrower than what the team sweeps over, for a team that can push
  but not pull, and turns the object only as it moves it (`passage`).
- `narrow`: there may be a way, but none was found with up to 3 cm of room (`bodies.ROOM`) on a grid of poses. A planner
  that knows all poses exactly might do some of these.

Moving obstacles make a scenario impossible only where they stand at the start or pass the goal at the end. Not rejected
is, among others, one in which a moving obstacle runs over a team that has no way out: see `Outcome.run_over`.
"""

from __future__ import annotations

import math
from typing import Any

import numpy as np
from numpy.typing import NDArray

from jaxlocomanip.build import build_on_host
from jaxlocomanip.build_team import robot_rectangles
from jaxlocomanip.checked import InputError
from jaxlocomanip.footprint import padded, placed, polygon_gap
from jaxlocomanip.obstacles import corners_at, moves, position_at
from jaxlocomanip.sampling.passage import obstruction
from jaxlocomanip.sampling.pushing import PUSH_RESERVE, offset_limits, pushes, sliding_friction, strength
from jaxlocomanip.scenario import Scenario
from jaxlocomanip.specification import ScenarioSpec

Floats = NDArray[np.floating[Any]]

REASONS = ("capacity", "start", "goal", "contact", "blocked", "narrow")
"""Why scenarios are rejected."""
OFFSETS = (0.0, -0.25, 0.25, -0.5, 0.5, -0.75, 0.75, -1.0, 1.0)
"""contact offsets that are tried at the goal, as parts of their limits"""
END = 2.0
"""s before the end during which the object has to be at the goal (`outcome.HOLD`)"""


def judged(spec: ScenarioSpec, index: int) -> Scenario | str:
    """The arrays of a scenario, or the reason why it is rejected; the cheapest checks come first."""
    if capacity(spec) < PUSH_RESERVE * sliding_friction(spec):
        return "capacity"
    try:
        scenario = build_on_host(spec, index)
    except InputError as error:
        # Of the refusals of `build`, those about obstacles and the goal name them first.
        field = str(error)
        return "start" if field.startswith("obstacles") else "goal" if field.startswith("goal") else "contact"
    if _no_room_at_goal(spec):
        return "goal"
    return obstruction(spec) or scenario


def capacity(spec: ScenarioSpec) -> float:
    """N, the largest push that the team can exert straight towards the goal, at the best heading on the way there."""
    way = np.array(spec.goal.pose[:2]) - np.array(spec.start[:2])
    length = math.hypot(*way)
    if length < spec.goal.position_tolerance:
        return math.inf
    turn = math.remainder(spec.goal.pose[2] - spec.start[2], 2.0 * math.pi)
    headings = spec.start[2] + turn * np.linspace(0.0, 1.0, 1 + math.ceil(abs(turn) / 0.1))
    bearing = math.atan2(way[1], way[0])
    directions = np.stack([np.cos(bearing - headings), np.sin(bearing - headings)], axis=1)
    return float(strength(*pushes(spec), directions).max())


def _at_the_end(spec: ScenarioSpec) -> tuple[Floats, Floats]:
    """Corners [n, V, 2] and radii [n] of obstacles near the goal over the last seconds."""
    shapes, radii = [], []
    bodies = [np.array(spec.object.footprint), *robot_rectangles(spec, (0.0, 0.0, 0.0), [0.0] * len(spec.robots))]
    # A robot may stand beside the middle of its face, by half the face at most.
    reach = 1.5 * max(np.linalg.norm(body, axis=1).max() for body in bodies)
    for obstacle in spec.obstacles:
        times = np.linspace(max(spec.duration - END, 0.0), spec.duration, 11) if moves(obstacle) else [0.0]
        for time in times:
            size = obstacle.radius + float(np.linalg.norm(obstacle.vertices, axis=1).max())
            if math.dist(position_at(obstacle, float(time)), spec.goal.pose[:2]) < reach + size:
                shapes.append(corners_at(obstacle, float(time)))
                radii.append(obstacle.radius)
    return padded(shapes) if shapes else np.zeros((0, 1, 2)), np.array(radii)


def _no_room_at_goal(spec: ScenarioSpec) -> bool:
    """Whether the object at exactly the goal pose, or a robot there wherever on its face it pushes, is in the way."""
    shapes, radii = _at_the_end(spec)
    footprint = np.array(spec.object.footprint)
    if not _clear(placed(spec.goal.pose, footprint)[None], shapes, radii).all():
        return True
    # Offsets are each robot's own choice: it needs one of them to be clear, most often the middle one.
    limits, clear = offset_limits(spec), np.zeros(len(spec.robots), bool)
    for part in OFFSETS:
        clear |= _clear(robot_rectangles(spec, spec.goal.pose, (part * limits).tolist()), shapes, radii)
        if clear.all():
            return False
    return True


def _clear(bodies: Floats, shapes: Floats, radii: Floats) -> NDArray[np.bool_]:
    """[n] whether bodies [n, V, 2] overlap none of the shapes."""
    return np.all(polygon_gap(bodies[:, None], shapes[None], radii) >= 0.0, axis=1)
