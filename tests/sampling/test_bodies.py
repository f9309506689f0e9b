"""Discs that cover bodies closely: all of the outline, and little beyond it."""

import math

import numpy as np
import pytest

from jaxlocomanip.build_team import robot_rectangles
from jaxlocomanip.footprint import polygon_gap
from jaxlocomanip.sampling.bodies import ROOM, close_discs
from jaxlocomanip.sampling.pushing import offset_limits
from jaxlocomanip.specification import parse_scenario

POSES = {"start": {"pose": [0.0, 0.0, 0.0]}, "goal": {"pose": [4.0, 3.0, 0.0]}}
COM = np.array([0.05, -0.03])


def regular(count, radius):
    angles = 2.0 * math.pi * np.arange(count) / count
    return (radius * np.stack([np.cos(angles), np.sin(angles)], axis=1)).tolist()


OBJECTS = {
    "square": {"size": [0.5, 0.5]},
    "long": {"size": [1.4, 0.3]},
    "thin": {"size": [0.8, 0.03]},
    "triangle": {"footprint": regular(3, 0.4)},
    "acute": {"footprint": [[0.0, -0.1], [0.8, 0.0], [0.0, 0.1]]},
    "hexagon": {"footprint": regular(6, 0.4)},
    "round": {"footprint": regular(24, 0.3)},
    "cut": {"footprint": [[-0.3, -0.3], [0.3, -0.3], [0.3, 0.298], [0.298, 0.3], [-0.3, 0.3]]},
}


def points_around(discs, reach):
    """[n, 2] points on circles that are smaller or larger than discs [n, 3] by so much, m."""
    angles = np.linspace(-math.pi, math.pi, 90)
    ring = np.stack([np.cos(angles), np.sin(angles)], axis=1)
    return (discs[:, None, :2] + (discs[:, 2, None, None] + reach) * ring).reshape(-1, 2)


def check(discs, polygon):
    """Every disc of [n, 3] reaches beyond a polygon by `ROOM` at most, and together they do by a third of it."""
    beyond = polygon_gap(points_around(discs, 0.0)[:, None], polygon)
    assert beyond.max() <= ROOM + 1e-6
    parts = np.linspace(0.0, 1.0, 200)[:, None, None]
    outline = (polygon + parts * (np.roll(polygon, -1, axis=0) - polygon)).reshape(-1, 2)
    depth = np.linalg.norm(outline[:, None] - discs[:, :2], axis=-1) - discs[:, 2]
    assert depth.min(axis=1).max() <= -ROOM / 3.0 + 1e-6


@pytest.mark.parametrize("name", OBJECTS)
def test_discs_cover_the_object_and_reach_little_beyond(name):
    faces = ["-x", "-y"] if "size" in OBJECTS[name] else [0, 1]
    robots = [{"type": "aliengo", "face": face} for face in faces]
    tables = {"name": name, "object": OBJECTS[name] | {"mass": 6.0}} | POSES
    spec = parse_scenario(tables | {"robots": robots})
    (discs,) = close_discs(spec, COM)[0]
    assert len(discs) < 80
    check(discs, np.array(spec.object.footprint) - COM)


def test_discs_cover_the_robots_all_along_their_faces():
    robots = [{"type": "aliengo", "face": "-x"}, {"type": "a1", "face": "+y", "offset": 0.1}]
    tables = {"name": "team", "object": {"size": [0.6, 0.5], "mass": 6.0}} | POSES
    spec = parse_scenario(tables | {"robots": robots})
    limits = offset_limits(spec)
    bodies = close_discs(spec, COM)
    for robot, alternatives in enumerate(bodies[1:]):
        assert len(alternatives) == 5
        for part, discs in zip((-1.0, -0.5, 0.0, 0.5, 1.0), alternatives, strict=True):
            corners = robot_rectangles(spec, (0.0, 0.0, 0.0), (part * limits).tolist())[robot]
            check(discs, corners - COM)
