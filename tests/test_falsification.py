"""The search on a made-up clearance, whose least value is known; and once in earnest."""

import dataclasses
import math
import re

import numpy as np
import pytest

from jaxlocomanip.aiming import straight_motion
from jaxlocomanip.build import build, start_gaps
from jaxlocomanip.checked import InputError
from jaxlocomanip.closed_loop import simulate
from jaxlocomanip.falsification import Search, falsify
from jaxlocomanip.planner.config import Horizon, PlannerConfig
from jaxlocomanip.random_worst import sample_worst
from jaxlocomanip.sampling.feasibility import judged
from jaxlocomanip.sampling.study import parse_study
from jaxlocomanip.trials import Trials
from jaxlocomanip.variation import Bounds

SMALL = Search(drawn=6, screened=6, aimed=(2, 2), lanes=3, rounds=3, steps=(0.1, 0.4))


@pytest.fixture(scope="module")
def study(breaking):
    return parse_study(breaking)


def test_steps_go_down_to_the_bounds(study, no_episodes):
    config = PlannerConfig()
    begun = sample_worst(study, config, SMALL.screened, keep=SMALL.screened)
    found = falsify(study, config, search=SMALL)
    assert found.worst[0].clearance < begun.worst[0].clearance
    assert [one.clearance for one in found.worst] == sorted(one.clearance for one in found.worst)
    assert len({one.spec.name for one in found.worst}) == SMALL.lanes
    assert found.collisions == sum(one.clearance < 0.0 for one in found.worst)
    assert found.counted == SMALL.lanes
    for one in found.worst:
        assert 3.0 <= one.spec.truth.mass <= 12.0 and 0.15 <= one.spec.truth.friction <= 0.6
        assert not isinstance(judged(one.spec, 0), str)
        assert start_gaps(one.spec).min() >= Bounds().start_room


def test_the_budget_is_what_it_costs(study, no_episodes):
    found = falsify(study, PlannerConfig(), search=SMALL)
    random, tried = SMALL.screened, sum(SMALL.aimed) + SMALL.rounds * SMALL.lanes * len(SMALL.steps)
    assert no_episodes.episodes == random + tried
    assert no_episodes.gradients == SMALL.rounds * SMALL.lanes
    assert found.episodes == SMALL.episodes == math.ceil(random + tried + SMALL.gradient_cost * no_episodes.gradients)


def test_what_is_there_after_every_stage_is_kept(study, no_episodes):
    stages = []
    found = falsify(study, PlannerConfig(), search=SMALL, kept=stages.append)
    assert [one.episodes for one in stages] == [6, 8, 10, 21, 31, 42]
    assert all(len(one.worst) == SMALL.lanes for one in stages)
    least = [one.worst[0].clearance for one in stages]
    assert least == sorted(least, reverse=True)
    assert stages[-1] == found


def test_without_gradients_directions_are_random(study, no_episodes, monkeypatch):
    monkeypatch.setattr(Trials, "gradients", lambda self, places: [np.zeros(len(p.coordinates)) for p in places])
    begun = sample_worst(study, PlannerConfig(), SMALL.screened, keep=SMALL.lanes)
    found, again = (falsify(study, PlannerConfig(), search=SMALL) for _ in range(2))
    assert found == again
    assert found.worst[0].clearance < begun.worst[0].clearance
    assert all(a.clearance <= b.clearance for a, b in zip(found.worst, begun.worst, strict=True))


def test_bad_searches_are_refused(study):
    with pytest.raises(InputError, match=r"search.lanes = 9: must be >= 1 and <= search.screened = 8"):
        falsify(study, PlannerConfig(), search=Search(screened=8, lanes=9, aimed=()))


@pytest.mark.parametrize(
    ("change", "text"),
    [
        ({"rounds": -1}, "search.rounds = -1: must be a whole number >= 0"),
        ({"steps": ()}, "search.steps = (): must have at least one length"),
        ({"steps": (0.1, -0.1)}, "search.steps[1] = -0.1: must be > 0 and <= 2"),
        ({"window": 0}, "search.window = 0: must be a whole number >= 1"),
        ({"spread": float("nan")}, "search.spread = nan: must be finite"),
        ({"memory": 0.0}, "search.memory = 0.0: must be > 0"),
        ({"gradient_cost": -1.0}, "search.gradient_cost = -1.0: must be > 0"),
    ],
)
def test_bad_numbers_are_refused(study, change, text):
    with pytest.raises(InputError, match=re.escape(text)):
        falsify(study, PlannerConfig(), search=Search(**change))


def test_more_begun_than_drawn_are_refused(study):
    with pytest.raises(InputError, match=r"search.drawn = 4: must be >= search.screened = 16"):
        falsify(study, PlannerConfig(), search=Search(drawn=4))


def test_more_aims_than_scenarios_are_refused(study):
    with pytest.raises(InputError, match=r"search.aimed = 9: must be >= 1 and <= search.screened = 8"):
        falsify(study, PlannerConfig(), search=Search(screened=8, aimed=(9,)))


def test_aims_put_an_obstacle_in_the_way(study, no_episodes, monkeypatch):
    """Of a made-up clearance that is the distance of the first obstacle, where only aims are tried."""

    def clearance(place):
        return float(np.linalg.norm(np.array(place.spec.obstacles[0].position) - place.scenario.start[:2]))

    no_episodes.clearance = clearance
    search = dataclasses.replace(SMALL, drawn=8, screened=8, aimed=(8,), rounds=0, lanes=8)
    begun = sample_worst(study, PlannerConfig(), 8, keep=8)
    found = falsify(study, PlannerConfig(), search=search)
    assert np.mean([one.clearance for one in found.worst]) < np.mean([one.clearance for one in begun.worst]) - 0.05


def test_scenarios_that_promise_most_are_begun_with(study, no_episodes, monkeypatch):
    """Of a made-up clearance that is the least distance of an obstacle to the straight way."""

    def clearance(place):
        way = straight_motion(place.scenario, 0.5)
        return float(np.linalg.norm(way.obstacles - way.pose[:, None, :2], axis=-1).min())

    no_episodes.clearance = clearance
    search = dataclasses.replace(SMALL, aimed=(), rounds=0, lanes=6)
    same, many = (falsify(study, PlannerConfig(), search=dataclasses.replace(search, drawn=n)) for n in (6, 40))
    begun = sample_worst(study, PlannerConfig(), 6, keep=6)
    means = [np.mean([one.clearance for one in found.worst]) for found in (begun, same, many)]
    assert means[0] > max(means[1:]) + 0.05
    assert many.episodes == same.episodes == 6


@pytest.mark.slow
@pytest.mark.timeout(1800)
def test_in_earnest(study):
    """What is found is an episode that `simulate` runs."""
    config = PlannerConfig(horizon=Horizon(steps=5))
    found = falsify(study, config, seed=1, search=Search(screened=4, aimed=(2,), lanes=2, rounds=1))
    (worst, _) = found.worst
    again = simulate(build(worst.spec), config, seed=worst.seed, record=False).outcome
    clearance = min(float(again.min_object_clearance_m), float(again.min_robot_clearance_m))
    # Rounding differs outside of a batch.
    assert clearance == pytest.approx(worst.clearance, abs=0.01)
    begun = sample_worst(study, config, 4, seed=1, keep=2)
    assert all(a.clearance <= b.clearance for a, b in zip(found.worst, begun.worst, strict=True))
