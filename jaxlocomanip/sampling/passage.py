"""Whether there is any way for a team from start to goal between standing obstacles.

A flood over poses (centre of mass, heading) of the object, in a frame along the straight line: the team moves the
object in directions in which it can push at its heading, and turns it only as far as it moves it (`pushing`). The
bodies are discs and corners inside the true ones, smaller still by what the grid could get wrong, and robots may be
anywhere along their faces at each pose, so that a way is found wherever there is one; some scenarios without any are
let through. Coarser floods go first, with discs around the bodies and with the bodies as they are on the grid: they are
much faster and find a way in most scenarios. Where they find none, a finer one looks at the start and the goal
(`enclosure`).
"""

from __future__ import annotations

import math
from typing import Any

import numpy as np
from numpy.typing import NDArray

from jaxlocomanip.footprint import placed
from jaxlocomanip.sampling.bodies import Bodies, inner_discs, outer_discs
from jaxlocomanip.sampling.clearance import TRACK, Floor, floor_of, free_poses, pose_at, poses_near, shrunk
from jaxlocomanip.sampling.enclosure import enclosed_goal, enclosed_start
from jaxlocomanip.sampling.flood import HEADINGS, Grid, Rules, lenient_rules, reaches, strict_rules
from jaxlocomanip.sampling.pushing import Pushing, pushing
from jaxlocomanip.specification import ScenarioSpec

Floats = NDArray[np.floating[Any]]

COARSE, MEDIUM, FINE = 0.125, 0.1, 0.05
"""m, spacing of the floods"""
_BORDER = 0.3
"""m of room beyond the widest detour that a layout can call for"""


def obstruction(spec: ScenarioSpec) -> str | None:
    """Why no path of poses that the team can push leads from the start to the goal of a scenario.

    `start` or `goal` where it is enclosed there, else `blocked`; None where there is a way.
    """
    floor = floor_of(spec)
    if not floor.obstacles:
        return None
    able = pushing(spec)
    if _way_around(spec, floor, able) or _way_between(spec, floor, able):
        return None
    if enclosed_start(spec, floor, able):
        return "start"
    if enclosed_goal(spec, floor, able):
        return "goal"
    return None if way_within(spec, floor, able) else "blocked"


def _way_around(spec: ScenarioSpec, floor: Floor, able: Pushing) -> bool:
    """Whether there is a way for discs around the bodies."""
    bodies = outer_discs(spec, able.com)
    grid = _grid(spec, floor, able, bodies, COARSE, 1)
    return _passable(spec, floor, able, bodies, grid, strict_rules(able, grid), 0.0)


def _way_between(spec: ScenarioSpec, floor: Floor, able: Pushing) -> bool:
    """Whether there is a way for the bodies, as far as some discs and corners show at poses on a grid."""
    bodies = inner_discs(spec, able.com, 3)
    grid = _grid(spec, floor, able, bodies, MEDIUM, 1)
    return _passable(spec, floor, able, bodies, grid, strict_rules(able, grid), 0.0)


def way_within(spec: ScenarioSpec, floor: Floor, able: Pushing) -> bool:
    """Whether there is a way for what is surely within the bodies; the floor has obstacles."""
    bodies = inner_discs(spec, able.com)
    grid = _grid(spec, floor, able, bodies, FINE, 3)
    return _passable(spec, floor, able, shrunk(bodies, grid), grid, lenient_rules(able, grid, 2), TRACK)


def _passable(
    spec: ScenarioSpec, floor: Floor, able: Pushing, bodies: Bodies, grid: Grid, rules: Rules, track: float
) -> bool:
    goal = spec.goal
    heading = spec.start[2] - floor.bearing
    begin = pose_at(grid, placed((0.0, 0.0, heading), able.com[None])[0], heading)
    place, heading = (floor.length, 0.0), goal.pose[2] - floor.bearing
    aim = poses_near(grid, able.com, place, heading, goal.position_tolerance, goal.heading_tolerance, track)
    return reaches(grid, free_poses(floor, bodies, grid), begin, aim, rules)


def _grid(spec: ScenarioSpec, floor: Floor, able: Pushing, bodies: Bodies, cell: float, parts: int) -> Grid:
    """A grid through the start with room to go around everything; beyond it nothing stands in the way."""
    every = np.concatenate([discs for alternatives in bodies for discs in alternatives])
    reach = float(np.max(np.linalg.norm(every[:, :2], axis=1) + every[:, 2]))
    places = np.array([place for _, place in floor.obstacles])
    sizes = np.array([[o.radius + np.max(np.linalg.norm(o.vertices, axis=1))] for o, _ in floor.obstacles])
    ends = np.array([[0.0, 0.0], [floor.length, 0.0]])
    room = reach + _BORDER
    low = np.minimum((places - sizes).min(axis=0), ends.min(axis=0)) - room
    high = np.maximum((places + sizes).max(axis=0), ends.max(axis=0)) + room
    heading = spec.start[2] - floor.bearing
    start = placed((0.0, 0.0, heading), able.com[None])[0]
    low = start - cell * np.ceil((start - low) / cell)
    rows, columns = np.ceil((high - low) / cell).astype(int) + 1
    # From zero, so that among the headings are some at which one robot alone pushes exactly along or across.
    return Grid(cell, parts, low, (int(rows), int(columns)), 0.0, 2.0 * math.pi / HEADINGS)
