"""Object and robots as discs about the object's centre of mass: inside the bodies, or around them."""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import Any

import numpy as np
from numpy.typing import NDArray

from jaxlocomanip.build import robot_rectangles
from jaxlocomanip.footprint import covering_discs, polygon_gap
from jaxlocomanip.sampling.pushing import offset_limits
from jaxlocomanip.specification import ScenarioSpec

Floats = NDArray[np.floating[Any]]
Bodies = list[list[Floats]]
"""of each body the places where it may be, each as discs [n, 3] of centre and radius, m; a point has radius 0"""


def inner_discs(spec: ScenarioSpec, com: Floats, places: int = 5) -> Bodies:
    """Discs inside the bodies, with the robots in any of so many parts of their ranges of contact offsets."""
    polygon = np.array(spec.object.footprint)
    middle = polygon.mean(axis=0)
    parts = np.array([1.0, 2.0 / 3.0])[:, None, None]
    centers = np.concatenate([(middle + parts * (polygon - middle)).reshape(-1, 2), middle[None]])
    radii = np.maximum(-polygon_gap(centers[:, None], np.broadcast_to(polygon, (len(centers), *polygon.shape))), 0.0)
    bodies = [[_discs(centers - com, radii)]]
    # What a robot covers wherever in a part of its range it is: its rectangle, narrower by that part.
    narrower = offset_limits(spec) / places
    ways = [_axes(spec, part * narrower) for part in range(1 - places, places, 2)]
    for robot, less in enumerate(narrower):
        bodies.append([_inside(*way[robot], less, com) for way in ways])
    return bodies


def _inside(rear: Floats, front: Floats, half_width: float, less: float, com: Floats) -> Floats:
    """Discs in a rectangle about an axis, narrower by `less` on both sides, and its rear corners."""
    radius = max(half_width - less, 0.0)
    length = math.dist(rear, front)
    inset = min(radius / length, 0.5)
    axis = front - rear
    across = radius / length * np.array([-axis[1], axis[0]])
    middles = np.array([rear + t * axis for t in (inset, 0.5, 1.0 - inset)])
    # The front ones are beside the object, where nothing gets to that touches neither.
    corners = np.array([rear + sign * across for sign in (-1.0, 1.0)])
    radii = np.array([min(radius, 0.5 * length)] * 3 + [0.0] * 2)
    return _discs(np.concatenate([middles, corners]) - com, radii)


def outer_discs(spec: ScenarioSpec, com: Floats) -> Bodies:
    """Discs that cover the bodies, at the contact offsets of the start."""
    centers, radii = covering_discs(np.array(spec.object.footprint))
    bodies = [[_discs(centers - com, radii)]]
    for rear, front, radius in _axes(spec, [robot.offset for robot in spec.robots]):
        around = math.hypot(math.dist(rear, front) / 4.0, radius)
        middles = np.array([rear + t * (front - rear) for t in (0.25, 0.75)])
        bodies.append([_discs(middles - com, np.full(2, around))])
    return bodies


def _discs(centers: Floats, radii: Floats) -> Floats:
    return np.concatenate([centers, radii[:, None]], axis=1)


def _axes(spec: ScenarioSpec, offsets: Sequence[float] | Floats) -> list[tuple[Floats, Floats, float]]:
    """Middle of the rear and of the front edge of each robot's rectangle, and half its width, m."""
    rectangles = robot_rectangles(spec, (0.0, 0.0, 0.0), list(offsets))
    return [((c[0] + c[3]) / 2.0, (c[1] + c[2]) / 2.0, math.dist(c[0], c[3]) / 2.0) for c in rectangles]
