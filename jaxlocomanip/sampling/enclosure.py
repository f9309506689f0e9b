"""Whether a team can leave its start, and come to its goal, at all.

Where an obstacle is within a hand's breadth of object or team, a flood like that of `passage` is repeated on a finer
grid around that place: its bodies are smaller than the true ones by 2 to 5 cm only. A team that pushes leaves
a start with an obstacle close ahead only if it can turn past it on the little way that it has.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import Any

import numpy as np
from numpy.typing import NDArray

from jaxlocomanip.build_team import robot_rectangles
from jaxlocomanip.footprint import padded, placed, polygon_gap
from jaxlocomanip.sampling.bodies import inner_discs
from jaxlocomanip.sampling.clearance import TRACK, Floor, free_poses, pose_at, poses_near, shrunk
from jaxlocomanip.sampling.flood import HEADINGS, Grid, backwards, lenient_rules, reaches
from jaxlocomanip.sampling.pushing import Pushing
from jaxlocomanip.specification import ScenarioSpec

Floats = NDArray[np.floating[Any]]

NEAR = 0.12
"""m, clearance below which it is worth a look"""
AWAY = 0.5
"""m, a team that gets this far is not enclosed"""
_CELL, _PARTS = 0.02, 3
_BIN = math.pi / HEADINGS
"""rad, of headings up to a quarter turn either way; a team that turns farther is not enclosed"""
_WIDEST = 0.3
"""m, position tolerance of a goal up to which it is worth a look"""


def enclosed_start(spec: ScenarioSpec, floor: Floor, able: Pushing) -> bool:
    """Whether standing obstacles keep the team from leaving its start."""
    if np.hypot(*floor.goal) < 2.0 * AWAY + spec.goal.position_tolerance:
        return False
    offsets = [robot.offset for robot in spec.robots]
    return _crowded(spec, floor, spec.start, offsets) and not _leaves(spec, floor, able, goal=False)


def enclosed_goal(spec: ScenarioSpec, floor: Floor, able: Pushing) -> bool:
    """Whether standing obstacles keep the team from coming to its goal, wherever it comes from."""
    tolerance = spec.goal.position_tolerance
    if tolerance > _WIDEST or np.hypot(*floor.goal) < 2.0 * (AWAY + tolerance):
        return False
    return _crowded(spec, floor, spec.goal.pose, [0.0] * len(spec.robots)) and not _leaves(spec, floor, able, goal=True)


def _crowded(spec: ScenarioSpec, floor: Floor, pose: Sequence[float], offsets: Sequence[float]) -> bool:
    """Whether a standing obstacle is close to the object or a robot at a pose."""
    bodies = padded([placed(pose, np.array(spec.object.footprint)), *robot_rectangles(spec, pose, offsets)])
    shapes = padded([np.array(o.vertices) + np.array(o.position) for o, _ in floor.obstacles])
    radii = np.array([o.radius for o, _ in floor.obstacles])
    return bool((polygon_gap(bodies[:, None], shapes[None], radii) < NEAR).any())


def _leaves(spec: ScenarioSpec, floor: Floor, able: Pushing, goal: bool) -> bool:
    """Whether a flood from the start, or backwards in time from the goal, gets away."""
    heading = (spec.goal.pose if goal else spec.start)[2] - floor.bearing
    place = floor.goal if goal else np.zeros(2)
    radius = AWAY + (spec.goal.position_tolerance if goal else 0.0)
    middle = place + placed((0.0, 0.0, heading), able.com[None])[0]
    half = math.ceil(radius / _CELL) + 2
    grid = Grid(_CELL, _PARTS, middle - half * _CELL, (2 * half + 1, 2 * half + 1), heading - math.pi / 2.0, _BIN)
    bodies = inner_discs(spec, able.com)
    reach = max(float(np.linalg.norm(discs[:, :2], axis=1).max()) for each in bodies for discs in each)
    free = free_poses(_around(floor, middle, math.sqrt(2.0) * half * _CELL + reach), shrunk(bodies, grid), grid)
    ticks = _CELL * np.arange(-half, half + 1)
    away = np.hypot(ticks[:, None], ticks[None, :]) >= radius
    ends = np.uint64(1 | 1 << (HEADINGS - 1))
    aim = np.where(away, ~np.uint64(0), ends)
    rules = lenient_rules(able, grid, 3)
    if not goal:
        return reaches(grid, free, pose_at(grid, middle, heading), aim, rules)
    tolerances = spec.goal.position_tolerance, spec.goal.heading_tolerance
    begin = poses_near(grid, able.com, floor.goal, heading, *tolerances, TRACK)
    return reaches(grid, free, begin, aim, backwards(rules), turned=True)


def _around(floor: Floor, middle: Floats, reach: float) -> Floor:
    """Only the obstacles within reach."""
    near = []
    for obstacle, place in floor.obstacles:
        size = obstacle.radius + float(np.linalg.norm(obstacle.vertices, axis=1).max())
        if math.dist(place, middle) < reach + size:
            near.append((obstacle, place))
    return floor._replace(obstacles=near)
