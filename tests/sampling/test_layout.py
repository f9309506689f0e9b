"""From draws to scenario tables: teams, goals within reach, obstacles about the straight line, motions."""

import math

import numpy as np
import pytest

from jaxlocomanip.obstacles import position_at
from jaxlocomanip.sampling.draws import Draws
from jaxlocomanip.sampling.layout import push_cone, scenario_tables, team_size
from jaxlocomanip.sampling.study import find_study, parse_study
from jaxlocomanip.specification import parse_scenario


def specs(text, count=50):
    study = parse_study(text)
    return [parse_scenario(scenario_tables(study, Draws(0, lane))) for lane in range(count)]


@pytest.mark.parametrize(
    ("angles", "low", "width"),
    [
        ([0.0], 0.0, 0.0),
        ([0.0, 0.5 * math.pi], 0.0, 0.5 * math.pi),
        ([0.25 * math.pi, -0.25 * math.pi], 1.75 * math.pi, 0.5 * math.pi),
        ([0.0, 0.5 * math.pi, math.pi], 0.0, math.pi),
        ([0.0, 0.5 * math.pi, math.pi, 1.5 * math.pi], -math.pi, 2.0 * math.pi),
        ([0.0, 2.0, 4.0], -math.pi, 2.0 * math.pi),
    ],
)  # fmt: skip
def test_the_cone_of_pushes(angles, low, width):
    assert push_cone(angles) == pytest.approx((low, width))


def test_goals_lie_where_the_team_can_push():
    normals = {"-x": (1.0, 0.0), "-y": (0.0, 1.0), "+x": (-1.0, 0.0), "+y": (0.0, -1.0)}
    seen = set()
    for spec in specs('name = "a"\nextends = "standard"', 100):
        way = np.array(spec.goal.pose[:2]) - spec.start[:2]
        assert 4.0 <= np.linalg.norm(way) <= 7.0
        pushes = np.array([normals[robot.face] for robot in spec.robots])
        assert (pushes @ way >= -1e-9).all()
        assert abs(pushes[0] @ pushes[1]) < 1e-9
        assert abs(spec.goal.pose[2]) <= 0.5
        seen.add(tuple(robot.face for robot in spec.robots))
    assert len(seen) == 4


def test_the_goal_turns_with_the_start():
    text = 'name = "a"\n[start]\nx = 2.0\nheading = 0.7\n[goal]\nheading = 0.2\nbearing = 0.0\ndistance = 3.0'
    (spec,) = specs(text, 1)
    assert spec.start == (2.0, 0.0, 0.7)
    angle = 0.7 - 0.0  # the first face is -x, and the next one counter-clockwise -y: pushes along +x and +y
    assert spec.goal.pose == pytest.approx((2.0 + 3.0 * math.cos(angle), 3.0 * math.sin(angle), 0.9))


def test_truth_follows_the_belief():
    text = 'name = "a"\n[truth]\nmass_ratio = 1.5\nfriction = 0.3\ncom_offset = 0.2\ninertia_ratio = 2.0'
    (spec,) = specs(text, 1)
    assert (spec.truth.mass, spec.truth.friction) == (9.0, 0.3)
    assert spec.truth.com == pytest.approx((0.05, 0.05))
    central = 9.0 * 0.5**2 / 6.0
    assert spec.truth.inertia == pytest.approx(2.0 * central + 9.0 * 2 * 0.05**2, rel=1e-3)


def test_obstacles_lie_about_the_straight_line():
    for spec in specs('name = "a"\nextends = "standard"', 100):
        assert 2 <= len(spec.obstacles) <= 4
        way = np.array(spec.goal.pose[:2])
        ahead = way / np.linalg.norm(way)
        for obstacle in spec.obstacles:
            along = np.dot(obstacle.position, ahead)
            lateral = np.dot(obstacle.position, [-ahead[1], ahead[0]])
            assert 0.0 <= along <= np.linalg.norm(way) and abs(lateral) <= 1.5
            sizes = [obstacle.radius] if obstacle.shape == "circle" else [s / 2.0 for s in obstacle.size]
            assert all(0.2 <= size <= 0.5 for size in sizes)


def test_fixed_obstacles_come_last_and_are_turned_into_the_line():
    text = """
    name = "a"
    [goal]
    distance = 4.0
    bearing = 1.0
    [obstacles]
    count = 1
    fixed = [{ shape = "box", along = 0.5, lateral = 1.0, half_size = [0.2, 0.3], yaw = 0.1 }]
    """
    (spec,) = specs(text, 1)
    drawn, fixed = spec.obstacles
    assert drawn.position == pytest.approx((0.0, 2.0))
    assert fixed.position == pytest.approx((-1.0, 2.0))
    assert (fixed.size, fixed.yaw) == (pytest.approx((0.4, 0.6)), pytest.approx(0.5 * math.pi + 0.1))


def test_moving_obstacles_are_no_faster_than_stated():
    kinds = set()
    for spec in specs('name = "a"\nextends = "moving"', 100):
        moving = [o for o in spec.obstacles if o.motion or o.velocity != (0.0, 0.0)]
        assert 1 <= len(moving) <= 3
        for obstacle in moving:
            kinds.add(obstacle.motion.kind if obstacle.motion else "line")
            ways = np.diff([position_at(obstacle, t) for t in np.arange(0.0, 30.0, 0.1)], axis=0)
            assert np.linalg.norm(ways, axis=1).max() / 0.1 <= 0.5 + 1e-9
    assert kinds == {"line", "sine"}


def test_obstacles_on_lines_pass_their_place_at_the_meeting():
    text = """
    name = "a"
    [goal]
    distance = 4.0
    bearing = 0.0
    [obstacles]
    count = 2
    lateral = 0.5
    [motion]
    count = 1
    speed = 0.4
    heading = 1.0
    meeting = 6.0
    """
    (spec,) = specs(text, 1)
    assert position_at(spec.obstacles[0], 6.0) == pytest.approx((2.0, 0.5))
    assert spec.obstacles[0].velocity == pytest.approx((0.4 * math.cos(1.0), 0.4 * math.sin(1.0)))
    assert spec.obstacles[1].velocity == (0.0, 0.0)


def test_points_of_a_grid_get_the_same_draws():
    text = 'name = "a"\nextends = "standard"\n[[axes]]\nparameter = "truth.friction"\nvalues = [0.2, 0.3]'
    first, second, third = specs(text, 3)
    assert (first.truth.friction, second.truth.friction) == (0.2, 0.3)
    assert first.obstacles == second.obstacles != third.obstacles


def test_team_sizes_are_known_before_a_lane_is_drawn():
    study = find_study("turn")
    sizes = {team_size(study, 0, lane) for lane in range(50)}
    assert sizes == {3, 4}
    for lane in range(20):
        for attempt in range(3):
            tables = scenario_tables(study, Draws(0, lane, attempt))
            assert len(tables["robots"]) == team_size(study, 0, lane)


def test_listed_faces_decide_the_size():
    study = parse_study('name = "a"\n[team]\nsize = 2\nfaces = ["-x", "+y", "-y"]')
    assert team_size(study, 0, 0) == 3
    assert [robot["face"] for robot in scenario_tables(study, Draws(0, 0))["robots"]] == ["-x", "+y", "-y"]
