"""Convex footprints on the host: moments under uniform density, covering discs, signed distances.

Plain NumPy, for checking and building scenarios one by one, where a compiled call costs more than its arithmetic;
`planar.geometry` has the traced counterparts.
"""

from __future__ import annotations

import functools
import math
from collections.abc import Sequence
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

Floats = NDArray[np.floating[Any]]


class Moments(NamedTuple):
    """Moments of a footprint under uniform density."""

    centroid: Floats
    """[2] m"""
    radius_of_gyration: float
    """m, about the centroid"""
    mean_radius: float
    """m, mean distance from the centroid: torsional over sliding friction"""


def footprint_moments(polygon: Floats, resolution: int = 200) -> Moments:
    """Moments of a convex polygon [V, 2] by midpoint samples on a grid."""
    return _moments(tuple(map(tuple, np.asarray(polygon, dtype=float).tolist())), resolution)


@functools.lru_cache(maxsize=256)
def _moments(corners: tuple[tuple[float, ...], ...], resolution: int) -> Moments:
    # Studies build thousands of scenarios around one footprint, and these samples would be most of the work.
    polygon = np.array(corners)
    low, high = polygon.min(axis=0), polygon.max(axis=0)
    ticks = (np.arange(resolution) + 0.5) / resolution
    grid = low + (high - low) * np.stack(np.meshgrid(ticks, ticks), axis=-1).reshape(-1, 2)
    edges = np.roll(polygon, -1, axis=0) - polygon
    offsets = grid[:, None, :] - polygon[None, :, :]
    inside = grid[(edges[:, 0] * offsets[..., 1] - edges[:, 1] * offsets[..., 0] >= 0.0).all(axis=1)]
    centroid = inside.mean(axis=0)
    centroid.flags.writeable = False
    radii = np.linalg.norm(inside - centroid, axis=1)
    return Moments(centroid, float(np.sqrt((radii**2).mean())), float(radii.mean()))


def covering_discs(polygon: Floats) -> tuple[Floats, Floats]:
    """Few discs, along the longer principal axis, that cover a convex polygon: centres [K, 2], radii [K]."""
    middle = (polygon.max(axis=0) + polygon.min(axis=0)) / 2.0
    _, _, axes = np.linalg.svd(polygon - polygon.mean(axis=0))
    local = (polygon - middle) @ axes.T
    extent = local.max(axis=0) - local.min(axis=0)
    if extent[0] < 1.5 * extent[1]:
        return middle[None], np.array([np.linalg.norm(polygon - middle, axis=1).max()])
    count = min(MOST_DISCS, math.ceil(extent[0] / extent[1]))
    width = extent[0] / count
    centers = local.min(axis=0) + np.stack([(np.arange(count) + 0.5) * width, np.full(count, extent[1] / 2.0)], axis=1)
    radius = math.hypot(width, extent[1]) / 2.0
    return middle + centers @ axes, np.full(count, radius)


MOST_DISCS = 4
"""discs that a footprint is covered with at most"""


def placed(pose: Any, points: Floats) -> Floats:
    """Points [..., K, 2] of bodies with poses [..., 3], in world coordinates, m."""
    pose = np.asarray(pose, dtype=float)
    c, s = np.cos(pose[..., 2])[..., None], np.sin(pose[..., 2])[..., None]
    x, y = points[..., 0], points[..., 1]
    return np.stack([c * x - s * y, s * x + c * y], axis=-1) + pose[..., None, :2]


def padded(polygons: Sequence[Any]) -> Floats:
    """[n, V, 2] polygons with their last vertex repeated up to the largest number of vertices."""
    corners = max(len(polygon) for polygon in polygons)
    return np.array([[*polygon, *[polygon[-1]] * (corners - len(polygon))] for polygon in polygons])


def polygon_gap(a: Floats, b: Floats, radius: Any = 0.0) -> Floats:
    """[...] m, signed distance of convex polygons [..., V, 2] to others [..., W, 2] rounded by `radius` [...].

    The same figures as `planar.geometry.polygon_distance`: exact while apart, and minus the least translation along a
    face normal of either that separates them when they overlap.
    """
    axis_a, gap_a = _separation(a, b)
    axis_b, gap_b = _separation(b, a)
    deepest = np.maximum(axis_a, axis_b)
    overlap = np.isfinite(deepest) & (deepest < 0.0)
    return np.where(overlap, deepest, np.sqrt(np.minimum(gap_a, gap_b))) - radius


def _separation(p: Floats, q: Floats) -> tuple[Floats, Floats]:
    """Largest separation along a face normal of p [..., V, 2]; least squared distance of q's corners to p's edges."""
    # Not `np.roll`, which takes longer than all the rest of this.
    edges = np.concatenate([p[..., 1:, :], p[..., :1, :]], axis=-2) - p
    squared = edges[..., 0] ** 2 + edges[..., 1] ** 2
    valid = squared > 1e-18
    squared = np.where(valid, squared, 1.0)
    offset = q[..., :, None, :] - p[..., None, :, :]
    ex, ey = edges[..., None, :, 0], edges[..., None, :, 1]
    planes = (offset[..., 0] * ey - offset[..., 1] * ex) / np.sqrt(squared)[..., None, :]
    axis = np.where(valid, planes.min(axis=-2), -np.inf).max(axis=-1)
    along = np.minimum(np.maximum((offset[..., 0] * ex + offset[..., 1] * ey) / squared[..., None, :], 0.0), 1.0)
    gx, gy = offset[..., 0] - along * ex, offset[..., 1] - along * ey
    return axis, (gx * gx + gy * gy).min(axis=(-2, -1))
