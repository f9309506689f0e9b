"""Varied scenarios as arrays and as files are the same, within their bounds."""

import dataclasses
import re
import tomllib

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from jaxlocomanip.build import build
from jaxlocomanip.checked import InputError
from jaxlocomanip.obstacle_spec import MotionSpec
from jaxlocomanip.planar.dynamics import GRAVITY
from jaxlocomanip.sampling.sampler import draw
from jaxlocomanip.sampling.study import find_study
from jaxlocomanip.scenario_file import scenario_to_toml
from jaxlocomanip.specification import parse_scenario
from jaxlocomanip.variation import Bounds, check_bounds, dimension, varied_spec, vary

make = jax.jit(vary)


@pytest.fixture(scope="module")
def lanes():
    return [draw(find_study("moving"), 0, index) for index in range(4)]


def coordinates(lane, seed):
    return np.random.default_rng(seed).uniform(-1.0, 1.0, dimension(lane.scenario))


def test_file_and_arrays_agree(lanes):
    """Refusals of `build` apart: an obstacle may be moved onto the start."""
    compared = 0
    for lane in lanes:
        for seed in range(3):
            where = coordinates(lane, seed)
            try:
                from_file = build(varied_spec(lane.spec, lane.scenario, where, Bounds()), lane.index)
            except ValueError:
                continue
            varied = make(lane.scenario, jnp.asarray(where, jnp.float32), Bounds())
            for a, b in zip(jax.tree.leaves(from_file), jax.tree.leaves(varied), strict=True):
                np.testing.assert_allclose(a, b, rtol=1e-4, atol=3e-6)
            compared += 1
    assert compared > 6


def test_quantities_stay_within_the_bounds(lanes):
    box = Bounds()
    for lane in lanes:
        for sign in (-1.0, 1.0):
            varied = make(lane.scenario, jnp.full(dimension(lane.scenario), sign), box)
            end = 0 if sign < 0.0 else 1
            ratio = float(varied.truth.mass / lane.scenario.object.body.mass)
            assert ratio == pytest.approx(box.mass_ratio[end], rel=1e-5)
            friction = float(varied.truth.friction_force / (varied.truth.mass * GRAVITY))
            assert friction == pytest.approx(box.friction[end], rel=1e-5)
            assert varied.truth.com == pytest.approx(np.full(2, sign * 0.2 * 0.25), rel=1e-5)
            moved = varied.obstacles.position - lane.scenario.obstacles.position
            assert moved == pytest.approx(np.full(moved.shape, sign * box.shift), abs=1e-5)
            faster = varied.obstacles.velocity - lane.scenario.obstacles.velocity
            expected = sign * box.velocity * lane.scenario.obstacles.dynamic[:, None] * np.ones(2)
            assert faster == pytest.approx(expected, abs=1e-5)


def test_bodies_stay_possible(lanes):
    for lane in lanes:
        before = lane.scenario.truth
        varied = make(lane.scenario, jnp.asarray(coordinates(lane, 7)), Bounds()).truth
        gyration = [float(b.central_inertia / b.mass) for b in (before, varied)]
        assert gyration[1] == pytest.approx(gyration[0], rel=1e-4)


def test_standing_and_absent_obstacles_stay_so(make_scenario):
    scenario = make_scenario()
    varied = vary(scenario, jnp.ones(dimension(scenario)), Bounds())
    np.testing.assert_array_equal(varied.obstacles.position, scenario.obstacles.position)
    np.testing.assert_array_equal(varied.obstacles.velocity, scenario.obstacles.velocity)


def test_waypoints_are_carried_along(lanes):
    """To a file that can be read back, and as the arrays are."""
    (lane, *_) = lanes
    walk = MotionSpec("waypoints", times=(0.0, 5.0), points=((9.0, 9.0), (9.0, 8.0)))
    first = dataclasses.replace(lane.spec.obstacles[0], position=(9.0, 9.0), velocity=(0.0, 0.0), motion=walk)
    spec = dataclasses.replace(lane.spec, obstacles=(first,))
    scenario = build(spec)
    where, box = np.ones(dimension(scenario)), Bounds(shift=0.25)
    varied = varied_spec(spec, scenario, where, box)
    assert varied.obstacles[0].motion.points == ((9.25, 9.25), (9.25, 8.25))
    again = build(parse_scenario(tomllib.loads(scenario_to_toml(varied))))
    made = make(scenario, jnp.asarray(where, jnp.float32), box)
    for time in (0.0, 2.0, 7.0):
        np.testing.assert_allclose(again.obstacles.at(time), made.obstacles.at(time), rtol=1e-6)


@pytest.mark.parametrize(
    ("change", "text"),
    [
        ({"mass_ratio": (0.0, 2.0)}, "bounds.mass_ratio[0] = 0.0: must be > 0"),
        ({"friction": (0.5, 0.2)}, "bounds.friction[1] = 0.2: must be >= 0.5"),
        ({"position_std": (0.0, float("inf"))}, "bounds.position_std[1] = inf: must be finite"),
        ({"heading_std": 0.1}, "bounds.heading_std = 0.1: must be 2 numbers"),
        ({"com_offset": 1.5}, "bounds.com_offset = 1.5: must be >= 0 and <= 1"),
        ({"shift": -0.5}, "bounds.shift = -0.5: must be >= 0"),
        ({"start_room": float("nan")}, "bounds.start_room = nan: must be finite"),
    ],
)
def test_bad_bounds_are_refused(change, text):
    check_bounds(Bounds())
    with pytest.raises(InputError, match=re.escape(text)):
        check_bounds(Bounds(**change))
