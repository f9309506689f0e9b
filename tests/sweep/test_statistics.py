"""Clopper-Pearson intervals are exact."""

import math

import numpy as np
import pytest

from jaxlocomanip.sweep.statistics import clopper_pearson, percent


def at_least(k, n, p):
    """Probability of k or more successes in n trials."""
    return math.fsum(math.comb(n, i) * p**i * (1.0 - p) ** (n - i) for i in range(k, n + 1))


@pytest.mark.parametrize(("successes", "trials"), [(1, 10), (5, 10), (97, 100), (499, 500)])
def test_the_ends_leave_half_the_error_on_each_side(successes, trials):
    rate = clopper_pearson(successes, trials)
    assert rate.share == successes / trials
    assert at_least(successes, trials, rate.low) == pytest.approx(0.025, rel=1e-6)
    assert 1.0 - at_least(successes + 1, trials, rate.high) == pytest.approx(0.025, rel=1e-6)


def test_all_and_none_are_one_sided():
    assert clopper_pearson(0, 20) == pytest.approx((0.0, 0.0, 1.0 - 0.025 ** (1 / 20)))
    assert clopper_pearson(20, 20) == pytest.approx((1.0, 0.025 ** (1 / 20), 1.0))


def test_more_confidence_and_fewer_trials_widen():
    assert clopper_pearson(9, 10).low < clopper_pearson(90, 100).low
    assert clopper_pearson(9, 10, 0.99).low < clopper_pearson(9, 10, 0.9).low


def test_intervals_cover_the_truth_at_least_as_often_as_they_say():
    rng = np.random.default_rng(0)
    for truth in (0.02, 0.5, 0.97):
        intervals = [clopper_pearson(int(k), 50) for k in rng.binomial(50, truth, 1000)]
        assert np.mean([rate.low <= truth <= rate.high for rate in intervals]) >= 0.94


def test_percents_show_as_many_digits_as_they_have():
    assert percent(5, 10) == "50.0 [18.7, 81.3]"
    assert percent(9990, 10000) == "99.90 [99.82, 99.95]"
    assert percent(0, 0) == "-"
