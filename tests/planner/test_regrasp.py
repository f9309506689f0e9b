"""Other faces: when the search has the team walk around the object, and when it does not."""

import dataclasses

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from jaxlocomanip import build_scenario, find_scenario, find_study
from jaxlocomanip.obstacle_spec import ObstacleSpec
from jaxlocomanip.planner import adaptation, estimation, regrasp, search
from jaxlocomanip.planner.config import PlannerConfig
from jaxlocomanip.planner.search import Query
from jaxlocomanip.planner.shapes import shapes_of
from jaxlocomanip.sampling.sampler import draw

CONFIG = PlannerConfig()
SPEC = dataclasses.replace(find_scenario("adaptive"), change_faces=True, obstacles=())
AWAY = (40.0, 40.0)
KNOWN = jnp.zeros((1, 3))
"""covariance of an obstacle of which all is known"""


def obstacle(place, size=(0.6, 0.6)):
    half = np.array(size) / 2.0
    corners = tuple(tuple(float(v) for v in half * sign) for sign in ((-1, -1), (1, -1), (1, 1), (-1, 1)))
    return ObstacleSpec(shape="box", position=place, size=size, vertices=corners)


def scenario_to(goal, places=(AWAY,), **changes):
    """Two robots, at -x and -y, push a box from the origin."""
    return build_scenario(
        dataclasses.replace(
            SPEC,
            goal=dataclasses.replace(SPEC.goal, pose=goal),
            obstacles=tuple(obstacle(place) for place in places),
            **changes,
        )
    )


@jax.jit
def find(scenario, config, stuck):
    seen = estimation.start_obstacles(scenario.obstacles.at(jnp.zeros(())), config.estimation)
    body = adaptation.start(scenario.object, config.adaptation).body
    none, zero = jnp.zeros((), jnp.int32), jnp.zeros(())
    query = Query(scenario.start, scenario.team.offset, scenario.goal, none, stuck, ~NO, zero, none)
    return search.search_poses(query, shapes_of(scenario), scenario.formations, seen, body, config)


@jax.jit
def room(scenario, pose, wanted, spread=KNOWN):
    seen = estimation.start_obstacles(scenario.obstacles.at(jnp.zeros(())), CONFIG.estimation)
    seen = dataclasses.replace(seen, velocity=scenario.obstacles.velocity, covariance=spread)
    none, shapes = jnp.zeros((), jnp.int32), shapes_of(scenario)
    offset = scenario.team.offset
    return regrasp.room_to_walk(pose, offset, none, wanted, shapes, scenario.formations, seen, CONFIG)


NO = jnp.zeros((), bool)


def test_a_goal_ahead_is_pushed_to_with_the_faces_of_the_start():
    found = find(scenario_to((4.0, 4.0, 0.0)), CONFIG, NO)
    assert int(found.aim.formation) == 0 and float(found.aim.beyond) == 0.0
    np.testing.assert_allclose(found.poses[-1, :2], [4.0, 4.0], atol=0.15)


def test_a_goal_in_the_shadow_of_obstacles_is_pushed_to_from_other_faces():
    """From the faces of the start it takes a loop of 13 m past four obstacles; over other faces 6 m do."""
    scenario = jax.tree.map(jnp.asarray, draw(find_study("standard"), 2, 132).scenario)
    found = find(scenario, CONFIG, NO)
    assert int(found.aim.formation) in (1, 3)
    way = float(jnp.sum(jnp.linalg.norm(jnp.diff(found.poses[:, :2], axis=0), axis=1)))
    assert way + float(found.aim.beyond) < 12.0
    assert float(room(scenario, found.poses[-1], found.aim.formation)) > 0.0
    keeps = dataclasses.replace(CONFIG, reference=dataclasses.replace(CONFIG.reference, change_faces=0.0))
    assert int(find(scenario, keeps, NO).aim.formation) == 0


def test_a_team_that_does_not_get_on_leaves_by_other_faces():
    scenario = scenario_to((4.0, 4.0, 0.0))
    found = find(scenario, CONFIG, ~NO)
    assert int(found.aim.formation) in (1, 3)
    np.testing.assert_allclose(found.poses[-1], scenario.start, atol=1e-6)


@pytest.mark.parametrize(("wanted", "blocked"), [(1, (0.9, -0.3)), (3, (-0.2, 0.9))])
def test_a_walk_needs_room_on_its_side_of_the_object(wanted, blocked):
    scenario = scenario_to((4.0, 4.0, 0.0), places=(blocked,))
    rooms = {k: float(room(scenario, scenario.start, jnp.asarray(k))) for k in (1, 3)}
    assert rooms[wanted] < 0.0 < rooms[4 - wanted]


def test_an_obstacle_that_goes_away_may_come_back_during_a_walk():
    """A walk cannot be broken off: one of 256 teams walked into what had turned round."""
    scenario = scenario_to((4.0, 4.0, 0.0), places=((1.5, -0.9),))
    rooms = []
    for speed in (0.0, 0.3, -0.3):
        moving = dataclasses.replace(
            scenario.obstacles, velocity=jnp.array([[0.8 * speed, -0.6 * speed]]), dynamic=jnp.ones(1, bool)
        )
        rooms.append(float(room(dataclasses.replace(scenario, obstacles=moving), scenario.start, jnp.asarray(1))))
    assert rooms[1] == pytest.approx(rooms[0], abs=1e-5)
    assert rooms[2] < rooms[0] - 0.1


def test_nobody_walks_before_it_is_known_how_fast_obstacles_move():
    scenario = scenario_to((4.0, 4.0, 0.0), places=((3.5, -0.9),))
    moving = dataclasses.replace(scenario.obstacles, dynamic=jnp.ones(1, bool))
    scenario = dataclasses.replace(scenario, obstacles=moving)
    unknown = estimation.start_obstacles(moving.position, CONFIG.estimation).covariance
    assert float(room(scenario, scenario.start, jnp.asarray(1))) > 0.0
    assert float(room(scenario, scenario.start, jnp.asarray(1), unknown)) < 0.0


def test_robots_in_a_tight_place_may_leave_it():
    """What there is at the beginning, less than the filter's margin, is enough on the way."""
    beside = (0.0 + 0.155 + 0.3 + 0.02, -0.6)
    scenario = scenario_to((4.0, 4.0, 0.0), places=(beside,))
    assert float(room(scenario, scenario.start, jnp.asarray(3))) > 0.0


def test_walks_do_not_use_up_the_room_bit_by_bit():
    """Half a centimetre each time, a team that walked to and fro touched what it stood beside."""
    rooms = [0.04]
    for _ in range(20):
        given = jnp.array(rooms[-1])
        rooms.append(float(regrasp.asked_of_a_walk(given, CONFIG.safety.margin)))
    assert rooms[1] == pytest.approx(CONFIG.safety.margin)
    assert min(rooms) >= regrasp.CLOSEST - 1e-3
    assert float(regrasp.asked_of_a_walk(jnp.array(0.004), CONFIG.safety.margin)) == pytest.approx(0.004, abs=1e-4)


def test_order_of_formations():
    assert regrasp.order(1) == [0]
    assert regrasp.order(3) == [0, 1, 2, 0]
    assert regrasp.order(4) == [0, 2, 1, 3, 0]
