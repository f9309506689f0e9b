"""Plane geometry: rotations and signed distances between rounded convex polygons.

A *rounded polygon* is the set of points within `radius` of a convex polygon with counter-clockwise vertices [V, 2].
A circle is a polygon of one point; polygons of fewer than V vertices repeat their last one, so that shapes of all
kinds stack into one array. Distances are negative inside.
"""

from __future__ import annotations

import jax
import jax.numpy as jnp
from jax import Array

from jaxlocomanip.numerics import Floats, pytree, safe_norm, tiny


def rotate(angle: Array, v: Array) -> Array:
    """Rotate vectors [..., 2] by `angle` (rad, broadcast over the leading axes)."""
    c, s = jnp.cos(angle), jnp.sin(angle)
    return jnp.stack([c * v[..., 0] - s * v[..., 1], s * v[..., 0] + c * v[..., 1]], axis=-1)


def perpendicular(v: Array) -> Array:
    """Vectors [..., 2] turned by +90 degrees; equals e_z x v."""
    return jnp.stack([-v[..., 1], v[..., 0]], axis=-1)


def cross(a: Array, b: Array) -> Array:
    """Scalar cross product a_x b_y - a_y b_x of [..., 2] vectors."""
    return a[..., 0] * b[..., 1] - a[..., 1] * b[..., 0]


def transform(pose: Array, points: Array) -> Array:
    """Points [..., 2] of a body frame with pose [x, y, theta] in world coordinates."""
    return pose[:2] + rotate(pose[2], points)


def rectangle(pose: Array, half_length: Array, half_width: Array) -> Array:
    """Corners [4, 2], counter-clockwise, of a rectangle centred at `pose` with its length along the heading."""
    signs = jnp.array([[-1.0, -1.0], [1.0, -1.0], [1.0, 1.0], [-1.0, 1.0]], dtype=pose.dtype)
    return transform(pose, signs * jnp.stack([half_length, half_width]))


def _edges(vertices: Array) -> tuple[Array, Array, Array, Array]:
    """Edge vectors [V, 2], unit outward normals [V, 2], lengths [V] and a mask of the edges of non-zero length."""
    edges = jnp.roll(vertices, -1, axis=0) - vertices
    lengths = safe_norm(edges)
    valid = lengths > tiny(vertices.dtype)
    normals = -perpendicular(edges) / jnp.where(valid, lengths, 1.0)[:, None]
    return edges, normals, lengths, valid


@pytree
class Feature:
    """The part of a polygon nearest to some point: a corner, or the line of an edge."""

    anchor: Array
    """[2] the corner, or the first end of the edge"""
    normal: Array
    """[2] outward unit normal of the edge"""
    flat: Array
    """[] bool: an edge"""


def nearest_feature(point: Array, vertices: Array) -> Feature:
    """The feature of a convex polygon [V, 2] nearest to a point [2]; a constant to differentiation."""
    point, vertices = jax.lax.stop_gradient((point, vertices))
    edges, normals, _, valid = _edges(vertices)
    offset = point - vertices
    squared_length = jnp.maximum(jnp.sum(edges * edges, axis=1), tiny(point.dtype))
    raw = jnp.sum(offset * edges, axis=1) / squared_length
    along = jnp.clip(raw, 0.0, 1.0)
    gaps = offset - along[:, None] * edges
    planes = jnp.where(valid, jnp.sum(offset * normals, axis=1), -jnp.inf)
    inside = jnp.any(valid) & jnp.all(planes <= 0.0)
    index = jnp.where(inside, jnp.argmax(planes), jnp.argmin(jnp.sum(gaps * gaps, axis=1)))
    chosen = (jnp.arange(vertices.shape[0]) == index).astype(point.dtype)
    at_end = jnp.sum(chosen * along) >= 1.0
    flat = inside | (jnp.any((chosen > 0.5) & valid & (raw > 0.0) & (raw < 1.0)))
    # Sums of products, not matrix products: under `vmap` those would be many tiny library calls.
    pick = chosen[:, None]
    anchor = jnp.sum(pick * (vertices + jnp.where(at_end & ~flat, edges, 0.0)), axis=0)
    return Feature(anchor, jnp.sum(pick * normals, axis=0), flat)


def feature_distance(point: Array, feature: Feature) -> tuple[Array, Array, Array]:
    """Signed distance [], its gradient [2] and its curvature [] at a point [2].

    The Hessian of the distance is curvature (I - n n') with the unit gradient n.
    """
    w = point - feature.anchor
    length = safe_norm(w)
    floor = jnp.maximum(length, tiny(point.dtype))
    normal = jnp.where(feature.flat, feature.normal, w / floor)
    distance = jnp.where(feature.flat, jnp.sum(w * feature.normal), length)
    return distance, normal, jnp.where(feature.flat, 0.0, 1.0 / floor)


def point_distance(point: Array, vertices: Array, radius: Floats) -> Array:
    """Signed distance in m from a point [2] to a rounded polygon.

    Exact outside and, for a polygon, the distance to the nearest face plane inside. Differentiable: the nearest
    corner or edge is chosen first and held fixed.
    """
    return feature_distance(point, nearest_feature(point, vertices))[0] - radius


def quick_point_distance(point: Array, vertices: Array, radius: Floats) -> Array:
    """`point_distance` by less than half the operations, for its value only: no feature is held fixed."""
    edges, normals, _, valid = _edges(vertices)
    offset = point - vertices
    squared_length = jnp.maximum(jnp.sum(edges * edges, axis=1), tiny(point.dtype))
    along = jnp.clip(jnp.sum(offset * edges, axis=1) / squared_length, 0.0, 1.0)
    gaps = offset - along[:, None] * edges
    outside = jnp.sqrt(jnp.min(jnp.sum(gaps * gaps, axis=1)))
    inside = jnp.max(jnp.where(valid, jnp.sum(offset * normals, axis=1), -jnp.inf))
    return jnp.where(jnp.any(valid) & (inside < 0.0), inside, outside) - radius


def polygon_distance(a: Array, radius_a: Floats, b: Array, radius_b: Floats) -> Array:
    """Signed distance in m between two rounded convex polygons [V, 2] and [W, 2].

    Exact while their polygons are apart; when they overlap, minus the least translation that separates them along a
    face normal of either.
    """

    def separation(p: Array, q: Array) -> tuple[Array, Array]:
        edges, normals, _, valid = _edges(p)
        offset = q[None, :, :] - p[:, None, :]
        planes = jnp.einsum("vwi,vi->vw", offset, normals)
        axis = jnp.max(jnp.where(valid, jnp.min(planes, axis=1), -jnp.inf))
        squared_length = jnp.maximum(jnp.sum(edges * edges, axis=1), tiny(p.dtype))
        along = jnp.clip(jnp.einsum("vwi,vi->vw", offset, edges) / squared_length[:, None], 0.0, 1.0)
        gaps = offset - along[:, :, None] * edges[:, None, :]
        return axis, jnp.min(safe_norm(gaps))

    axis_a, gap_a = separation(a, b)
    axis_b, gap_b = separation(b, a)
    deepest = jnp.maximum(axis_a, axis_b)
    apart = jnp.minimum(gap_a, gap_b)
    overlap = jnp.isfinite(deepest) & (deepest < 0.0)
    return jnp.where(overlap, deepest, apart) - radius_a - radius_b
