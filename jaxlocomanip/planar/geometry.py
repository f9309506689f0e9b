"""Plane geometry: rotations and signed distances between rounded convex polygons.

A *rounded polygon* is the set of points within `radius` of a convex polygon with counter-clockwise vertices [V, 2].
A circle is a polygon of one point; polygons of fewer than V vertices repeat their last one, so that shapes of all
kinds stack into one array. Distances are negative inside.
"""

from __future__ import annotations

from functools import reduce

import jax
import jax.numpy as jnp
from jax import Array

from jaxlocomanip.numerics import Floats, apart, larger, pytree, safe_norm, sine_and_cosine, smaller, tiny
from jaxlocomanip.planar.vector import Vector, choose, vector, vectors


def rotate(angle: Array, v: Array) -> Array:
    """Rotate vectors [..., 2] by `angle` (rad, broadcast over the leading axes)."""
    s, c = sine_and_cosine(angle)
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
class Outline:
    """The edges of convex polygons, along the first axis of every leaf [V, ...]."""

    corner: Vector
    """m, where an edge begins"""
    edge: Vector
    """m, from there to the next corner"""
    normal: Vector
    """outward unit normal"""
    inverse: Array
    """1/m^2, one over the squared length"""
    valid: Array
    """bool: of non-zero length"""


def outline(corners: Vector) -> Outline:
    """The edges of polygons with counter-clockwise corners [V, ...]."""
    edge = Vector(jnp.roll(corners.x, -1, axis=0), jnp.roll(corners.y, -1, axis=0)) - corners
    squared = edge.dot(edge)
    floor = tiny(squared.dtype)
    valid = squared > floor**2
    normal = edge.turned * (-1.0 / jnp.sqrt(jnp.where(valid, squared, 1.0)))
    return Outline(corners, edge, normal, 1.0 / jnp.maximum(squared, floor), valid)


@pytree
class Feature:
    """The part of a polygon nearest to some point: a corner, or the line of an edge."""

    anchor: Vector
    """the corner, or the first end of the edge"""
    normal: Vector
    """outward unit normal of the edge"""
    flat: Array
    """bool: an edge"""


def nearest_feature(point: Vector, shape: Outline) -> Feature:
    """The features of convex polygons nearest to points; constants to differentiation.

    Args:
      point: [...] m.
      shape: leaves [V, ...], that broadcast with the points after their first axis.
    """
    return feature_of(nearest_code(point, shape), shape)


def nearest_code(point: Vector, shape: Outline) -> Array:
    """What `nearest_feature` finds, as an int [...]: 2 v for corner v, 2 v + 1 for the edge that begins there."""
    point, shape = jax.lax.stop_gradient((point, shape))
    count = shape.inverse.shape[0]
    least = jnp.full_like(point.x, jnp.inf)
    deepest = -least
    outside = inside = jnp.zeros(point.x.shape, jnp.int32)
    for v in range(count):
        offset, edge = point - shape.corner[v], shape.edge[v]
        raw = offset.dot(edge) * shape.inverse[v]
        gap = offset - edge * jnp.clip(raw, 0.0, 1.0)
        squared = gap.dot(gap)
        corner = jnp.where(raw >= 1.0, 2 * ((v + 1) % count), 2 * v)
        flat = shape.valid[v] & (raw > 0.0) & (raw < 1.0)
        nearer = squared < least
        outside = jnp.where(nearer, jnp.where(flat, 2 * v + 1, corner), outside)
        least = jnp.where(nearer, squared, least)
        plane = jnp.where(shape.valid[v], offset.dot(shape.normal[v]), -jnp.inf)
        inside = jnp.where(plane > deepest, 2 * v + 1, inside)
        deepest = jnp.maximum(plane, deepest)
    return jnp.where((deepest <= 0.0) & (deepest > -jnp.inf), inside, outside)


def feature_of(code: Array, shape: Outline) -> Feature:
    """The feature that a code [...] of `nearest_code` stands for."""
    shape = jax.lax.stop_gradient(shape)
    whole = jnp.zeros(code.shape, shape.inverse.dtype)
    anchor, normal = shape.corner[0] + Vector(whole, whole), shape.normal[0] + Vector(whole, whole)
    for v in range(1, shape.inverse.shape[0]):
        reached = code >= 2 * v
        anchor, normal = choose(reached, shape.corner[v], anchor), choose(reached, shape.normal[v], normal)
    return Feature(anchor, normal, code % 2 == 1)


def feature_distance(point: Vector, feature: Feature) -> tuple[Array, Vector, Array]:
    """Signed distances [...], their gradients and their curvatures [...] at points [...].

    The Hessian of the distance is curvature (I - n n') with the unit gradient n.
    """
    w = point - feature.anchor
    squared = w.dot(w)
    away = squared > tiny(squared.dtype) ** 2
    length = jnp.sqrt(jnp.where(away, squared, tiny(squared.dtype) ** 2))
    curvature = 1.0 / length
    normal = choose(feature.flat, feature.normal, w * curvature)
    distance = jnp.where(feature.flat, w.dot(feature.normal), jnp.where(away, length, 0.0))
    return distance, normal, jnp.where(feature.flat, 0.0, curvature)


def point_distance(point: Array, vertices: Array, radius: Floats) -> Array:
    """Signed distance in m from a point [2] to a rounded polygon with corners [V, 2].

    Exact outside and, for a polygon, the distance to the nearest face plane inside. Differentiable: the nearest
    corner or edge is chosen first and held fixed.
    """
    at = vector(point)
    return feature_distance(at, nearest_feature(at, outline(vectors(vertices))))[0] - radius


def quick_distance(point: Vector, shape: Outline) -> Array:
    """`point_distance` [...] by less than half the operations, for its value only: no feature is held fixed.

    Args:
      point: [...] m.
      shape: leaves [V, ...], that broadcast with the points after their first axis.
    """
    squared, inside = [], []
    for v in range(shape.inverse.shape[0]):
        offset, edge = point - shape.corner[v], shape.edge[v]
        along = smaller(larger(offset.dot(edge) * shape.inverse[v], 0.0), 1.0)
        gap = offset - edge * along
        squared.append(gap.dot(gap))
        inside.append(jnp.where(shape.valid[v], offset.dot(shape.normal[v]), -jnp.inf))
    deepest = reduce(larger, inside)
    outside = jnp.sqrt(reduce(smaller, squared))
    return jnp.where((deepest > -jnp.inf) & (deepest < 0.0), deepest, outside)


def quick_normal(point: Vector, shape: Outline) -> Vector:
    """Gradients [...] of signed distances, as `feature_distance` has them of the nearest feature.

    By fewer operations, but for values only; arguments as in `quick_distance`.
    """
    floor = tiny(shape.inverse.dtype) ** 2
    none = jnp.zeros_like(point.x)
    least, deepest = none + jnp.inf, none - jnp.inf
    outwards = inwards = Vector(none, none)
    for v in range(shape.inverse.shape[0]):
        offset, edge, valid = point - shape.corner[v], shape.edge[v], shape.valid[v]
        raw = offset.dot(edge) * shape.inverse[v]
        gap = offset - edge * smaller(larger(raw, 0.0), 1.0)
        squared = gap.dot(gap)
        nearer, least = squared < least, smaller(squared, least)
        flat = valid & (raw > 0.0) & (raw < 1.0)
        outwards = choose(
            nearer, choose(flat, shape.normal[v], gap * (1.0 / jnp.sqrt(larger(squared, floor)))), outwards
        )
        height = jnp.where(valid, offset.dot(shape.normal[v]), -jnp.inf)
        deeper, deepest = height > deepest, larger(height, deepest)
        inwards = choose(deeper, shape.normal[v], inwards)
    return choose((deepest <= 0.0) & (deepest > -jnp.inf), inwards, outwards)


def polygon_distance(a: Array, radius_a: Floats, b: Array, radius_b: Floats) -> Array:
    """Signed distance in m between two rounded convex polygons [V, 2] and [W, 2].

    Exact while their polygons are apart; when they overlap, minus the least translation that separates them along a
    face normal of either.
    """
    return outline_distance(outline(vectors(a)), outline(vectors(b))) - radius_a - radius_b


def outline_distance(a: Outline, b: Outline) -> Array:
    """`polygon_distance` [...] of polygons without rounding, whose leaves [V, ...] and [W, ...] broadcast."""
    (axis_a, squared_a), (axis_b, squared_b) = (_best(*_pairs(*of)) for of in ((a, b.corner), (b, a.corner)))
    deepest, squared = jnp.maximum(axis_a, axis_b), jnp.minimum(squared_a, squared_b)
    overlap = (deepest > -jnp.inf) & (deepest < 0.0)
    floor = tiny(squared.dtype) ** 2
    away = ~overlap & (squared > floor)
    return jnp.where(overlap, deepest, jnp.where(away, jnp.sqrt(jnp.where(away, squared, 1.0)), 0.0))


@apart
def _pairs(shape: Outline, points: Vector) -> tuple[Array, Array]:
    """[V, W, ...] heights of points [W, ...] above the lines of edges, and squared distances to the edges."""
    shape = jax.tree.map(lambda leaf: leaf[:, None], shape)
    offset = Vector(points.x[None], points.y[None]) - shape.corner
    height = jnp.where(shape.valid, offset.dot(shape.normal), -jnp.inf)
    gap = offset - shape.edge * jnp.clip(offset.dot(shape.edge) * shape.inverse, 0.0, 1.0)
    return height, gap.dot(gap)


@apart
def _best(height: Array, squared: Array) -> tuple[Array, Array]:
    """How far all points lie beyond the line of some edge, at most, and the least squared distance; both [...]."""
    # Not by reductions over the first axes, which would not run along the last.
    beyond = [reduce(jnp.minimum, [*by_point]) for by_point in height]
    return reduce(jnp.maximum, beyond), reduce(jnp.minimum, [one for by_point in squared for one in by_point])
