"""Whether there is any way for a team from start to goal between standing obstacles.

A flood over poses (x, y, heading) of the object, in a frame along the straight line: the team turns at will, and moves
only in directions in which it can push at its heading (on a floor with friction the object's centre of mass goes where
the pushes point). The bodies are discs inside the true ones, smaller still by what the grid could get wrong, and robots
may be anywhere along their faces, so that a way is found wherever there is one; some scenarios without any are let
through. A coarser flood with discs around the bodies goes first: it is much faster and finds a way in most scenarios.
"""

from __future__ import annotations

import functools
import math
from collections.abc import Sequence
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from jaxlocomanip.build import CONTACT_MARGIN, face_index, inward_normals, robot_rectangles
from jaxlocomanip.footprint import covering_discs, placed, polygon_gap
from jaxlocomanip.obstacles import moves
from jaxlocomanip.sampling.layout import push_cone
from jaxlocomanip.specification import ObstacleSpec, Point, ScenarioSpec

Floats = NDArray[np.floating[Any]]
Bits = NDArray[np.uint32]
Bodies = list[list[Floats]]
"""of each body the places where it may be, each as discs [n, 3] of centre and radius, m, in the object's frame"""

HEADINGS = 32
"""bins of the heading, a bit each"""
COARSE, FINE = 0.125, 0.05
"""m, spacing of the floods"""
_TURN = 2.0 * math.pi / HEADINGS
_BORDER = 0.3
"""m of room beyond the widest detour that a layout can call for"""
_STEPS = [(i, j) for i in (-1, 0, 1) for j in (-1, 0, 1) if (i, j) != (0, 0)]


class _Grid(NamedTuple):
    cell: float
    """m"""
    origin: Floats
    """[2] m, position of cell (0, 0), in the frame of the line"""
    shape: tuple[int, int]


class _Way(NamedTuple):
    """What both floods are about, in the frame at the start whose x axis leads to the goal."""

    spec: ScenarioSpec
    bearing: float
    length: float
    obstacles: list[tuple[ObstacleSpec, Floats]]
    """standing ones, with their places"""


def blocked(spec: ScenarioSpec) -> bool:
    """Whether no path of poses leads from the start to the goal of a scenario."""
    standing = [obstacle for obstacle in spec.obstacles if not moves(obstacle)]
    ahead = [goal - start for goal, start in zip(spec.goal.pose[:2], spec.start[:2], strict=True)]
    bearing = math.atan2(ahead[1], ahead[0])
    places = _in_frame([obstacle.position for obstacle in standing], spec.start, bearing)
    way = _Way(spec, bearing, math.hypot(*ahead), list(zip(standing, places, strict=True)))
    if not standing or _passable(way, _outer_discs(spec), COARSE, slack=0.0):
        return False
    return not _passable(way, _inner_discs(spec), FINE, slack=math.pi / 8.0 + 0.5 * _TURN)


def _in_frame(points: Sequence[Sequence[float]], start: Sequence[float], bearing: float) -> Floats:
    """Points [n, 2] in the frame of the way."""
    moved = np.array(points).reshape(-1, 2) - np.array(start[:2])
    return placed((0.0, 0.0, -bearing), moved)


def offset_limits(spec: ScenarioSpec) -> Floats:
    """[N_r] m, largest contact offsets."""
    polygon = np.array(spec.object.footprint)
    lengths = np.linalg.norm(np.roll(polygon, -1, axis=0) - polygon, axis=1)
    return np.maximum(lengths[[face_index(robot.face) for robot in spec.robots]] / 2.0 - CONTACT_MARGIN, 0.0)


def _inner_discs(spec: ScenarioSpec) -> Bodies:
    """Discs inside the bodies, each smaller by what the fine grid could get wrong."""
    polygon = np.array(spec.object.footprint)
    middle = polygon.mean(axis=0)
    bodies = [[np.array([(*middle, -float(polygon_gap(middle[None], polygon)))])]]
    limits = offset_limits(spec)
    ways = [_axes(spec, part * limits) for part in (0.0, -0.5, 0.5, -1.0, 1.0)]
    for robot in range(len(spec.robots)):
        alternatives = []
        for rear, front, radius in (way[robot] for way in ways):
            inset = radius / math.dist(rear, front)
            alternatives.append(np.array([(*(rear + t * (front - rear)), radius) for t in (inset, 0.5, 1.0 - inset)]))
        bodies.append(alternatives)
    for discs in (discs for alternatives in bodies for discs in alternatives):
        # Half a diagonal of a cell, once for the object's position and once for the disc's, and half a bin of heading
        # at the disc's distance.
        discs[:, 2] -= FINE * math.sqrt(2.0) + 0.5 * _TURN * np.linalg.norm(discs[:, :2], axis=1)
    return bodies


def _outer_discs(spec: ScenarioSpec) -> Bodies:
    """Discs that cover the bodies, at the contact offsets of the start."""
    centers, radii = covering_discs(np.array(spec.object.footprint))
    bodies = [[np.concatenate([centers, radii[:, None]], axis=1)]]
    for rear, front, radius in _axes(spec, [robot.offset for robot in spec.robots]):
        around = math.hypot(math.dist(rear, front) / 4.0, radius)
        bodies.append([np.array([(*(rear + t * (front - rear)), around) for t in (0.25, 0.75)])])
    return bodies


def _axes(spec: ScenarioSpec, offsets: Sequence[float]) -> list[tuple[Floats, Floats, float]]:
    """Middle of the rear and of the front edge of each robot's rectangle, and half its width, m."""
    rectangles = robot_rectangles(spec, (0.0, 0.0, 0.0), offsets)
    return [((c[0] + c[3]) / 2.0, (c[1] + c[2]) / 2.0, math.dist(c[0], c[3]) / 2.0) for c in rectangles]


def _passable(way: _Way, bodies: Bodies, cell: float, slack: float) -> bool:
    """Whether the bodies get from start to goal."""
    spec = way.spec
    every = np.concatenate([discs for alternatives in bodies for discs in alternatives])
    levers = np.linalg.norm(every[:, :2], axis=1)
    grid = _grid(way, float(np.max(levers + every[:, 2])), cell)
    pad = math.ceil(float(np.max(levers)) / cell) + 1
    free = _free(_field(grid, pad, way), bodies, grid, pad)
    begin = _near(grid, 0.0, 0.0, spec.start[2] - way.bearing, 0.0)
    aim = _near(
        grid, way.length, spec.goal.position_tolerance, spec.goal.pose[2] - way.bearing, spec.goal.heading_tolerance
    )
    return _flood(free, begin, aim, _allowed(spec, slack))


def _grid(way: _Way, reach: float, cell: float) -> _Grid:
    """A grid with room to go around everything; beyond it nothing stands in the way."""
    places = np.array([place for _, place in way.obstacles])
    sizes = np.array([[o.radius + np.max(np.linalg.norm(o.vertices, axis=1))] for o, _ in way.obstacles])
    ends = np.array([[0.0, 0.0], [way.length, 0.0]])
    room = reach + _BORDER
    low = np.minimum((places - sizes).min(axis=0), ends.min(axis=0)) - room
    high = np.maximum((places + sizes).max(axis=0), ends.max(axis=0)) + room
    rows, columns = np.ceil((high - low) / cell).astype(int) + 1
    return _Grid(cell, low, (int(rows), int(columns)))


def _field(grid: _Grid, pad: int, way: _Way) -> Floats:
    """Signed distance, m, to the nearest obstacle, on the grid with `pad` more cells on each side."""
    counts = [n + 2 * pad for n in grid.shape]
    x, y = ((grid.origin[i] + grid.cell * (np.arange(counts[i]) - pad)).astype(np.float32) for i in range(2))
    nearest = np.full(counts, np.inf, np.float32)
    for obstacle, place in way.obstacles:
        dx, dy = x[:, None] - np.float32(place[0]), y[None, :] - np.float32(place[1])
        if obstacle.shape == "circle":
            distance = np.sqrt(dx * dx + dy * dy) - np.float32(obstacle.radius)
        elif obstacle.size is not None:
            distance = _box_distance(dx, dy, obstacle.yaw - way.bearing, obstacle.size)
        else:
            corners = placed((0.0, 0.0, -way.bearing), np.array(obstacle.vertices))
            points = np.stack(np.broadcast_arrays(dx, dy), axis=-1)[..., None, :]
            distance = polygon_gap(points, np.broadcast_to(corners, (*counts, *corners.shape)))
        nearest = np.minimum(nearest, distance)
    return nearest


def _box_distance(dx: Floats, dy: Floats, yaw: float, size: tuple[float, float]) -> Floats:
    c, s = np.float32(math.cos(yaw)), np.float32(math.sin(yaw))
    ahead = np.abs(c * dx + s * dy) - np.float32(size[0] / 2.0)
    aside = np.abs(c * dy - s * dx) - np.float32(size[1] / 2.0)
    inside = np.minimum(np.maximum(ahead, aside), 0.0)
    ahead, aside = np.maximum(ahead, 0.0), np.maximum(aside, 0.0)
    return np.sqrt(ahead * ahead + aside * aside) + inside


def _free(field: Floats, bodies: Bodies, grid: _Grid, pad: int) -> Bits:
    """Cells whose bit k is set where heading k keeps every body, in one of its places, clear of the obstacles."""
    clear = np.ones((HEADINGS, *grid.shape), bool)
    for alternatives in bodies:
        some = np.zeros_like(clear)
        for discs in alternatives:
            some |= _clear(field, discs, grid, pad)
        clear &= some
    # Byte b of a cell's word holds the headings 8 b to 8 b + 7.
    packed = np.packbits(clear, axis=0, bitorder="little").astype(np.uint32)
    return packed[0] | packed[1] << 8 | packed[2] << 16 | packed[3] << 24


def _clear(field: Floats, discs: Floats, grid: _Grid, pad: int) -> NDArray[np.bool_]:
    """[HEADINGS, rows, columns] whether all discs [n, 3] are clear of the obstacles."""
    rows, columns = grid.shape
    clear = np.ones((HEADINGS, rows, columns), bool)
    headings = _TURN * np.arange(HEADINGS)
    c, s = np.cos(headings), np.sin(headings)
    for x, y, radius in discs:
        room = field > np.float32(radius)
        if math.hypot(x, y) < 0.5 * grid.cell:
            clear &= room[pad : pad + rows, pad : pad + columns]
            continue
        first = pad + np.rint((c * x - s * y) / grid.cell).astype(int)
        second = pad + np.rint((s * x + c * y) / grid.cell).astype(int)
        for k, i, j in zip(range(HEADINGS), first.tolist(), second.tolist(), strict=True):
            clear[k] &= room[i : i + rows, j : j + columns]
    return clear


def _near(grid: _Grid, x: float, radius: float, heading: float, turn: float) -> Bits:
    """Cells and headings that stand for the poses about (x, 0, heading), within a radius and a turn."""
    dx, dy = (grid.origin[i] + grid.cell * np.arange(grid.shape[i]) - (x, 0.0)[i] for i in range(2))
    inside = np.hypot(dx[:, None], dy[None, :]) <= radius + grid.cell
    bits = 0
    for k in range(HEADINGS):
        if abs(math.remainder(k * _TURN - heading, 2.0 * math.pi)) <= turn + _TURN:
            bits |= 1 << k
    return np.where(inside, np.uint32(bits), np.uint32(0))


Step = tuple[tuple[int, int], np.uint32]
"""cells along and across, and the headings at which the team can push that way"""


def _allowed(spec: ScenarioSpec, slack: float) -> tuple[Step, ...]:
    """The steps of the flood, each with the headings at which the team can push that way, give or take a slack, rad."""
    faces = tuple(face_index(robot.face) for robot in spec.robots)
    return _allowed_steps(spec.object.footprint, faces, slack)


@functools.lru_cache(maxsize=256)
def _allowed_steps(footprint: tuple[Point, ...], faces: tuple[int, ...], slack: float) -> tuple[Step, ...]:
    normals = inward_normals(np.array(footprint))[list(faces)]
    low, width = push_cone([math.atan2(y, x) for x, y in normals])
    middle, half = low + 0.5 * width, 0.5 * width + slack
    steps: list[Step] = []
    for i, j in _STEPS:
        bits = 0
        for k in range(HEADINGS):
            if abs(math.remainder(math.atan2(j, i) - k * _TURN - middle, 2.0 * math.pi)) <= half + 1e-6:
                bits |= 1 << k
        if bits:
            steps.append(((i, j), np.uint32(bits)))
    return tuple(steps)


def _flood(free: Bits, begin: Bits, aim: Bits, steps: Sequence[Step]) -> bool:
    """Whether the aim can be reached from the beginning: rays in all directions at once, until nothing changes."""
    rays = [_ray(free, step, bits) for step, bits in steps]
    one, last = np.uint32(1), np.uint32(HEADINGS - 1)
    state = begin & free
    before = 0
    while True:
        for _ in range(2):
            state |= ((state << one) | (state >> last) | (state >> one) | (state << last)) & free
        for ray in rays:
            for target, source, through in ray:
                state[target] |= state[source] & through
        if (state & aim).any():
            return True
        # Bits are only ever added, so the sum tells whether any was.
        total = int(state.sum(dtype=np.uint64))
        if total == before:
            return False
        before = total


_Slices = tuple[slice, slice]


def _ray(free: Bits, step: tuple[int, int], bits: np.uint32) -> list[tuple[_Slices, _Slices, Bits]]:
    """Shifts by 1, 2, 4, ... steps and what they may pass through: together they follow a ray to its end."""
    through = free & bits
    shifts = []
    length = 1
    while length < max(free.shape):
        pairs = [_shift(d * length, n) for d, n in zip(step, free.shape, strict=True)]
        target, source = (pairs[0][0], pairs[1][0]), (pairs[0][1], pairs[1][1])
        if free[target].size == 0:
            break
        shifts.append((target, source, through[target].copy()))
        longer = np.zeros_like(through)
        longer[target] = through[target] & through[source]
        through, length = longer, 2 * length
    return shifts


def _shift(by: int, count: int) -> tuple[slice, slice]:
    """Slices (target, source) of a shift along an axis of `count` cells."""
    if by == 0:
        return slice(None), slice(None)
    kept = max(count - abs(by), 0)
    far, near = slice(count - kept, count), slice(0, kept)
    return (far, near) if by > 0 else (near, far)
