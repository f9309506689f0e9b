"""Where on a grid of positions, and at which headings, bodies made of discs are clear of standing obstacles."""

from __future__ import annotations

import math
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from jaxlocomanip.footprint import placed
from jaxlocomanip.obstacle_spec import ObstacleSpec
from jaxlocomanip.obstacles import moves
from jaxlocomanip.sampling.bodies import Bodies
from jaxlocomanip.sampling.flood import HEADINGS, Bits, Grid
from jaxlocomanip.specification import ScenarioSpec

Floats = NDArray[np.floating[Any]]

TRACK = 0.75
"""cells, or bins of heading, by which a pose is off its place on the grid at most: half a diagonal, and a little"""


class Floor(NamedTuple):
    """Goal and standing obstacles in a frame at the start."""

    bearing: float
    """rad, of its x axis in the world"""
    goal: Floats
    """[2] m"""
    obstacles: list[tuple[ObstacleSpec, Floats]]
    """each with its place [2] m"""


def floor_of(spec: ScenarioSpec, bearing: float | None = None) -> Floor:
    """The goal and the standing obstacles of a scenario; the x axis leads to the goal unless it has another bearing."""
    standing = [obstacle for obstacle in spec.obstacles if not moves(obstacle)]
    points = np.array([spec.goal.pose[:2], *[o.position for o in standing]]) - np.array(spec.start[:2])
    if bearing is None:
        bearing = math.atan2(points[0, 1], points[0, 0])
    goal, *places = placed((0.0, 0.0, -bearing), points)
    return Floor(bearing, goal, list(zip(standing, places, strict=True)))


def shrunk(bodies: Bodies, grid: Grid) -> Bodies:
    """Bodies smaller by what a grid could get wrong about them: position, heading, and the rounding of the discs."""
    made = []
    for alternatives in bodies:
        made.append([discs.copy() for discs in alternatives])
        for discs in made[-1]:
            levers = np.linalg.norm(discs[:, :2], axis=1)
            rounding = math.sqrt(0.5) / grid.parts
            discs[:, 2] -= grid.cell * (TRACK + rounding) + 0.5 * grid.bin * levers
    return made


def free_poses(floor: Floor, bodies: Bodies, grid: Grid) -> Bits:
    """Cells whose bit k is set where heading k keeps every body, in one of its places, clear of the obstacles."""
    every = np.concatenate([discs for alternatives in bodies for discs in alternatives])
    pad = math.ceil(float(np.max(np.linalg.norm(every[:, :2], axis=1))) / grid.cell) + 1
    field = _field(floor, grid, pad)
    clear = np.ones((HEADINGS, grid.shape[0] * field.shape[-1]), bool)
    for alternatives in bodies:
        some = _clear(field, alternatives[0], grid, pad)
        for discs in alternatives[1:]:
            some |= _clear(field, discs, grid, pad)
        clear &= some
    cells = clear.reshape(HEADINGS, grid.shape[0], -1)[..., : grid.shape[1]]
    # Byte b of a cell's word holds the headings 8 b to 8 b + 7.
    packed = np.packbits(cells, axis=0, bitorder="little")
    return np.ascontiguousarray(np.moveaxis(packed, 0, -1)).view("<u8")[..., 0]


def _field(floor: Floor, grid: Grid, pad: int) -> Floats:
    """[parts, parts, rows, columns] m, signed distance to the nearest obstacle at each part of each cell.

    `pad` cells more than the grid on each side, and one more row, so that no run of cells goes past the end.
    """
    axes = []
    for low, count in zip(grid.origin, (grid.shape[0] + 1, grid.shape[1]), strict=True):
        steps = np.arange((count + 2 * pad) * grid.parts) / grid.parts - pad
        axes.append((low + grid.cell * steps).astype(np.float32))
    nearest = np.full([len(axis) for axis in axes], np.inf, np.float32)
    for obstacle, place in floor.obstacles:
        dx, dy = axes[0][:, None] - np.float32(place[0]), axes[1][None, :] - np.float32(place[1])
        if obstacle.shape == "circle":
            distance = np.sqrt(dx * dx + dy * dy) - np.float32(obstacle.radius)
        elif obstacle.size is not None:
            distance = _box_distance(dx, dy, obstacle.yaw - floor.bearing, obstacle.size)
        else:
            corners = placed((0.0, 0.0, -floor.bearing), np.array(obstacle.vertices))
            distance = _polygon_distance(dx, dy, corners.astype(np.float32))
        np.minimum(nearest, distance, out=nearest)
    rows, columns = (len(axis) // grid.parts for axis in axes)
    parts = nearest.reshape(rows, grid.parts, columns, grid.parts).transpose(1, 3, 0, 2)
    return np.ascontiguousarray(parts)


def _box_distance(dx: Floats, dy: Floats, yaw: float, size: tuple[float, float]) -> Floats:
    c, s = np.float32(math.cos(yaw)), np.float32(math.sin(yaw))
    ahead = np.abs(c * dx + s * dy) - np.float32(size[0] / 2.0)
    aside = np.abs(c * dy - s * dx) - np.float32(size[1] / 2.0)
    inside = np.minimum(np.maximum(ahead, aside), 0.0)
    ahead, aside = np.maximum(ahead, 0.0), np.maximum(aside, 0.0)
    return np.sqrt(ahead * ahead + aside * aside) + inside


def _polygon_distance(dx: Floats, dy: Floats, corners: Floats) -> Floats:
    """Signed distance to a convex polygon with counter-clockwise corners [V, 2]."""
    deepest = np.full(np.broadcast_shapes(dx.shape, dy.shape), -np.inf, np.float32)
    squared = np.full_like(deepest, np.inf)
    for (ax, ay), (bx, by) in zip(corners, np.roll(corners, -1, axis=0), strict=True):
        ex, ey = bx - ax, by - ay
        length = math.hypot(ex, ey)
        px, py = dx - ax, dy - ay
        np.maximum(deepest, (px * ey - py * ex) / np.float32(length), out=deepest)
        along = np.clip((px * ex + py * ey) / np.float32(length * length), 0.0, 1.0)
        np.minimum(squared, (px - along * ex) ** 2 + (py - along * ey) ** 2, out=squared)
    return np.where(deepest < 0.0, deepest, np.sqrt(squared))


def _clear(field: Floats, discs: Floats, grid: Grid, pad: int) -> NDArray[np.bool_]:
    """[HEADINGS, rows x padded columns] whether all discs [n, 3] are clear of the obstacles.

    The rows are as long as those of the field, so that a heading's disc is at one run of its cells.
    """
    width = field.shape[-1]
    count = grid.shape[0] * width
    clear = np.ones((HEADINGS, count), bool)
    c, s = np.cos(grid.headings), np.sin(grid.headings)
    for x, y, radius in discs:
        room = (field > np.float32(radius)).reshape(grid.parts * grid.parts, -1)
        first, p = np.divmod(np.rint((c * x - s * y) / grid.cell * grid.parts).astype(int), grid.parts)
        second, q = np.divmod(np.rint((s * x + c * y) / grid.cell * grid.parts).astype(int), grid.parts)
        runs = (first + pad) * width + second + pad
        for k, (part, run) in enumerate(zip((p * grid.parts + q).tolist(), runs.tolist(), strict=True)):
            clear[k] &= room[part, run : run + count]
    return clear


def pose_at(grid: Grid, place: Floats, heading: float) -> Bits:
    """The one cell and heading of a pose that is on the grid."""
    bits = np.zeros(grid.shape, np.uint64)
    i, j = np.rint((place - grid.origin) / grid.cell).astype(int)
    k = round((heading - grid.first) / grid.bin) % HEADINGS
    bits[i, j] = np.uint64(1 << k)
    return bits


def poses_near(
    grid: Grid, com: Floats, place: Floats, heading: float, radius: float, turn: float, track: float
) -> Bits:
    """Cells and headings that stand for poses of the body point within a radius, m, and a turn, rad, of a pose.

    Args:
      grid: of poses of the centre of mass.
      com: [2] m, centre of mass in the object's frame.
      place: [2] m, of the body point.
      heading: rad.
      radius: m.
      turn: rad.
      track: cells, and bins of heading, by which a pose may be off its place on the grid.
    """
    bits = np.zeros(grid.shape, np.uint64)
    x, y = (grid.origin[i] + grid.cell * np.arange(grid.shape[i]) - place[i] for i in range(2))
    within = radius + track * (grid.cell + grid.bin * math.hypot(*com))
    turns = np.stack([*np.zeros((2, HEADINGS)), grid.headings], axis=1)
    ahead, aside = placed(turns, com[None])[:, 0].T
    for k, angle in enumerate(grid.headings.tolist()):
        if abs(math.remainder(angle - heading, 2.0 * math.pi)) <= turn + track * grid.bin:
            near = (x - ahead[k])[:, None] ** 2 + (y - aside[k])[None, :] ** 2 <= within**2
            bits |= np.where(near, np.uint64(1 << k), np.uint64(0))
    return bits
