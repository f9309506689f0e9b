"""The paper's experiments with quadrupeds, in MuJoCo C: reached on their feet, and not without what it takes."""

from __future__ import annotations

import numpy as np
import pytest

from jaxlocomanip import library
from jaxlocomanip.build import build
from jaxlocomanip.closed_loop import simulate
from jaxlocomanip.config_file import without
from jaxlocomanip.planner.config import PlannerConfig

CAPACITY = 0.3 * 24.638 * 9.81
"""N, what the planner may ask of an Aliengo"""


def outcome_of(name, *features):
    config = without(PlannerConfig(), features)
    return simulate(build(library.load(name)), config, "quadruped", backend="c", record=False).outcome


def assert_safe(outcome):
    assert outcome.nonfinite == 0
    assert not outcome.fell
    assert not outcome.collided
    assert outcome.contact_lost < 0.02


def test_the_unknown_object_reaches_the_goal():
    outcome = outcome_of("adaptive")
    assert outcome.reached
    assert_safe(outcome)
    # What robots feel of a stride passes through the estimate, which knows only what they were asked for.
    assert outcome.estimates[4] == pytest.approx(0.4 * 8.0 * 9.81, rel=0.25)
    # Strides add to what is asked for: 1.1 to 1.35 times the capacity at the most.
    assert 0.7 * CAPACITY < outcome.max_force_n < 2.0 * CAPACITY


@pytest.mark.slow
@pytest.mark.parametrize("name", ["robot_cbf", "start_left", "start_right", "hardware", "people", "four_robots"])
def test_reached_on_their_feet_without_collision(name):
    outcome = outcome_of(name)
    assert outcome.reached
    assert_safe(outcome)


@pytest.mark.slow
def test_without_adaptation_the_object_does_not_arrive():
    outcome = outcome_of("adaptive", "adaptation")
    assert not outcome.reached
    assert outcome.final_position_error_m > 0.5


@pytest.mark.slow
def test_without_the_robots_protection_a_robot_collides_and_the_object_does_not():
    outcome = outcome_of("robot_cbf", "robot-cbf")
    assert outcome.min_robot_clearance_m < 0.0
    assert outcome.min_object_clearance_m > 0.0


@pytest.mark.slow
def test_both_backends_take_the_object_along_the_same_path():
    scenario = build(library.load("adaptive"))
    c, mjx = (simulate(scenario, world="quadruped", backend=backend) for backend in ("c", "mjx"))
    assert bool(c.outcome.reached) == bool(mjx.outcome.reached)
    off = np.asarray(mjx.log.view.pose)[:, :2] - c.log.view.pose[:, :2]
    assert np.linalg.norm(off, axis=1).max() < 0.2
