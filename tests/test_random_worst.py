"""Random sampling on a made-up clearance: what is counted, kept and refused."""

import re

import pytest

from jaxlocomanip import random_worst
from jaxlocomanip.checked import InputError
from jaxlocomanip.planner.config import PlannerConfig
from jaxlocomanip.random_worst import sample_worst
from jaxlocomanip.sampling.study import parse_study
from jaxlocomanip.variation import Bounds


@pytest.fixture(scope="module")
def study(breaking):
    return parse_study(breaking)


def test_random_sampling_begins_with_the_same_scenarios(study, no_episodes):
    few = sample_worst(study, PlannerConfig(), 4, keep=4)
    more = sample_worst(study, PlannerConfig(), 8, keep=8)
    assert {one.spec for one in few.worst} < {one.spec for one in more.worst}
    other = sample_worst(study, PlannerConfig(), 4, seed=1, keep=4)
    assert not {one.spec for one in few.worst} & {one.spec for one in other.worst}


def test_collisions_are_counted_among_all_random_scenarios(study, no_episodes):
    every, few = (sample_worst(study, PlannerConfig(), 20, keep=n) for n in (20, 2))
    collided, touched = (sum(one.clearance < limit for one in every.worst) for limit in (0.0, no_episodes.touching))
    assert 2 < collided < touched <= 20
    assert every.touches == few.touches == touched
    assert (every.collisions, every.counted) == (few.collisions, few.counted) == (collided, 20)
    assert few.worst == every.worst[:2]


@pytest.mark.parametrize(
    ("change", "text"),
    [
        ({"episodes": 0}, "episodes = 0: must be a whole number >= 1"),
        ({"keep": 0}, "keep = 0: must be a whole number >= 1"),
        ({"seed": -1}, "seed = -1: must be a whole number >= 0"),
        ({"bounds": Bounds(friction=(0.5, 0.2))}, "bounds.friction[1] = 0.2: must be >= 0.5"),
    ],
)
def test_bad_random_samples_are_refused(study, change, text):
    with pytest.raises(InputError, match=re.escape(text)):
        sample_worst(study, PlannerConfig(), **({"episodes": 8} | change))


def test_studies_without_scenarios_within_the_bounds_are_refused(study, monkeypatch):
    monkeypatch.setattr(random_worst, "place_at", lambda *_: None)
    with pytest.raises(InputError, match="breaking: hardly any of its scenarios"):
        sample_worst(study, PlannerConfig(), 1)


def test_what_is_there_after_every_batch_is_kept(study, no_episodes):
    batches = []
    sample_worst(study, PlannerConfig(), 20, keep=3, kept=batches.append)
    assert [(one.episodes, len(one.worst)) for one in batches] == [(8, 3), (16, 3), (20, 3)]
