"""Whether there is any way for a team from start to goal between standing obstacles.

A flood over poses (centre of mass, heading) of the object: the team moves the object in directions in which it can push
at its heading, and turns it only as far as it moves it (`pushing`). Robots may be anywhere along their faces at each
pose, even where an obstacle stands between two such places: so some ways that are found are none for robots that have
to walk there.

A scenario is good where a flood finds a way for discs *around* the bodies. A coarse flood with large discs goes first:
it is much faster and finds a way in most scenarios. Where the fine one, with a few centimetres of room, finds none
either, floods with discs *inside* the bodies, smaller still by what the grid could get wrong, say why: they find a way
wherever there is one, and where they find none at the start or the goal (`enclosure`) or between them, there is none.
What is left is too narrow for a planner that measures poses.
"""

from __future__ import annotations

import math
from typing import Any

import numpy as np
from numpy.typing import NDArray

from jaxlocomanip.footprint import placed
from jaxlocomanip.sampling.bodies import Bodies, close_discs, inner_discs, outer_discs
from jaxlocomanip.sampling.clearance import TRACK, Floor, floor_of, free_poses, pose_at, poses_near, shrunk
from jaxlocomanip.sampling.enclosure import enclosed_goal, enclosed_start
from jaxlocomanip.sampling.flood import HEADINGS, Bits, Grid, lenient_rules, reaches, strict_rules
from jaxlocomanip.sampling.pushing import Pushing, pushing
from jaxlocomanip.specification import ScenarioSpec

Floats = NDArray[np.floating[Any]]

COARSE, FINE = 0.125, 0.05
"""m, spacing of the floods"""
_PARTS = 3
"""of a cell to which bodies are placed"""
_BORDER = 0.3
"""m of room beyond the widest detour that a layout can call for"""


def obstruction(spec: ScenarioSpec) -> str | None:
    """Why no path of poses that the team can push leads from the start to the goal of a scenario.

    `capacity` where it would take stronger robots, `start` or `goal` where it is enclosed there, else `blocked`, or
    `narrow` where there may be one without room at its sides; None where there is a way.
    """
    floor = floor_of(spec)
    if not floor.obstacles:
        return None
    able = pushing(spec)
    if _way_around(spec, floor, able) or _way_with_room(spec, able):
        return None
    if _way_with_room(spec, able._replace(friction=0.0)):
        return "capacity"
    if enclosed_start(spec, floor, able):
        return "start"
    if enclosed_goal(spec, floor, able):
        return "goal"
    return "narrow" if way_within(spec, floor, able) else "blocked"


def _way_around(spec: ScenarioSpec, floor: Floor, able: Pushing) -> bool:
    """Whether there is a way for large discs around the bodies."""
    bodies = outer_discs(spec, able.com)
    grid = _grid(spec, floor, able, bodies, COARSE, _PARTS)
    begin, aim = _ends(spec, floor, able, grid, 0.0)
    return reaches(grid, free_poses(floor, bodies, grid), begin, aim, strict_rules(able, grid, 1))


def _way_with_room(spec: ScenarioSpec, able: Pushing) -> bool:
    """Whether there is a way for the bodies and a few centimetres around them."""
    bodies = close_discs(spec, able.com)
    # In this frame the start is on the grid, and some steps are exactly along the object's sides.
    floor = floor_of(spec, spec.start[2])
    grid = _grid(spec, floor, able, bodies, FINE, _PARTS)
    # A goal whose tolerances fit between the poses of the grid is the nearest of them.
    between = spec.goal.position_tolerance < TRACK * FINE or spec.goal.heading_tolerance < TRACK * grid.bin
    begin, aim = _ends(spec, floor, able, grid, TRACK if between else 0.0)
    # At the start itself nothing overlaps, however little room there is.
    return reaches(grid, free_poses(floor, bodies, grid) | begin, begin, aim, strict_rules(able, grid, 2))


def way_within(spec: ScenarioSpec, floor: Floor, able: Pushing) -> bool:
    """Whether there is a way for what is surely within the bodies; the floor has obstacles."""
    bodies = inner_discs(spec, able.com)
    grid = _grid(spec, floor, able, bodies, FINE, _PARTS)
    begin, aim = _ends(spec, floor, able, grid, TRACK)
    return reaches(grid, free_poses(floor, shrunk(bodies, grid), grid), begin, aim, lenient_rules(able, grid, 2))


def _ends(spec: ScenarioSpec, floor: Floor, able: Pushing, grid: Grid, track: float) -> tuple[Bits, Bits]:
    """The pose of the start, and those that count as the goal."""
    goal = spec.goal
    heading = spec.start[2] - floor.bearing
    begin = pose_at(grid, placed((0.0, 0.0, heading), able.com[None])[0], heading)
    heading, tolerances = goal.pose[2] - floor.bearing, (goal.position_tolerance, goal.heading_tolerance)
    return begin, poses_near(grid, able.com, floor.goal, heading, *tolerances, track)


def _grid(spec: ScenarioSpec, floor: Floor, able: Pushing, bodies: Bodies, cell: float, parts: int) -> Grid:
    """A grid through the start with room to go around everything; beyond it nothing stands in the way."""
    every = np.concatenate([discs for alternatives in bodies for discs in alternatives])
    reach = float(np.max(np.linalg.norm(every[:, :2], axis=1) + every[:, 2]))
    places = np.array([place for _, place in floor.obstacles])
    sizes = np.array([[o.radius + np.max(np.linalg.norm(o.vertices, axis=1))] for o, _ in floor.obstacles])
    ends = np.array([np.zeros(2), floor.goal])
    room = reach + _BORDER
    low = np.minimum((places - sizes).min(axis=0), ends.min(axis=0)) - room
    high = np.maximum((places + sizes).max(axis=0), ends.max(axis=0)) + room
    heading = spec.start[2] - floor.bearing
    start = placed((0.0, 0.0, heading), able.com[None])[0]
    low = start - cell * np.ceil((start - low) / cell)
    rows, columns = np.ceil((high - low) / cell).astype(int) + 1
    # From zero, so that among the headings are some at which one robot alone pushes exactly along or across.
    return Grid(cell, parts, low, (int(rows), int(columns)), 0.0, 2.0 * math.pi / HEADINGS)
