"""Room around bodies, and how fast robots may slide along their faces."""

import jax
import jax.numpy as jnp

from jaxlocomanip.planner import room
from jaxlocomanip.planner.config import PlannerConfig
from jaxlocomanip.planner.shapes import shapes_of

CONFIG = PlannerConfig()
TICK = CONFIG.horizon.tick


def test_room_between_robots_never_runs_out(make_scenario):
    """Two robots around a corner, both sliding into it as fast as they can, stop short of each other."""
    team = make_scenario(object={"size": [0.8, 0.8], "mass": 6.0}).team
    row, bound = team.pair_rows[0], team.pair_bounds[0]
    towards = jnp.sign(row) * team.slide_speed_max
    offset, keep = jnp.zeros(2), jax.jit(room.keep_room)
    assert (keep(offset, 0.0 * towards, team, 0.03) == 0.0).all()
    assert (keep(offset, -towards, team, 0.03) == -towards).all()
    for _ in range(300):
        offset = offset + TICK * keep(offset, towards, team, 0.03)
        assert row @ offset <= bound - 0.03 + 1e-6
    assert row @ offset > bound - 0.05  # and they do use the room
    assert (keep(offset, -towards, team, 0.03) == -towards).all()


def test_no_robot_slides_into_an_obstacle_for_the_sake_of_another(make_scenario):
    """Each robot's rate is limited by its own room, whatever the others do."""
    wall = {"shape": "box", "size": [1.0, 8.0], "position": [0.95, 3.0], "velocity": [0.0, 0.0]}
    scenario = make_scenario(goal={"pose": [-3.0, 3.0, 0.0]}, obstacles=[wall])
    shapes = shapes_of(scenario)
    places = scenario.obstacles.position
    bodies = room.bodies_of(shapes, CONFIG)

    @jax.jit
    def keep(offset, rate):
        slowest, fastest = room.slide_limits(jnp.zeros(3), offset, places, shapes, CONFIG)[0]
        return jnp.clip(rate, -slowest, fastest)

    near = jax.jit(lambda d: room.robot_rooms(jnp.zeros((3, 1)), d[:, None], places[..., None], bodies))
    for sign in (1.0, -1.0):
        offset, asked = jnp.zeros(2), sign * jnp.array([0.4, 0.4])
        for _ in range(200):
            rate = keep(offset, asked)
            assert (jnp.abs(rate) <= 0.4 + 1e-6).all() and (rate * asked >= 0.0).all()
            offset = jnp.clip(offset + TICK * rate, -shapes.team.offset_limit, shapes.team.offset_limit)
        assert near(offset).min() >= CONFIG.safety.margin - 2e-3
    assert (keep(jnp.zeros(2), asked) == asked).sum() >= 1  # the robot that has room is not held


def test_within_the_margin_a_robot_may_slide_away_and_not_closer(make_scenario):
    """It is limited on the side of the obstacle only, and told where there is more room."""
    post = {"shape": "circle", "radius": 0.1, "position": [-0.6, 0.29]}
    scenario = make_scenario(goal={"pose": [3.0, -3.0, 0.0]}, obstacles=[post])
    shapes, offset = shapes_of(scenario), jnp.zeros(2)
    places = scenario.obstacles.position
    near = room.robot_rooms(jnp.zeros((3, 1)), offset[:, None], places[..., None], room.bodies_of(shapes, CONFIG))[:, 0]
    tight = int(jnp.argmin(near))
    assert 0.0 < near[tight] < CONFIG.safety.margin
    limits, away = jax.jit(lambda d: room.slide_limits(jnp.zeros(3), d, places, shapes, CONFIG))(offset)
    towards, free = (1, 0) if away[tight] < 0.0 else (0, 1)
    assert away[tight] != 0.0 and away[1 - tight] == 0.0
    assert limits[towards, tight] == 0.0 and limits[free, tight] == jnp.inf
