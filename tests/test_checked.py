"""Checks of user input: what passes, and that a refusal is one line with field, value and what is allowed."""

import math

import pytest

from jaxlocomanip import checked
from jaxlocomanip.checked import InputError

SQUARE = [[0, 0], [1, 0], [1, 1], [0, 1]]


def refusal(check, *arguments, **options):
    with pytest.raises(InputError) as caught:
        check(*arguments, **options)
    assert "\n" not in str(caught.value)
    return str(caught.value)


def test_nearest_hints_only_at_near_names():
    assert checked.nearest("mas", ["mass", "height"]) == "; did you mean 'mass'?"
    assert checked.nearest("zzz", ["mass", "height"]) == ""


def test_one_of():
    assert checked.one_of("type", "a1", ("a1", "go1")) == "a1"
    assert refusal(checked.one_of, "type", "g1", ("a1", "go1")).startswith("type = 'g1': must be one of a1, go1")
    assert "must be one of" in refusal(checked.one_of, "type", ["a1"], ("a1", "go1"))


def test_known_keys():
    table = {"mass": 1.0}
    assert checked.known_keys("object", table, ("mass", "height"), ("mass",)) is table
    text = refusal(checked.known_keys, "object", {"mas": 1.0}, ("mass", "height"))
    assert text == "object: unknown key 'mas'; did you mean 'mass'? (allowed: mass, height)"
    assert refusal(checked.known_keys, "object", {}, ("mass",), ("mass",)) == "object: missing key 'mass'"
    assert refusal(checked.known_keys, "object", 3, ("mass",)) == "object = 3: must be a table"


def test_number_keeps_values_within_bounds():
    assert checked.number("x", 3) == 3.0
    assert isinstance(checked.number("x", 3), float)
    assert checked.number("x", 1.0, 1.0, 2.0) == 1.0
    assert checked.number("x", 2.0, 1.0, 2.0, strictly=True) == 2.0


@pytest.mark.parametrize(
    ("value", "bounds", "allowed"),
    [
        (-1, {"low": 0.0}, "must be >= 0"),
        (0, {"low": 0.0, "strictly": True}, "must be > 0"),
        (3, {"low": 0.0, "high": 2.0}, "must be >= 0 and <= 2"),
        (3, {"high": 2.0}, "must be <= 2"),
        (math.nan, {}, "must be finite"),
        (1e39, {}, "must be at most 1e+09 in size"),
        (1e-40, {"low": 0.0, "strictly": True}, "must be at least 1e-06"),
        (-math.inf, {}, "must be finite"),
        (True, {}, "must be a number"),
        ("1", {}, "must be a number"),
        (None, {}, "must be a number"),
    ],
)
def test_number_refuses(value, bounds, allowed):
    assert refusal(checked.number, "x", value, **bounds) == f"x = {value!r}: {allowed}"


def test_vector():
    assert checked.vector("pose", [1, 2.5], 2) == (1.0, 2.5)
    assert refusal(checked.vector, "pose", [1, 2], 3) == "pose = [1, 2]: must be 3 numbers"
    assert refusal(checked.vector, "pose", 1.0, 1) == "pose = 1.0: must be 1 numbers"
    assert refusal(checked.vector, "pose", [0, math.nan], 2) == "pose[1] = nan: must be finite"


def test_points():
    assert checked.points("p", [[0, 1]], 1) == ((0.0, 1.0),)
    assert "must be a list of at least 2 points" in refusal(checked.points, "p", [[0, 1]], 2)
    assert refusal(checked.points, "p", [[0, 1], [2]], 2) == "p[1] = [2]: must be 2 numbers"


def test_convex_polygon_keeps_vertices():
    assert checked.convex_polygon("f", SQUARE) == ((0.0, 0.0), (1.0, 0.0), (1.0, 1.0), (0.0, 1.0))


@pytest.mark.parametrize(
    "vertices",
    [
        SQUARE[::-1],
        [[0, 0], [1, 0], [1, 1], [0.9, 0.1]],
        [[0, 0], [1, 0], [2, 0], [1, 1]],
        [[0, 0], [0, 0], [1, 0], [1, 1]],
        [[math.cos(4 * math.pi * k / 5), math.sin(4 * math.pi * k / 5)] for k in range(5)],
        SQUARE[:2],
    ],
    ids=["clockwise", "dented", "collinear", "repeated", "star", "two points"],
)
def test_convex_polygon_refuses(vertices):
    assert refusal(checked.convex_polygon, "f", vertices).startswith("f")


def test_integers_beyond_any_float_are_refused_in_short():
    assert refusal(checked.number, "duration", 10**400) == (
        "duration = an integer of 1329 bits: must be at most 1e+09 in size"
    )


@pytest.mark.parametrize("name", ["", "a/b", ".hidden", "two\nlines", "x" * 300, 3])
def test_names_that_no_file_can_have_are_refused(name):
    text = refusal(checked.name, "name", name)
    assert "must be a text usable as a file name" in text and len(text) < 250


def test_counts_are_whole_and_bounded():
    assert checked.count("rounds", 0, 0) == 0 and checked.count("rounds", checked.MOST) == checked.MOST
    for value in (0, 2.5, True, checked.MOST + 1):
        with pytest.raises(InputError, match="must be a whole number >= 1 and <= 1000000"):
            checked.count("rounds", value)
