"""The way between standing obstacles: found where there is one, and missed where there is clearly none."""

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
FOUR = [{"type": "aliengo", "face": face} for face in ("-x", "-y", "+x", "+y")]


def box(x, y, width, height, yaw=0.0):
    return {"shape": "box", "position": [x, y], "size": [width, height], "yaw": yaw}


def found(obstacles, **tables):
    return obstruction(parse_scenario(BASE | {"obstacles": obstacles} | tables))


def is_blocked(obstacles, **tables):
    return found(obstacles, **tables) is not None


def test_open_floors_are_open():
    assert not is_blocked([])
    assert not is_blocked([box(2.0, 1.5, 0.5, 0.5)])
    assert not is_blocked([box(2.0, 1.5, 0.5, 3.0, yaw=2.2)])


def test_a_ring_is_closed_and_a_ring_with_a_door_is_open():
    ring = [box(4.0, 1.2, 4.0, 0.2), box(4.0, 4.8, 4.0, 0.2), box(2.0, 3.0, 0.2, 3.4), box(6.0, 3.0, 0.2, 3.4)]
    assert is_blocked(ring)
    assert is_blocked(ring, robots=FOUR)
    wide = [box(4.0, 0.5, 6.0, 0.2), box(4.0, 5.5, 6.0, 0.2), box(7.0, 3.0, 0.2, 4.8)]
    assert not is_blocked(wide)


def room(*inside):
    """A closed room of 9 m x 5 m about start and goal."""
    walls = [box(2.0, y, 9.4, 0.2) for y in (-2.6, 2.6)] + [box(x, 0.0, 0.2, 5.0) for x in (-2.6, 6.6)]
    return [*walls, *inside]


def divided(gap, depth):
    """The room with a wall across that has a gap in the middle."""
    side = 0.5 * (5.0 - gap)
    return room(*[box(2.0, sign * 0.5 * (gap + side), depth, side) for sign in (-1.0, 1.0)])


AHEAD = {"pose": [4.5, 0.0, 0.0]}


@pytest.mark.parametrize(("gap", "expected"), [(0.3, True), (1.8, False), (2.5, False)])
def test_doors_have_to_be_as_wide_as_the_object(gap, expected):
    assert is_blocked(divided(gap, 0.3), goal=AHEAD) == expected


def test_robots_beside_the_object_need_room_too():
    # Wide enough for the box and for a robot behind it, but not for one at its side.
    corridor = divided(0.6, 2.0)
    assert is_blocked(corridor, goal=AHEAD)
    assert not is_blocked(corridor, goal=AHEAD, robots=[{"type": "aliengo", "face": "-x"}])


def beside_the_team(room_left):
    """A corridor 2 m long, so much wider than an object with a robot at its right side."""
    left, right = 0.25 + 0.5 * room_left, 0.25 + 2.0 * load_robot("aliengo").reach + 0.5 * room_left
    return room(*[box(2.0, 0.5 * (y + sign * 2.5), 2.0, 2.5 - sign * y) for sign, y in ((1.0, left), (-1.0, -right))])


def test_corridors_hardly_wider_than_the_team_are_narrow():
    alone = {"robots": BASE["robots"][:1], "goal": AHEAD}
    for room_left in (0.01, 0.02):
        assert found(beside_the_team(room_left), goal=AHEAD) == "narrow"
        assert found(divided(0.5 + room_left, 2.0), **alone) == "narrow"
    assert found(beside_the_team(-0.3), goal=AHEAD) == "blocked"
    assert found(beside_the_team(0.15), goal=AHEAD) is None
    assert found(divided(0.5 + 0.15, 2.0), **alone) is None


def test_a_start_with_an_obstacle_close_by_is_no_corridor():
    back = 0.25 + 2.0 * load_robot("aliengo").reach
    assert found([box(-back - 0.005 - 0.2, 0.0, 0.4, 2.0)]) is None


def test_a_team_that_cannot_pull_cannot_back_out():
    dead_end = [box(-1.0, 0.5, 4.4, 0.2), box(-1.0, -0.5, 4.4, 0.2), box(1.3, 0.0, 0.2, 1.2)]
    goal = {"pose": [-5.0, 0.0, 0.0]}
    behind = {"type": "aliengo", "face": "-x"}
    assert is_blocked(dead_end, goal=goal, robots=[behind])
    assert not is_blocked(dead_end, goal=goal, robots=[behind, {"type": "aliengo", "face": "+x"}])


def test_moving_obstacles_do_not_block():
    wall = box(2.0, 0.0, 0.3, 5.0)
    assert is_blocked(room(wall), goal=AHEAD)
    assert not is_blocked(room(wall | {"velocity": [0.1, 0.0]}), goal=AHEAD)


def test_the_answer_does_not_depend_on_the_frame():
    turn = 1.5707963
    poses = {"start": {"pose": [10.0, 5.0, turn]}, "goal": {"pose": [10.0, 9.5, turn]}}
    for gap in (0.3, 1.8):
        turned = [box(10.0 - o["position"][1], 5.0 + o["position"][0], *o["size"], yaw=turn) for o in divided(gap, 0.3)]
        assert is_blocked(turned, **poses) == is_blocked(divided(gap, 0.3), goal=AHEAD)


def test_polygons_block_like_boxes():
    corners = [[-0.2, -2.5], [0.2, -2.5], [0.2, 2.5], [-0.2, 2.5]]
    wall = {"shape": "polygon", "position": [2.0, 0.0], "vertices": corners}
    assert is_blocked(room(wall), goal=AHEAD)
    assert not is_blocked(room(wall | {"position": [2.0, 4.0]}), goal=AHEAD)
