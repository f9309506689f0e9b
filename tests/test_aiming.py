"""Obstacles aimed at where the object went, against the geometry that comes of it."""

import dataclasses

import numpy as np
import pytest

from jaxlocomanip.aiming import Motion, aims, straight_motion
from jaxlocomanip.footprint import placed, polygon_gap
from jaxlocomanip.variation import BODY, NOISE, Bounds, dimension, vary

OBSTACLES = [
    {"shape": "box", "size": [0.4, 0.4], "position": [1.0, 0.4]},
    {"shape": "circle", "radius": 0.3, "position": [0.0, 3.0]},
]
POSES = np.stack([np.linspace(0.0, 2.0, 21), np.zeros(21), np.linspace(0.0, 0.8, 21)], axis=1)


@pytest.fixture
def scenario(make_scenario):
    return make_scenario(obstacles=OBSTACLES)


def made(scenario, coordinates):
    places = np.asarray(vary(scenario, coordinates, Bounds()).obstacles.position)
    return Motion(POSES, np.broadcast_to(places, (len(POSES), *places.shape)))


def test_what_is_promised_is_the_clearance_of_the_same_motion(scenario):
    coordinates = np.random.default_rng(0).uniform(-0.5, 0.5, dimension(scenario))
    found = aims(scenario, coordinates, made(scenario, coordinates), Bounds())
    assert [aim.clearance for aim in found] == sorted(aim.clearance for aim in found)
    body = placed(POSES, np.asarray(scenario.object.vertices))
    for aim in found[::5]:
        assert np.abs(aim.coordinates).max() <= 1.0
        after = made(scenario, aim.coordinates).obstacles
        gaps = [
            polygon_gap(
                body, after[:, k, None] + np.asarray(scenario.obstacles.vertices[k]), scenario.obstacles.radius[k]
            )
            for k in range(2)
        ]
        assert np.min(gaps) <= aim.clearance + 1e-4
        assert np.abs(np.array(gaps) - aim.clearance).min() < 1e-4


def test_the_best_is_in_the_middle_of_the_object(scenario):
    """The box can be reached, and a turned object is overlapped more deeply; the circle is too far off."""
    best = aims(scenario, np.zeros(dimension(scenario)), made(scenario, np.zeros(dimension(scenario))), Bounds())[0]
    assert best.clearance < -(0.25 + 0.2)
    assert best.coordinates[BODY + NOISE + 1] == pytest.approx(-0.8, abs=0.01)
    assert (best.coordinates[BODY + NOISE + 4 :] == 0.0).all()


def test_absent_obstacles_are_not_aimed(scenario):
    absent = dataclasses.replace(scenario.obstacles, mask=np.array([False, True]))
    coordinates = np.zeros(dimension(scenario))
    for aim in aims(
        dataclasses.replace(scenario, obstacles=absent), coordinates, made(scenario, coordinates), Bounds()
    ):
        assert (aim.coordinates[BODY + NOISE : BODY + NOISE + 4] == 0.0).all()


def test_the_straight_motion_ends_at_the_goal_and_turns_the_short_way(make_scenario):
    scenario = make_scenario(
        obstacles=OBSTACLES,
        duration=20.0,
        start={"pose": [0.0, 0.0, 3.0]},
        goal={"pose": [3.0, 4.0, -3.0]},
    )
    motion = straight_motion(scenario, 0.5)
    turned = motion.pose[:, 2]
    assert np.allclose(motion.pose[0], [0.0, 0.0, 3.0]) and np.allclose(motion.pose[-1, :2], [3.0, 4.0])
    assert turned[-1] == pytest.approx(2.0 * np.pi - 3.0) and (np.diff(turned) >= 0.0).all()
    assert np.allclose(motion.obstacles, np.asarray(scenario.obstacles.position))
    step = np.linalg.norm(np.diff(motion.pose[:, :2], axis=0), axis=1).max()
    assert step == pytest.approx(0.5 * float(scenario.duration) / 79, rel=1e-3)
