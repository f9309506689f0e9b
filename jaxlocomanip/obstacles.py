"""Obstacles of a scenario on the host: their arrays, and where they are at a time."""

from __future__ import annotations

import math
from typing import Any

import numpy as np
from numpy.typing import NDArray

from jaxlocomanip.numerics import host_array
from jaxlocomanip.obstacle_spec import ObstacleSpec
from jaxlocomanip.padding import pad_obstacles
from jaxlocomanip.scenario import Obstacles

Floats = NDArray[np.floating[Any]]


def obstacle_arrays(specs: tuple[ObstacleSpec, ...]) -> Obstacles:
    """Arrays of obstacles, with NumPy leaves; one absent obstacle where there are none."""

    def flags(values: list[bool]) -> Any:
        return np.array(values, dtype=bool)

    corners = max([4, *(len(o.vertices) for o in specs)])
    marks = max([1, *(len(o.motion.times) for o in specs if o.motion)])
    count = len(specs)
    vertices, times, points = (
        np.zeros((count, corners, 2)),
        np.zeros((count, marks)),
        np.zeros((count, marks, 2)),
    )
    amplitude, period = np.zeros((count, 2)), np.ones(count)
    for i, o in enumerate(specs):
        vertices[i] = np.array([*o.vertices, *[o.vertices[-1]] * (corners - len(o.vertices))])
        if o.motion and o.motion.kind == "sine":
            amplitude[i], period[i] = o.motion.amplitude, o.motion.period
        elif o.motion:
            pad = marks - len(o.motion.times)
            times[i] = np.array([*o.motion.times, *[o.motion.times[-1]] * pad])
            points[i] = np.array([*o.motion.points, *[o.motion.points[-1]] * pad]) - np.array(o.position)
    obstacles = Obstacles(
        vertices=host_array(vertices),
        radius=host_array([o.radius for o in specs]),
        position=host_array(np.array([o.position for o in specs]).reshape(count, 2)),
        velocity=host_array(np.array([o.velocity for o in specs]).reshape(count, 2)),
        amplitude=host_array(amplitude),
        period=host_array(period),
        times=host_array(times),
        waypoints=host_array(points),
        dynamic=flags([moves(o) for o in specs]),
        mask=flags([True] * count),
    )
    return pad_obstacles(obstacles, max(count, 1))


def moves(obstacle: ObstacleSpec) -> bool:
    """Whether an obstacle may move, and is tracked as such."""
    return bool(obstacle.motion) or obstacle.velocity != (0.0, 0.0)


def position_at(obstacle: ObstacleSpec, time: float) -> tuple[float, float]:
    """m, where an obstacle is at a time in s."""
    motion = obstacle.motion
    place = [p + v * time for p, v in zip(obstacle.position, obstacle.velocity, strict=True)]
    if motion and motion.kind == "sine":
        phase = math.sin(2.0 * math.pi * time / motion.period)
        place = [p + a * phase for p, a in zip(place, motion.amplitude, strict=True)]
    elif motion:
        way = [np.interp(time, motion.times, [point[i] for point in motion.points]) for i in range(2)]
        place = [p + float(w) - q for p, w, q in zip(place, way, obstacle.position, strict=True)]
    return place[0], place[1]


def corners_at(obstacle: ObstacleSpec, time: float) -> Floats:
    """[V, 2] m, corners of an obstacle's polygon at a time in s."""
    return np.array(obstacle.vertices) + np.array(position_at(obstacle, time))
