"""Distributions: their values, their limits, and refusals of what is none."""

import math
from statistics import NormalDist

import numpy as np
import pytest

from jaxlocomanip import checked
from jaxlocomanip.checked import InputError
from jaxlocomanip.sampling.distributions import parse_distribution

QUANTILES = (np.arange(1000) + 0.5) / 1000


def number(field, value):
    return checked.number(field, value, -10.0, 10.0)


def values(given, check=number):
    distribution = parse_distribution("x", given, check)
    return [distribution.at(float(u)) for u in QUANTILES]


def test_constants_and_uniform_numbers():
    assert set(values(3)) == {3.0}
    drawn = np.array(values({"uniform": [-2, 6.0]}))
    assert drawn == pytest.approx(-2.0 + 8.0 * QUANTILES)


def test_logarithms_are_uniform():
    drawn = np.log(values({"log_uniform": [0.5, 2.0]}))
    assert drawn == pytest.approx(math.log(0.5) + 2.0 * math.log(2.0) * QUANTILES)


def test_normal_numbers_are_cut_off():
    drawn = np.array(values({"normal": [1.0, 2.0], "within": [0.0, 4.0]}))
    assert 0.0 <= drawn.min() < 0.01 and 3.99 < drawn.max() <= 4.0
    bell = NormalDist(1.0, 2.0)
    inside = bell.cdf(4.0) - bell.cdf(0.0)
    assert (drawn < 2.0).mean() == pytest.approx((bell.cdf(2.0) - bell.cdf(0.0)) / inside, abs=2e-3)
    assert set(values({"normal": [1.0, 0.0]})) == {1.0}
    assert max(values({"normal": [0.0, 1.0]})) <= 4.0


def test_whole_numbers_and_choices_are_equally_likely():
    drawn = values({"integer": [2, 4]})
    assert [drawn.count(k) for k in (2, 3, 4)] == pytest.approx([333, 333, 333], abs=1)
    names = values({"choice": ["a", "b"]}, lambda field, value: checked.one_of(field, value, ("a", "b")))
    assert [names.count(k) for k in ("a", "b")] == [500, 500]


@pytest.mark.parametrize(
    ("given", "expected"),
    [
        (11.0, "x = 11.0: must be >= -10 and <= 10"),
        ({}, "x = {}: must be a value or a table with one of uniform, log_uniform, normal, integer, choice"),
        ({"uniform": [0, 1], "normal": [0, 1]}, "x = .*: must be a value or a table with one of"),
        ({"unifrm": [0, 1]}, "x = .*: must be a value or a table with one of"),
        ({"uniform": [0, 1], "within": [0, 1]}, "x: unknown key 'within'"),
        ({"uniform": [1, 0]}, r"x.uniform = \[1, 0\]: the lower end must come first"),
        ({"uniform": [0, 11]}, r"x.uniform\[1\] = 11: must be >= -10"),
        ({"uniform": 3}, "x.uniform = 3: must be two numbers"),
        ({"uniform": ["a", "b"]}, r"x.uniform\[0\] = 'a': must be a number"),
        ({"log_uniform": [0.0, 1.0]}, r"x.log_uniform\[0\] = 0.0: must be > 0"),
        ({"integer": [0, 1.5]}, r"x.integer = \[0, 1.5\]: must be two whole numbers"),
        ({"choice": []}, r"x.choice = \[\]: must be a list of at least one value"),
        ({"choice": [1.0, 11.0]}, r"x.choice\[1\] = 11.0: must be >= -10"),
        ({"normal": [0.0]}, r"x.normal = \[0.0\]: must be 2 numbers"),
        ({"normal": [0.0, -1.0]}, r"x.normal\[1\] = -1.0: must be >= 0"),
        ({"normal": [0.0, 9.0]}, r"x.within\[0\] = -36.0: must be >= -10"),
        ({"normal": [0.0, 1.0], "within": [1.0, 2.0]}, "x.within = .*: must hold the mean, 0"),
    ],
)  # fmt: skip
def test_what_is_no_distribution_is_refused(given, expected):
    with pytest.raises(InputError, match=f"^{expected}"):
        parse_distribution("x", given, number)


@pytest.mark.parametrize("given", [{"uniform": [0, 4]}, {"log_uniform": [1, 4]}, {"normal": [2, 1], "within": [0, 4]}])
def test_whole_numbers_have_no_range_of_fractions(given):
    with pytest.raises(InputError, match=r"x\..*\[0\] = [01]\.0: must be a whole number"):
        parse_distribution("x", given, lambda field, value: checked.whole(field, value, 0, 9))


def test_a_one_sided_normal_ends_where_it_says():
    one_sided = parse_distribution("x", {"normal": [60.0, 1.0], "within": [60.0, 3600.0]}, lambda field, value: value)
    assert 60.0 <= one_sided.at(1e-300) < 60.001
    assert 65.0 < one_sided.at(math.nextafter(1.0, 0.0)) < 100.0
