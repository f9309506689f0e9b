"""Triangle meshes of simple solids and outlines of rounded polygons."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import ArrayLike, NDArray

from jaxlocomanip.recording.palette import RGB

Floats = NDArray[np.floating[Any]]


class Mesh(NamedTuple):
    """Triangles with a normal and a colour at every vertex."""

    vertices: Floats
    """[n, 3] m"""
    normals: Floats
    """[n, 3] unit, outward"""
    triangles: NDArray[np.integer[Any]]
    """[m, 3] indices of vertices, counter-clockwise seen from outside"""
    colors: NDArray[np.uint8]
    """[n, 3]"""


def join(meshes: Sequence[Mesh]) -> Mesh:
    """One mesh of several."""
    counts = [0, *np.cumsum([len(m.vertices) for m in meshes])]
    return Mesh(
        np.concatenate([m.vertices for m in meshes]),
        np.concatenate([m.normals for m in meshes]),
        np.concatenate([m.triangles + first for m, first in zip(meshes, counts, strict=False)]),
        np.concatenate([m.colors for m in meshes]),
    )


def moved(mesh: Mesh, rotation: Floats, translation: ArrayLike) -> Mesh:
    """A mesh turned by a rotation matrix [3, 3] and then shifted by [3] m."""
    return mesh._replace(
        vertices=mesh.vertices @ rotation.T + np.asarray(translation), normals=mesh.normals @ rotation.T
    )


def painted(mesh: Mesh, color: RGB) -> Mesh:
    """A mesh all in one colour."""
    return mesh._replace(colors=paint(len(mesh.vertices), color))


def prism(outline: Floats, bottom: float, top: float, color: RGB) -> Mesh:
    """A convex polygon [V, 2] m, counter-clockwise, extruded from height `bottom` to `top`, m; flat faces."""
    ring = np.asarray(outline, dtype=float)
    count = len(ring)
    after = np.roll(ring, -1, axis=0)
    edges = after - ring
    sides = np.stack([edges[:, 1], -edges[:, 0], np.zeros(count)], axis=1)
    sides /= np.maximum(np.linalg.norm(sides, axis=1, keepdims=True), 1e-12)

    def at(points: Floats, height: float) -> Floats:
        return np.column_stack([points, np.full(len(points), height)])

    walls = np.stack([at(ring, bottom), at(after, bottom), at(after, top), at(ring, top)], axis=1).reshape(-1, 3)
    up = np.array([[0.0, 0.0, 1.0]])
    vertices = np.concatenate([walls, at(ring, top), at(ring, bottom)])
    normals = np.concatenate([np.repeat(sides, 4, axis=0), np.repeat(up, count, axis=0), np.repeat(-up, count, axis=0)])
    quads = (4 * np.arange(count)[:, None] + np.array([0, 1, 2, 0, 2, 3])).reshape(-1, 3)
    fan = np.stack([np.zeros(count - 2, int), np.arange(1, count - 1), np.arange(2, count)], axis=1)
    triangles = np.concatenate([quads, 4 * count + fan, 5 * count + fan[:, ::-1]])
    return Mesh(vertices, normals, triangles, paint(len(vertices), color))


def box(center: ArrayLike, half: ArrayLike, color: RGB) -> Mesh:
    """A box about `center` [3] m with half-extents `half` [3] m."""
    x, y, z = np.asarray(half, dtype=float)
    outline = np.array([[-x, -y], [x, -y], [x, y], [-x, y]])
    return moved(prism(outline, -z, z, color), np.eye(3), center)


def capsule(start: ArrayLike, end: ArrayLike, radius: float, color: RGB, sides: int = 14) -> Mesh:
    """A capsule between two points [3] m; a sphere if they coincide."""
    length = float(np.linalg.norm(np.subtract(end, start)))
    arc = np.linspace(-np.pi / 2.0, 0.0, 5)
    lower = [(radius * np.cos(a), radius * np.sin(a), np.cos(a), np.sin(a)) for a in arc]
    upper = [(r, length - z, nr, -nz) for r, z, nr, nz in reversed(lower)]
    return _standing(_revolve(np.array([*lower, *upper]), sides, color), start, end)


def cylinder(start: ArrayLike, end: ArrayLike, radius: float, color: RGB, sides: int = 18) -> Mesh:
    """A cylinder between two different points [3] m."""
    length = float(np.linalg.norm(np.subtract(end, start)))
    profile = [(0, 0, 0, -1), (radius, 0, 0, -1), (radius, 0, 1, 0), (radius, length, 1, 0)]
    profile += [(radius, length, 0, 1), (0, length, 0, 1)]
    return _standing(_revolve(np.array(profile, dtype=float), sides, color), start, end)


def outline(vertices: Floats, radius: float, arc_points: int = 48) -> Floats:
    """[M, 2] m, corners of a rounded convex polygon, counter-clockwise and without repetition.

    Args:
      vertices: [V, 2] m, convex polygon; repeated vertices are allowed, one point makes a circle.
      radius: rounding radius, m.
      arc_points: number of corners of a full circle.
    """
    points = np.unique(np.round(np.asarray(vertices, dtype=float), 6), axis=0)
    if radius > 0.0:
        angles = 2.0 * np.pi * np.arange(arc_points) / arc_points
        circle = radius * np.stack([np.cos(angles), np.sin(angles)], axis=1)
        points = (points[:, None] + circle).reshape(-1, 2)
    points = points[np.lexsort((points[:, 1], points[:, 0]))]
    return np.array([*_chain(points)[:-1], *_chain(points[::-1])[:-1]])


def _chain(points: Floats) -> list[Floats]:
    """Lower half of the convex hull of points sorted by x, counter-clockwise (Andrew's monotone chain)."""
    chain: list[Floats] = []
    for point in points:
        while len(chain) > 1:
            a, b = chain[-1] - chain[-2], point - chain[-1]
            if a[0] * b[1] - a[1] * b[0] > 1e-12:
                break
            chain.pop()
        chain.append(point)
    return chain


def _revolve(profile: Floats, sides: int, color: RGB) -> Mesh:
    """Surface of revolution about z of a profile [P, 4]: radius, height (m) and the normal in that plane."""
    angles = 2.0 * np.pi * np.arange(sides + 1) / sides
    c, s = np.cos(angles)[:, None], np.sin(angles)[:, None]
    radius, height, across, along = profile.T
    one = np.ones_like(c)
    vertices = np.stack([c * radius, s * radius, one * height], axis=-1).reshape(-1, 3)
    normals = np.stack([c * across, s * across, one * along], axis=-1).reshape(-1, 3)
    count = len(profile)
    i, j = np.meshgrid(np.arange(sides), np.arange(count - 1), indexing="ij")
    a = (i * count + j).reshape(-1)
    triangles = np.concatenate([np.stack([a, a + count, a + 1], 1), np.stack([a + 1, a + count, a + count + 1], 1)])
    return Mesh(vertices, normals, triangles, paint(len(vertices), color))


def _standing(mesh: Mesh, start: ArrayLike, end: ArrayLike) -> Mesh:
    """A mesh made along z from the origin, moved to the axis from `start` to `end`."""
    axis = np.subtract(end, start).astype(float)
    length = np.linalg.norm(axis)
    z = axis / length if length > 0.0 else np.array([0.0, 0.0, 1.0])
    x = np.cross([0.0, 1.0, 0.0] if abs(z[1]) < 0.9 else [1.0, 0.0, 0.0], z)
    x /= np.linalg.norm(x)
    return moved(mesh, np.stack([x, np.cross(z, x), z], axis=1), start)


def paint(count: int, color: RGB) -> NDArray[np.uint8]:
    """[n, 3] one colour for all of n vertices."""
    return np.tile(np.array(color, dtype=np.uint8), (count, 1))
