"""How tightly a team turns an object: quasi-statically to be sure of it, with its inertia to be sure of no more."""

import math

import numpy as np
import pytest

from jaxlocomanip.footprint import footprint_moments
from jaxlocomanip.sampling.flood import HEADINGS, Grid, lenient_rules, strict_rules
from jaxlocomanip.sampling.pushing import offset_limits, pushing
from jaxlocomanip.specification import parse_scenario

BASE = {
    "name": "turning",
    "object": {"size": [0.5, 0.5], "mass": 6.0},
    "start": {"pose": [0.0, 0.0, 0.0]},
    "goal": {"pose": [4.0, 3.0, 0.0]},
    "robots": [{"type": "aliengo", "face": "-x"}],
}
GRID = Grid(0.05, 1, np.zeros(2), (8, 8), 0.0, 2.0 * math.pi / HEADINGS)


def able(**tables):
    spec = parse_scenario(BASE | tables)
    return spec, pushing(spec)


def test_curvature_is_that_of_a_push_at_the_end_of_the_face():
    spec, team = able()
    moments = footprint_moments(np.array(spec.object.footprint))
    assert team.curvature == pytest.approx(offset_limits(spec)[0] / moments.mean_radius**2)


def test_curvature_is_possible_to_both_sides_in_all_directions():
    # The centre of mass is off the middle of the face "-x", and robots at two faces turn more together than either.
    com = {"truth": {"com": [0.0, 0.06]}}
    spec, team = able(**com, robots=[{"type": "aliengo", "face": face} for face in ("-x", "-y")])
    square, limit = footprint_moments(np.array(spec.object.footprint)).mean_radius ** 2, offset_limits(spec)[0]
    assert team.curvature == pytest.approx((limit - 0.06) / square)
    assert team.bound >= math.hypot(limit, limit + 0.06) / square
    # A second robot on that face has the same ends of it.
    _, three = able(**com, robots=[{"type": "aliengo", "face": face} for face in ("-x", "-x", "-y")])
    assert three.curvature == pytest.approx(team.curvature)


def test_inertia_loosens_the_bound_and_not_the_curvature():
    _, light = able()
    _, heavy = able(truth={"inertia": 3.0 * 6.0 * 0.5**2 / 6.0})
    assert heavy.curvature == light.curvature
    assert heavy.bound > 2.0 * heavy.curvature
    assert light.bound >= light.curvature


def test_only_the_refuting_flood_turns_by_the_bound():
    _, heavy = able(truth={"inertia": 3.0 * 6.0 * 0.5**2 / 6.0})
    per_step = GRID.cell / GRID.bin
    strict, lenient = strict_rules(heavy, GRID, 1), lenient_rules(heavy, GRID, 2)
    assert strict.bins and strict.bins[0] == math.floor(heavy.curvature * per_step)
    assert lenient.bins and lenient.bins[0] == math.ceil(heavy.bound * per_step)


def test_teams_that_turn_on_the_spot_have_no_bound():
    _, opposed = able(robots=[{"type": "aliengo", "face": face} for face in ("-x", "+x")])
    assert math.isinf(opposed.curvature) and math.isinf(opposed.bound)


def test_a_robot_alone_has_a_step_at_every_heading():
    _, alone = able()
    words = [int(step.bits) for step in strict_rules(alone, GRID, 1).steps]
    taken = 0
    for word in words:
        taken |= word
    assert taken == 2**HEADINGS - 1
