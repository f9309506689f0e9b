"""The paper's experiments in the planar world: what must come of them, with everything and without parts of it.

All experiments of two robots run as one batch, so that they share one compilation with every ablation.
"""

from __future__ import annotations

import dataclasses

import numpy as np
import pytest

from jaxlocomanip import library
from jaxlocomanip.build import build
from jaxlocomanip.closed_loop import simulate
from jaxlocomanip.config_file import without
from jaxlocomanip.padding import stack
from jaxlocomanip.planner.config import PlannerConfig
from jaxlocomanip.specification import ScenarioSpec

LIBRARY = ("adaptive", "robot_cbf", "start_left", "start_right", "hardware", "people")


def _variants() -> dict[str, ScenarioSpec]:
    """`adaptive` with other true objects."""
    base = library.load("adaptive")
    changes = {
        "heavy and rough": {"mass": 12.0, "friction": 0.6},
        "light and smooth": {"mass": 4.0, "friction": 0.2},
        "off centre": {"com": (0.1, 0.0)},
        "off centre aside": {"com": (0.0, 0.1)},
    }
    return {k: dataclasses.replace(base, truth=dataclasses.replace(base.truth, **v)) for k, v in changes.items()}


@pytest.fixture(scope="module")
def specs():
    return {name: library.load(name) for name in LIBRARY} | _variants()


@pytest.fixture(scope="module")
def run(specs):
    """A function from features switched off to the outcomes, by name."""
    batch = stack([build(spec, index) for index, spec in enumerate(specs.values())])

    def outcomes(*features):
        result = simulate(batch, without(PlannerConfig(), features), record=False)
        fields = {f.name: np.asarray(getattr(result.outcome, f.name)) for f in dataclasses.fields(result.outcome)}
        return {name: {k: v[lane] for k, v in fields.items()} for lane, name in enumerate(specs)}

    return outcomes


@pytest.fixture(scope="module")
def outcomes(run):
    return run()


@pytest.mark.parametrize("name", [*LIBRARY, *_variants()])
def test_reached_without_collision(outcomes, name):
    outcome = outcomes[name]
    assert outcome["reached"]
    assert not outcome["collided"]
    assert outcome["nonfinite"] == 0


def test_friction_is_learnt(outcomes):
    for name, truth in (("adaptive", 0.4 * 8.0 * 9.81), ("heavy and rough", 0.6 * 12.0 * 9.81)):
        assert outcomes[name]["estimates"][4] == pytest.approx(truth, rel=0.1)


def test_no_force_beyond_what_the_robots_can(outcomes):
    assert all(outcome["max_force_n"] <= 0.3 * 24.638 * 9.81 + 1e-3 for outcome in outcomes.values())


def test_without_adaptation_the_object_stays_short(run):
    outcome = run("adaptation")["adaptive"]
    assert not outcome["reached"]
    assert outcome["final_position_error_m"] > 0.5


def test_without_the_robots_protection_a_robot_collides_and_the_object_does_not(run):
    outcome = run("robot-cbf")["robot_cbf"]
    assert outcome["min_robot_clearance_m"] < 0.0
    assert outcome["min_object_clearance_m"] > 0.0


def test_four_robots_turn_the_object_by_a_right_angle_on_the_way():
    scenario = build(library.load("four_robots"))
    assert scenario.goal.pose[2] - scenario.start[2] == pytest.approx(0.5 * np.pi)
    outcome = simulate(scenario, record=False).outcome
    assert outcome.reached
    assert outcome.final_heading_error_rad < 0.01
    assert not outcome.collided


@pytest.mark.slow
def test_the_mirrored_scenario_gives_the_mirrored_trajectory(x64):
    left, right = (simulate(build(library.load(name))) for name in ("start_left", "start_right"))
    a, b = np.asarray(left.log.view.pose), np.asarray(right.log.view.pose)
    assert np.abs(a[:, [0, 1]] - b[:, [1, 0]]).max() < 1e-3
    assert np.abs(a[:, 2] + b[:, 2]).max() < 1e-3
    # The obstacles stand on both sides of the diagonal; the two runs pass on opposite sides of the pair.
    middle = np.array([2.5, 2.5])
    sides = [
        np.sign((p[:, :2] - middle) @ np.array([-1.0, 1.0]))[np.argmin(np.abs(p[:, :2].sum(1) - 5.0))] for p in (a, b)
    ]
    assert sides == [1.0, -1.0]
