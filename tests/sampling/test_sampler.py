"""Lanes of a study: always the same, always feasible, and counted where they were not."""

import subprocess
import sys
from collections import Counter

import jax
import numpy as np
import pytest

from jaxlocomanip.build import build
from jaxlocomanip.checked import InputError
from jaxlocomanip.sampling import passage, study
from jaxlocomanip.sampling.clearance import floor_of
from jaxlocomanip.sampling.feasibility import REASONS
from jaxlocomanip.sampling.pushing import pushing
from jaxlocomanip.sampling.sampler import draw, sample
from jaxlocomanip.sampling.study import find_study, parse_study
from jaxlocomanip.scenario import Scenario


def test_a_lane_is_the_same_in_any_order():
    standard = find_study("standard")
    forwards = [draw(standard, 0, lane).spec for lane in range(8)]
    backwards = [sample("standard", 0, lane) for lane in reversed(range(8))]
    assert forwards == backwards[::-1]
    assert len(set(forwards)) == 8
    assert sample("standard", 1, 0) != forwards[0]


def test_a_lane_is_the_same_in_another_process():
    code = "from jaxlocomanip.sampling.sampler import sample; print(repr(sample('moving', 5, 77)))"
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, check=True, text=True)
    assert done.stdout.strip() == repr(sample("moving", 5, 77))


@pytest.mark.parametrize("name", study.names())
def test_lanes_are_checked_scenarios_with_their_arrays(name):
    found = find_study(name)
    for lane in range(len(found.points) if len(found.points) < 10 else 4):
        drawn = draw(found, 0, lane)
        assert drawn.spec.name == f"{name}-{lane:06d}"
        assert set(drawn.rejected) <= set(REASONS)
        expected = build(drawn.spec, lane)
        assert isinstance(drawn.scenario, Scenario)
        for host, device in zip(jax.tree.leaves(drawn.scenario), jax.tree.leaves(expected), strict=True):
            assert host.dtype == device.dtype and np.array_equal(host, device)


def test_rejections_are_counted():
    standard = find_study("standard")
    counts = sum((Counter(draw(standard, 0, lane).rejected) for lane in range(40)), Counter())
    assert counts["capacity"] > 0 and counts["start"] > 0


def test_accepted_lanes_have_a_way_with_room():
    # Most of them were accepted by the coarse flood alone.
    # The last one starts so close to an obstacle that a coarse step would get past it.
    for seed, lane in [*((2, lane) for lane in range(30)), (1000, 1159)]:
        spec = sample("standard", seed, lane)
        assert not spec.obstacles or passage._way_with_room(spec, pushing(spec)), (seed, lane)


def test_an_impossible_study_says_so(monkeypatch):
    monkeypatch.setattr("jaxlocomanip.sampling.sampler.MOST_ATTEMPTS", 20)
    heavy = parse_study('name = "heavy"\n[truth]\nmass_ratio = 10.0\nfriction = 0.9\n')
    with pytest.raises(InputError, match=r"heavy: lane 3 has no feasible scenario in 20 attempts \(20 x capacity\)"):
        draw(heavy, 0, 3)


@pytest.mark.parametrize(("seed", "index"), [(-1, 0), (2**64, 0), (0, -1), (0, 2**31), (0.5, 0), (0, True)])
def test_bad_seeds_and_indices_are_refused(seed, index):
    with pytest.raises(InputError, match="must be a whole number"):
        sample("standard", seed, index)


@pytest.mark.slow
def test_the_searches_for_a_way_never_contradict_the_one_for_none(monkeypatch):
    """Where discs around the bodies pass, discs inside them pass as well."""
    asked = []

    def both(find):
        def found(spec, *others):
            if not find(spec, *others):
                return False
            asked.append(passage.way_within(spec, floor_of(spec), pushing(spec)))
            return True

        return found

    for name in ("_way_around", "_way_with_room"):
        monkeypatch.setattr(passage, name, both(getattr(passage, name)))
    for lane in range(300):
        sample("standard", 9, lane)
    assert len(asked) > 200 and all(asked)
