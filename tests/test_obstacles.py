"""Obstacles on the host are where the traced ones are."""

import jax.numpy as jnp
import numpy as np
import pytest

from jaxlocomanip.obstacles import corners_at, moves, obstacle_arrays, position_at
from jaxlocomanip.specification import parse_scenario

CIRCLE = {"shape": "circle", "radius": 0.2, "position": [2.0, 3.0]}
TABLES = [
    CIRCLE,
    CIRCLE | {"velocity": [0.3, -0.1]},
    CIRCLE | {"motion": {"kind": "sine", "amplitude": [0.5, 1.0], "period": 7.0}, "velocity": [0.1, 0.0]},
    CIRCLE | {"motion": {"kind": "waypoints", "times": [1.0, 4.0], "points": [[2.0, 3.0], [5.0, 1.0]]}},
]


@pytest.fixture
def specs():
    data = {
        "name": "small",
        "object": {"size": [0.5, 0.5], "mass": 6.0},
        "start": {"pose": [0.0, 0.0, 0.0]},
        "goal": {"pose": [9.0, 0.0, 0.0]},
        "robots": [{"type": "a1", "face": "-x"}],
    }
    return parse_scenario(data | {"obstacles": TABLES}).obstacles


@pytest.mark.usefixtures("x64")
@pytest.mark.parametrize("time", [0.0, 0.5, 2.5, 30.0])
def test_positions_are_those_of_the_arrays(specs, time):
    expected = np.asarray(obstacle_arrays(specs).at(jnp.asarray(time)))
    assert np.array([position_at(o, time) for o in specs]) == pytest.approx(expected, abs=1e-9)


def test_what_has_a_velocity_or_a_motion_moves(specs):
    assert [moves(o) for o in specs] == [False, True, True, True]
    assert obstacle_arrays(specs).dynamic.tolist() == [False, True, True, True]


def test_corners_move_along(specs):
    assert corners_at(specs[1], 2.0) == pytest.approx(np.array([[2.6, 2.8]]))
