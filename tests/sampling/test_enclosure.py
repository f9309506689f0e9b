"""Starts that cannot be left and goals that cannot be come to, by a team that pushes and turns only on its way."""

import pytest

from jaxlocomanip.robots.model import load_robot
from jaxlocomanip.sampling.passage import obstruction
from jaxlocomanip.specification import parse_scenario

BASE = {
    "name": "small",
    "object": {"size": [0.5, 0.5], "mass": 6.0},
    "start": {"pose": [0.0, 0.0, 0.0]},
    "goal": {"pose": [4.0, 3.0, 0.0]},
    "robots": [{"type": "aliengo", "face": "-x"}, {"type": "aliengo", "face": "-y"}],
}


def box(x, y, width, height):
    return {"shape": "box", "position": [x, y], "size": [width, height]}


def corner(x, y, gap):
    """Walls ahead and to the left of an object at a place."""
    return [box(x + 0.45 + gap, y, 0.4, 1.2), box(x, y + 0.45 + gap, 1.2, 0.4)]


def found(obstacles, **tables):
    return obstruction(parse_scenario(BASE | {"obstacles": obstacles} | tables))


@pytest.mark.parametrize("gap", [0.01, 0.03, 0.05])
def test_a_corner_that_the_team_pushes_into_is_not_left(gap):
    assert found(corner(0.0, 0.0, gap)) == "start"


@pytest.mark.parametrize("gap", [0.01, 0.05, 0.1])
def test_two_blocks_no_larger_than_the_object_enclose_it_as_well(gap):
    blocks = [box(0.45 + gap, 0.0, 0.4, 0.5), box(0.0, 0.45 + gap, 0.5, 0.4)]
    assert found(blocks) == "start"
    for block in blocks:
        assert found([block]) == ("narrow" if gap < 0.03 else None)


def test_a_wall_ahead_is_passed_by_pushing_along_it():
    for gap, expected in ((0.03, "narrow"), (0.06, None)):
        ahead, aside = corner(0.0, 0.0, gap)
        assert found([ahead]) == expected
        assert found([aside]) == expected
    # One robot behind the object has nothing to push it aside with.
    alone = {"robots": BASE["robots"][:1], "goal": {"pose": [4.0, 0.0, 0.0]}}
    assert found([ahead], **alone) == "start"
    assert found([aside], **alone) is None


def test_four_robots_leave_a_corner():
    faces = [{"type": "aliengo", "face": face} for face in ("-x", "-y", "+x", "+y")]
    assert found([box(0.45, 0.45, 0.3, 0.3)], robots=faces) is None
    small = [{"type": "a1", "face": face} for face in ("-x", "-y", "+x")]
    assert found([corner(0.0, 0.0, 0.03)[1]], robots=small) == "narrow"
    assert found([corner(0.0, 0.0, 0.06)[1]], robots=small) is None


@pytest.mark.parametrize(("gap", "expected"), [(0.04, "narrow"), (0.2, None)])
def test_a_goal_among_walls_on_all_sides_is_not_come_to(gap, expected):
    back, front = 0.25 + 2.0 * load_robot("aliengo").reach + gap, 0.25 + gap
    behind = [box(4.0 - back - 0.05, 3.0, 0.1, 2.0), box(4.0, 3.0 - back - 0.05, 2.0, 0.1)]
    ahead = [box(4.0 + front + 0.1, 3.0, 0.2, 2.0), box(4.0, 3.0 + front + 0.1, 2.0, 0.2)]
    assert found(behind + ahead) in ("goal", "blocked")
    # From above the team comes in turned, and turns back on its way.
    assert found(behind) is None
    assert found(behind + ahead[:1]) == expected


def test_a_dead_end_too_narrow_for_the_robots_is_no_goal():
    # Room for the object and for the robot behind it, but not for the one at its side.
    alley = [box(3.4, 3.0 + sign * 0.48, 2.0, 0.3) for sign in (-1.0, 1.0)] + [box(4.45, 3.0, 0.1, 1.26)]
    assert found(alley[1:]) is None
    assert found(alley) in ("goal", "blocked")


def test_goals_with_wide_tolerances_and_close_by_are_not_judged_by_their_corners():
    wide = {"goal": {"pose": [4.0, 3.0, 0.0], "position_tolerance": 1.0}}
    assert found(corner(4.0, 3.0, 0.01), **wide) is None
    assert found(corner(0.0, 0.0, 0.01), goal={"pose": [0.05, 0.05, 0.0]}) is None
