"""Object and robots as discs about the object's centre of mass: inside the bodies, or around them.

Discs inside show that there is no way, discs around that there is one.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import Any

import numpy as np
from numpy.typing import NDArray

from jaxlocomanip.build_team import robot_rectangles
from jaxlocomanip.footprint import covering_discs, polygon_gap
from jaxlocomanip.sampling.pushing import offset_limits
from jaxlocomanip.specification import ScenarioSpec

Floats = NDArray[np.floating[Any]]
Bodies = list[list[Floats]]
"""of each body the places where it may be, each as discs [n, 3] of centre and radius, m; a point has radius 0"""

ROOM = 0.03
"""m by which close discs around a body reach beyond it at most, and by a third of it at least

Less room is no use to a planner that measures poses: noise of 5 mm and 0.01 rad, three standard deviations of it, moves
the far end of a robot, 0.85 m away, by 3 cm.
"""


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


def close_discs(spec: ScenarioSpec, com: Floats, places: int = 5) -> Bodies:
    """Discs that cover the bodies closely (`ROOM`), with the robots at so many of their contact offsets."""
    bodies = [[_discs(*_cover(np.array(spec.object.footprint), com))]]
    limits = offset_limits(spec)
    parts = np.linspace(-1.0, 1.0, places)[:, None]
    ways = [robot_rectangles(spec, (0.0, 0.0, 0.0), offsets) for offsets in (parts * limits).tolist()]
    for robot in range(len(limits)):
        centers, radii = _cover(ways[0][robot], com)
        bodies.append([_discs(centers + way[robot, 0] - ways[0][robot, 0], radii) for way in ways])
    return bodies


def _cover(polygon: Floats, com: Floats) -> tuple[Floats, Floats]:
    """Discs along the outline of a convex polygon [V, 2], inside it, and what they leave of its middle.

    A disc of radius d + s with its centre at depth d reaches s beyond at most. Along the outline of the polygon inset
    by d such discs cover the edges if they are close enough, and the corners if d is small enough.
    """
    most = ROOM * 2.0 / 3.0
    low, high = 0.0, float(np.ptp(polygon, axis=0).min()) / 2.0
    ring = polygon
    for _ in range(20):
        depth = 0.5 * (low + high)
        corners = _inset(polygon, depth)
        if len(corners) and polygon_gap(polygon[:, None], corners[None]).max() <= depth + most:
            low, ring = depth, corners
        else:
            high = depth
    spacing = 2.0 * math.sqrt(most * (2.0 * low + most))
    centers = []
    for a, b in zip(ring, np.roll(ring, -1, axis=0), strict=True):
        count = math.ceil(math.dist(a, b) / spacing)
        centers += [a + (b - a) * k / count for k in range(count)]
    middle = polygon.mean(axis=0)
    inside = -float(polygon_gap(middle[None], polygon))
    radii = np.append(np.full(len(centers), low + ROOM), inside + ROOM)
    return np.array([*centers, middle]) - com, radii


def _inset(polygon: Floats, depth: float) -> Floats:
    """[W, 2] corners of what of a convex polygon is at some depth, m, below all of its edges; counter-clockwise."""
    edges = np.roll(polygon, -1, axis=0) - polygon
    normals = np.stack([-edges[:, 1], edges[:, 0]], axis=1) / np.linalg.norm(edges, axis=1)[:, None]
    levels = np.sum(normals * polygon, axis=1) + depth
    i, j = np.triu_indices(len(polygon), 1)
    across = normals[i, 0] * normals[j, 1] - normals[i, 1] * normals[j, 0]
    i, j, across = (each[np.abs(across) > 1e-9] for each in (i, j, across))
    x = (levels[i] * normals[j, 1] - levels[j] * normals[i, 1]) / across
    y = (levels[j] * normals[i, 0] - levels[i] * normals[j, 0]) / across
    points = np.stack([x, y], axis=1)
    points = points[(points @ normals.T >= levels - 1e-9).all(axis=1)]
    if not len(points):
        return points
    off = points - points.mean(axis=0)
    return points[np.argsort(np.arctan2(off[:, 1], off[:, 0]))]


def _discs(centers: Floats, radii: Floats) -> Floats:
    return np.concatenate([centers, radii[:, None]], axis=1)


def _axes(spec: ScenarioSpec, offsets: Sequence[float] | Floats) -> list[tuple[Floats, Floats, float]]:
    """Middle of the rear and of the front edge of each robot's rectangle, and half its width, m."""
    rectangles = robot_rectangles(spec, (0.0, 0.0, 0.0), list(offsets))
    return [((c[0] + c[3]) / 2.0, (c[1] + c[2]) / 2.0, math.dist(c[0], c[3]) / 2.0) for c in rectangles]
