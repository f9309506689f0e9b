"""Only the impossible and the narrow are rejected, and for the right reason."""

import math

import pytest

from jaxlocomanip.batch import run
from jaxlocomanip.build import build_on_host
from jaxlocomanip.build_team import CONTACT_MARGIN
from jaxlocomanip.robots.model import load_robot
from jaxlocomanip.sampling import feasibility
from jaxlocomanip.sampling.feasibility import REASONS, capacity, judged
from jaxlocomanip.sampling.passage import obstruction
from jaxlocomanip.sampling.sampler import sample
from jaxlocomanip.scenario import Scenario
from jaxlocomanip.specification import parse_scenario

BASE = {
    "name": "small",
    "duration": 60.0,
    "object": {"size": [0.5, 0.5], "mass": 6.0},
    "truth": {"friction": 0.3},
    "start": {"pose": [0.0, 0.0, 0.0]},
    "goal": {"pose": [4.0, 3.0, 0.0]},
    "robots": [{"type": "a1", "face": "-x"}, {"type": "a1", "face": "-y"}],
}
CIRCLE = {"shape": "circle", "radius": 0.4}
A1 = load_robot("a1").push_force_max


def verdict(**tables):
    found = judged(parse_scenario(BASE | tables), 0)
    return "feasible" if isinstance(found, Scenario) else found


def test_the_reasons_are_listed():
    assert REASONS == ("capacity", "start", "goal", "contact", "blocked", "narrow")


@pytest.mark.parametrize(
    ("goal", "expected"),
    [
        ([4.0, 0.0, 0.0], A1),
        ([4.0, 4.0, 0.0], A1 * math.sqrt(2.0)),
        ([4.0, 3.0, 0.0], A1 / 0.8),
        ([-4.0, 0.0, 0.0], 0.0),
        ([4.0, -0.001, 0.0], 0.0),
        ([4.0, 0.0, 0.5], A1),
        ([4.0, -1.0, -0.5], A1 / math.cos(0.5 - math.atan2(1.0, 4.0))),
        ([0.05, 0.0, 1.0], math.inf),
    ],
)  # fmt: skip
def test_capacity_is_the_push_towards_the_goal(goal, expected):
    spec = parse_scenario(BASE | {"goal": {"pose": goal}})
    assert capacity(spec) == pytest.approx(expected, rel=0.01, abs=1e-6)


def test_three_and_four_robots_add_up():
    four = [{"type": "a1", "face": face} for face in ("-x", "-y", "+x", "+y")]
    two = [{"type": "a1", "face": "-x", "offset": d} for d in (-0.17, 0.17)]
    assert capacity(parse_scenario(BASE | {"robots": four, "goal": {"pose": [-1.0, -1.0, 0.0]}})) == pytest.approx(
        A1 * math.sqrt(2.0)
    )
    assert capacity(parse_scenario(BASE | {"robots": two, "goal": {"pose": [4.0, 0.0, 0.0]}})) == pytest.approx(2 * A1)


def test_too_much_friction_is_rejected():
    assert verdict(truth={"friction": 0.7}) == "feasible"  # 41 N against 46 N
    assert verdict(truth={"friction": 0.76}) == "capacity"
    assert verdict(truth={"friction": 0.7, "mass": 7.0}) == "capacity"


def test_overlaps_at_the_start_are_rejected():
    assert verdict(obstacles=[CIRCLE | {"position": [0.8, 0.0]}]) != "start"
    assert verdict(obstacles=[CIRCLE | {"position": [0.6, 0.0]}]) == "start"
    walking = CIRCLE | {"velocity": [0.5, 0.0]}
    assert verdict(obstacles=[walking | {"position": [-0.5, 0.0]}]) == "start"  # on a robot
    assert verdict(obstacles=[walking | {"position": [-2.0, 0.0]}]) == "feasible"


def test_goals_without_room_are_rejected():
    assert verdict(obstacles=[CIRCLE | {"position": [4.7, 3.0]}]) == "feasible"
    assert verdict(obstacles=[CIRCLE | {"position": [4.651, 3.0]}]) == "feasible"
    assert verdict(obstacles=[CIRCLE | {"position": [4.649, 3.0]}]) == "goal"  # the tolerance does not count
    assert verdict(obstacles=[CIRCLE | {"position": [4.3, 3.0]}]) == "goal"
    assert verdict(obstacles=[CIRCLE | {"position": [3.5, 3.0]}]) == "goal"  # where the robot would stand


def test_obstacles_that_pass_the_goal_at_the_end_are_rejected():
    passing = CIRCLE | {"position": [4.0, -26.5], "velocity": [0.0, 0.5]}  # at the goal at 59 s
    assert verdict(obstacles=[passing]) == "goal"
    assert verdict(obstacles=[passing | {"position": [4.0, -16.5]}]) == "feasible"  # at 39 s
    sine = CIRCLE | {"position": [6.0, 3.0], "motion": {"kind": "sine", "amplitude": [-2.0, 0.0], "period": 80.0}}
    assert verdict(obstacles=[sine]) == "feasible"  # there at 20 s only
    sine["motion"]["period"] = 48.0
    assert verdict(obstacles=[sine]) == "goal"  # and again at 60 s


def test_offsets_off_the_face_are_rejected():
    assert verdict(robots=[{"type": "a1", "face": "-x", "offset": 0.3}, BASE["robots"][1]]) == "contact"


def test_robots_at_the_goal_may_stand_anywhere_along_their_faces():
    # Behind the goal, beside where the robot would stand at the middle of its face: it is half_width wide.
    width = load_robot("a1").half_width
    limit = 0.25 - CONTACT_MARGIN

    def no_room(gap, circles=2):
        signs = (-1.0, 1.0)[:circles]
        beside = [CIRCLE | {"position": [3.3, 3.0 + sign * (0.4 + width + gap)]} for sign in signs]
        return feasibility._no_room_at_goal(parse_scenario(BASE | {"obstacles": beside}))

    assert not no_room(0.01)
    assert no_room(-0.01)
    assert not no_room(-0.01, 1)
    assert not no_room(-limit + 0.01, 1)
    assert no_room(-limit - 0.01, 1)


@pytest.mark.slow
def test_the_planner_solves_nothing_that_was_rejected(monkeypatch):
    """The first attempts of `standard` that standing obstacles make impossible, for as long as the study gives them."""
    found = []

    def remembered(spec):
        reason = obstruction(spec)
        if reason not in (None, "narrow"):
            found.append(build_on_host(spec, len(found)))
        return reason

    monkeypatch.setattr(feasibility, "obstruction", remembered)
    lane = 0
    while len(found) < 12:
        sample("standard", 4, lane)
        lane += 1
    outcome = run(found[:12], chunk=12)
    assert not (outcome.reached & ~outcome.collided).any()
