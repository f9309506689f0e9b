"""Signed distances against two oracles: dense boundary samples, and separation over a dense set of directions."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from jaxlocomanip.planar.geometry import (
    cross,
    feature_distance,
    nearest_feature,
    outline,
    perpendicular,
    point_distance,
    polygon_distance,
    quick_distance,
    quick_normal,
    rectangle,
    rotate,
    transform,
)
from jaxlocomanip.planar.vector import vector, vectors

polygon_distances = jax.jit(jax.vmap(polygon_distance))
one_distance = jax.jit(polygon_distance)
point_distances = jax.jit(jax.vmap(point_distance, (0, None, None)))
SQUARE = np.array([[-0.5, -0.5], [0.5, -0.5], [0.5, 0.5], [-0.5, 0.5]])
TRIANGLE = np.array([[0.0, 0.0], [1.2, 0.1], [0.3, 0.9], [0.3, 0.9]])  # last vertex repeated, as padding
POINT = np.zeros((4, 2))
DIRECTIONS = 40_000


def polygon(rng):
    """Random convex counter-clockwise polygon of 5 vertices in the unit ellipse, anywhere near the origin."""
    angles = np.sort(rng.uniform(0.0, 2.0 * np.pi, 5))
    corners = np.stack([np.cos(angles), np.sin(angles)], axis=1) * rng.uniform(0.3, 1.0, 2)
    return corners + rng.uniform(-1.2, 1.2, 2)


def separation(a, b):
    """Largest gap between the shadows of two convex point sets over all directions: their signed distance.

    Apart it is the distance, overlapping minus the least translation that separates them. The gap changes with the
    direction at most as fast as the sets are wide, which bounds the error from below.
    """
    angle = 2.0 * np.pi * np.arange(DIRECTIONS) / DIRECTIONS
    n = np.stack([np.cos(angle), np.sin(angle)])
    gaps = (b @ n).min(axis=0) - (a @ n).max(axis=0)
    width = np.linalg.norm(b[:, None] - a[None], axis=2).max()
    return gaps.max(), width * np.pi / DIRECTIONS


def boundary(vertices, count=300):
    """Dense samples of a polygon's boundary, and the largest distance of a boundary point to a sample."""
    following = np.roll(vertices, -1, axis=0)
    t = np.linspace(0.0, 1.0, count)[:, None, None]
    spacing = np.linalg.norm(following - vertices, axis=1).max() / (count - 1)
    return ((1.0 - t) * vertices + t * following).reshape(-1, 2), spacing / 2.0


def test_polygon_distance_against_separation_over_directions(x64):
    rng = np.random.default_rng(0)
    pairs = [(polygon(rng), polygon(rng)) for _ in range(120)]
    radii = rng.uniform(0.0, 0.3, (2, 120))
    a, b = (np.stack(side) for side in zip(*pairs, strict=True))
    found = np.asarray(polygon_distances(jnp.asarray(a), radii[0], jnp.asarray(b), radii[1])) + radii.sum(axis=0)
    expected = np.array([separation(p, q) for p, q in pairs])
    assert (found >= expected[:, 0] - 1e-9).all()
    assert (found <= expected[:, 0] + expected[:, 1] + 1e-9).all()
    assert 20 < (found < 0.0).sum() < 100  # both signs were tried


def test_polygon_distance_against_boundary_samples(x64):
    rng = np.random.default_rng(1)
    tried = 0
    for _ in range(40):
        a, b = polygon(rng), polygon(rng)
        if separation(a, b)[0] < 0.0:
            continue
        (p, error_p), (q, error_q) = boundary(a), boundary(b)
        sampled = np.sqrt(((p[:, None] - q[None]) ** 2).sum(axis=2).min())
        found = one_distance(jnp.asarray(a), 0.0, jnp.asarray(b), 0.0)
        assert sampled - error_p - error_q <= found <= sampled + 1e-12
        tried += 1
    assert tried > 10


def test_polygon_distance_is_symmetric_and_moves_along(x64):
    rng = np.random.default_rng(2)
    for _ in range(20):
        a, b, pose = polygon(rng), polygon(rng), jnp.asarray(rng.normal(size=3))
        there = one_distance(jnp.asarray(a), 0.1, jnp.asarray(b), 0.2)
        back = one_distance(jnp.asarray(b), 0.2, jnp.asarray(a), 0.1)
        moved = one_distance(transform(pose, jnp.asarray(a)), 0.1, transform(pose, jnp.asarray(b)), 0.2)
        assert there == pytest.approx(float(back), abs=1e-12)
        assert there == pytest.approx(float(moved), abs=1e-12)


def test_circles_are_points_with_a_radius():
    a, b = jnp.asarray(POINT), jnp.asarray(POINT + [3.0, 4.0])
    assert polygon_distance(a, 1.0, b, 0.5) == pytest.approx(3.5)
    assert polygon_distance(a, 3.0, b, 3.0) == pytest.approx(-1.0)
    assert polygon_distance(a, 0.2, jnp.asarray(SQUARE + [2.0, 0.0]), 0.0) == pytest.approx(1.3)
    # A circle whose centre is inside: out through the nearest face.
    assert polygon_distance(jnp.asarray(POINT + [0.3, 0.0]), 0.1, jnp.asarray(SQUARE), 0.0) == pytest.approx(-0.3)


@pytest.mark.parametrize("vertices", [SQUARE, TRIANGLE], ids=["square", "padded triangle"])
def test_point_distance_against_oracles(x64, vertices):
    rng = np.random.default_rng(3)
    points = rng.uniform(-1.5, 2.0, (300, 2))
    found = np.asarray(point_distances(jnp.asarray(points), jnp.asarray(vertices), 0.1))
    at, edges = vectors(jnp.asarray(points)), outline(vectors(jnp.asarray(vertices)[:, None]))
    np.testing.assert_allclose(quick_distance(at, edges) - 0.1, found, atol=1e-9)
    slopes = jax.vmap(jax.grad(point_distance), (0, None, None))(jnp.asarray(points), jnp.asarray(vertices), 0.1)
    np.testing.assert_allclose(jnp.stack(list(vars(quick_normal(at, edges)).values()), axis=1), slopes, atol=1e-9)
    samples, error = boundary(vertices, 2000)
    nearest = np.sqrt(((points[:, None] - samples[None]) ** 2).sum(axis=2).min(axis=1))
    edges = np.roll(vertices, -1, axis=0) - vertices
    sides = edges[:, 0] * (points[:, None, 1] - vertices[:, 1]) - edges[:, 1] * (points[:, None, 0] - vertices[:, 0])
    inside = (sides >= 0.0).all(axis=1)
    signed = np.where(inside, -nearest, nearest) - 0.1
    assert np.abs(found - signed).max() <= error
    assert inside.any() and not inside.all()


def test_point_distance_to_a_circle():
    assert point_distance(jnp.array([3.0, 4.0]), jnp.asarray(POINT), 2.0) == pytest.approx(3.0)
    assert point_distance(jnp.array([0.3, 0.4]), jnp.asarray(POINT), 2.0) == pytest.approx(-1.5)
    gradient = jax.grad(point_distance)(jnp.zeros(2), jnp.asarray(POINT), 2.0)
    assert gradient.tolist() == [0.0, 0.0]  # the middle: no direction, but no NaN either


def test_point_distance_slope_against_finite_differences(x64):
    rng = np.random.default_rng(4)
    slope, distance = jax.jit(jax.grad(point_distance)), jax.jit(point_distance)
    feature = jax.jit(feature_near)
    h, tried = 1e-6, 0
    for vertices in (SQUARE, TRIANGLE, POINT):
        vertices = jnp.asarray(vertices)
        for point in rng.uniform(-1.5, 1.5, (60, 2)):
            steps = [np.array([h, 0.0]), np.array([0.0, h])]
            seen = [feature(jnp.asarray(point + s), vertices) for d in steps for s in (d, -d)]
            same = all(
                np.allclose(a, b)
                for f in seen[1:]
                for a, b in zip(jax.tree.leaves(f), jax.tree.leaves(seen[0]), strict=True)
            )
            if not same:
                continue  # another corner or edge within the step: a kink
            difference = [
                float(distance(jnp.asarray(point + d), vertices, 0.0) - distance(jnp.asarray(point - d), vertices, 0.0))
                / (2.0 * h)
                for d in steps
            ]
            assert np.asarray(slope(jnp.asarray(point), vertices, 0.0)) == pytest.approx(difference, abs=1e-6)
            tried += 1
    assert tried > 150


def feature_near(point, vertices):
    return nearest_feature(vector(point), outline(vectors(vertices)))


def segment_distance(point, vertices):
    """Distance to the boundary of a polygon, written independently."""
    edges = jnp.roll(vertices, -1, axis=0) - vertices
    t = jnp.clip(jnp.sum((point - vertices) * edges, axis=1) / jnp.sum(edges**2, axis=1), 0.0, 1.0)
    return jnp.sqrt(jnp.min(jnp.sum((point - vertices - t[:, None] * edges) ** 2, axis=1)))


def test_feature_distance_has_the_exact_gradient_and_curvature(x64):
    rng = np.random.default_rng(5)
    square = jnp.asarray(SQUARE)
    gradient, hessian = jax.jit(jax.grad(segment_distance)), jax.jit(jax.hessian(segment_distance))
    corners = 0
    for point in rng.uniform(-2.0, 2.0, (80, 2)):
        if np.abs(point).max() < 0.5:
            continue
        feature = feature_near(jnp.asarray(point), square)
        distance, normal, curvature = feature_distance(vector(jnp.asarray(point)), feature)
        normal = np.array([normal.x, normal.y])
        assert distance == pytest.approx(float(segment_distance(jnp.asarray(point), square)), abs=1e-12)
        assert np.allclose(normal, gradient(jnp.asarray(point), square), rtol=0.0, atol=1e-9)
        projector = np.eye(2) - np.outer(normal, normal)
        assert np.allclose(curvature * projector, hessian(jnp.asarray(point), square), rtol=0.0, atol=1e-8)
        corners += not bool(feature.flat)
    assert 10 < corners < 60


def test_rotations(x64):
    v = jnp.array([[1.0, 2.0], [-0.5, 0.3]])
    assert np.allclose(rotate(jnp.asarray(np.pi / 2), v), perpendicular(v), rtol=0.0, atol=1e-15)
    assert np.allclose(rotate(jnp.asarray(0.7), rotate(jnp.asarray(-0.7), v)), v, rtol=0.0, atol=1e-15)
    assert np.allclose(cross(v, perpendicular(v)), np.sum(np.asarray(v) ** 2, axis=1))
    turned = rotate(jnp.array([0.3, -1.0]), v)  # one angle a vector
    for k, angle in enumerate((0.3, -1.0)):
        assert np.allclose(turned[k], rotate(jnp.asarray(angle), v[k]))


def test_rectangle_is_counter_clockwise_with_its_length_along_the_heading(x64):
    corners = np.asarray(rectangle(jnp.array([1.0, 2.0, np.pi / 2]), jnp.asarray(0.6), jnp.asarray(0.2)))
    assert corners.min(axis=0) == pytest.approx([0.8, 1.4])
    assert corners.max(axis=0) == pytest.approx([1.2, 2.6])
    following = np.roll(corners, -1, axis=0)
    area = 0.5 * np.sum(corners[:, 0] * following[:, 1] - corners[:, 1] * following[:, 0])
    assert area == pytest.approx(4.0 * 0.6 * 0.2)
