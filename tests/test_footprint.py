"""Footprints on the host: moments, covering discs, and distances like those of the traced geometry."""

import math

import jax
import numpy as np
import pytest

from jaxlocomanip.footprint import covering_discs, footprint_moments, padded, placed, polygon_gap
from jaxlocomanip.planar.geometry import polygon_distance, transform

SQUARE = np.array([[-0.25, -0.25], [0.25, -0.25], [0.25, 0.25], [-0.25, 0.25]])


def test_moments_of_a_square():
    moments = footprint_moments(SQUARE)
    assert moments.centroid == pytest.approx(np.zeros(2), abs=1e-12)
    assert moments.radius_of_gyration**2 == pytest.approx(0.5**2 / 6, rel=1e-3)
    # mean distance from the centre of a square of side a: a (sqrt 2 + asinh 1) / 6
    assert moments.mean_radius == pytest.approx(0.5 * (math.sqrt(2) + math.asinh(1)) / 6, rel=1e-3)


def test_moments_of_a_triangle_off_the_origin():
    moments = footprint_moments(np.array([[1.0, 1.0], [4.0, 1.0], [1.0, 4.0]]))
    assert moments.centroid == pytest.approx([2.0, 2.0], abs=0.02)


@pytest.mark.parametrize("size", [(0.5, 0.5), (0.5, 0.6), (1.5, 0.5), (0.3, 2.0)])
def test_discs_cover_the_footprint(size):
    polygon = np.array([[-1, -1], [1, -1], [1, 1], [-1, 1]]) * np.array(size) / 2
    centers, radii = covering_discs(polygon)
    inside = np.random.default_rng(0).uniform(-0.5, 0.5, (2000, 2)) * size
    gaps = np.linalg.norm(inside[:, None] - centers[None], axis=2) - radii
    assert gaps.min(axis=1).max() <= 1e-9


def test_moments_are_computed_once_and_cannot_be_changed():
    assert footprint_moments(SQUARE) is footprint_moments(SQUARE.copy())
    with pytest.raises(ValueError):
        footprint_moments(SQUARE).centroid[0] = 1.0


def random_polygons(rng, count, corners):
    """Convex polygons about the origin, counter-clockwise: points on ellipses."""
    angles = np.sort(rng.uniform(0.0, 2.0 * np.pi, (count, corners)), axis=1)
    shapes = np.stack([np.cos(angles), np.sin(angles)], axis=-1)
    return shapes * rng.uniform(0.2, 1.0, (count, 1, 2))


@pytest.mark.usefixtures("x64")
@pytest.mark.parametrize("corners", [1, 3, 5])
def test_gaps_are_the_distances_of_the_traced_geometry(corners):
    rng = np.random.default_rng(corners)
    a, b = random_polygons(rng, 500, 4), random_polygons(rng, 500, corners)
    b = placed(rng.uniform(-1.5, 1.5, (500, 3)), b)
    radius = rng.uniform(0.0, 0.3, 500)
    expected = np.asarray(jax.vmap(lambda p, q, r: polygon_distance(p, 0.0, q, r))(a, b, radius))
    assert (expected < 0.0).any() and (expected > 0.0).any()
    assert polygon_gap(a, b, radius) == pytest.approx(expected, abs=1e-9)


def test_gaps_broadcast():
    shapes = placed(np.array([[1.0, 0.0, 0.0], [0.0, 3.0, 0.0]]), SQUARE[None])
    gaps = polygon_gap(SQUARE[None, None], shapes[:, None])
    assert gaps == pytest.approx(np.array([[0.5], [2.5]]))


def test_padding_repeats_the_last_corner():
    made = padded([SQUARE, [(2.0, 3.0)]])
    assert made.shape == (2, 4, 2)
    assert (made[1] == [2.0, 3.0]).all()


@pytest.mark.usefixtures("x64")
def test_placing_is_the_traced_transform():
    pose = np.array([1.0, -2.0, 0.7])
    assert placed(pose, SQUARE) == pytest.approx(np.asarray(transform(pose, SQUARE)), abs=1e-12)
