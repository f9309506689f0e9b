"""When a team goes on and when it waits for what crosses its path."""

import dataclasses

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from jaxlocomanip.planner import keeping, reference, schedule
from jaxlocomanip.planner.config import PlannerConfig
from jaxlocomanip.planner.estimation import ObjectEstimate, ObstacleEstimate
from jaxlocomanip.planner.path import POINTS, pace, straight_poses
from jaxlocomanip.planner.room import bodies_of, rooms_at, standing_room
from jaxlocomanip.planner.shapes import shapes_of
from jaxlocomanip.planner.situation import Situation

CONFIG = PlannerConfig()
SPEED, TICK = CONFIG.reference.speed, 0.1
CROSSING = np.array([1.0, 1.0])
"""m, on the straight path from the start to the goal"""
ACROSS = np.array([-1.0, 1.0]) / np.sqrt(2.0)


@pytest.fixture
def scene(make_scenario):
    """A function from an obstacle's speed and the time at which it is at the crossing to a scenario and its path."""

    def make(speed, meeting):
        place = CROSSING - speed * meeting * ACROSS
        moving = {"shape": "circle", "radius": 0.3, "position": place.tolist(), "velocity": (speed * ACROSS).tolist()}
        scenario = make_scenario(obstacles=[moving])
        poses = straight_poses(scenario.start, scenario.goal.pose, POINTS)
        turn_radius = CONFIG.reference.turn_radius
        return scenario, pace(poses, shapes_of(scenario), scenario.object.body, turn_radius)

    return make


@jax.jit
def step(scenario, path, progress, time, noise):
    """Progress of a team that keeps to its schedule, after a step, and its room to the obstacle."""
    shapes, pose, zero = shapes_of(scenario), path.at(progress.projected), jnp.zeros(3)
    offset = path.feed_forward(progress.projected)[1]
    obstacles = scenario.obstacles
    place = obstacles.at(time)
    seen = ObstacleEstimate(place, obstacles.velocity + noise, zero[None])
    none = jnp.zeros(())
    estimate = ObjectEstimate(pose, zero, zero)
    bodies = bodies_of(shapes, CONFIG)
    gaps = keeping.gaps_of(estimate, offset, seen, shapes, CONFIG)
    situation = Situation(
        estimate,
        scenario.object.body,
        seen,
        offset,
        standing_room(gaps, bodies),
        gaps,
        0.0 * offset,
        none,
        jnp.zeros((), bool),
        none,
        progress.held,
    )
    held = schedule.has_to_wait(path, progress, situation, shapes, CONFIG)
    room = rooms_at(pose[:, None], offset[:, None], place[..., None], bodies).moving[0]
    way = jnp.where(held, 0.0, TICK * reference.speed_at(progress.projected, path, CONFIG.reference))
    return dataclasses.replace(progress, projected=progress.projected + way, held=held), room


def follow(scene, noise=0.0, begin=0.0, seconds=12.0):
    """Whether the team waited [T], its least room to the obstacle, and where on the path it ended."""
    scenario, path = scene
    progress = dataclasses.replace(reference.start(), projected=jnp.asarray(begin))
    rng, waits, rooms = np.random.default_rng(0), [], []
    for k in range(round(seconds / TICK)):
        error = jnp.asarray(noise * rng.normal(size=(1, 2)), jnp.float32)
        progress, room = step(scenario, path, progress, jnp.asarray(k * TICK), error)
        waits.append(bool(progress.held))
        rooms.append(float(room))
    return np.array(waits), min(rooms), float(progress.projected)


@pytest.mark.parametrize("speed", [0.15, 0.3, 0.5])
def test_a_team_lets_pass_what_it_would_meet(scene, speed):
    waits, room, way = follow(scene(speed, 3.5), seconds=7.0 + 2.5 / speed)
    assert waits.any() and not waits[0]
    assert room > 0.0
    assert way > 2.5


def test_without_waiting_they_would_have_met(scene):
    scenario, path = scene(0.3, 3.5)
    gaps = []
    for k in range(80):
        progress = dataclasses.replace(reference.start(), projected=jnp.asarray(k * TICK * SPEED))
        gaps.append(float(step(scenario, path, progress, jnp.asarray(k * TICK), jnp.zeros((1, 2)))[1]))
    assert min(gaps) < -0.1


def test_a_team_does_not_wait_for_what_comes_much_later_or_went_before(scene):
    for meeting in (-6.0, 20.0):
        waits, room, _ = follow(scene(0.3, meeting), seconds=6.0)
        assert not waits.any()
        assert room > 0.3


def test_a_team_near_its_goal_does_not_wait_for_what_may_turn_round_before(scene):
    """What would be at the goal in 7 s at its present velocity does not keep a team from getting there."""
    scenario, path = scene(0.45, 0.0)
    goal = scenario.goal.pose[:2]
    back = goal - 0.45 * 7.0 * ACROSS
    coming = dataclasses.replace(scenario.obstacles, position=jnp.asarray(back, jnp.float32)[None])
    near = float(path.length) - 0.5
    waits, _, _ = follow((dataclasses.replace(scenario, obstacles=coming), path), begin=near, seconds=1.0)
    assert not waits.any()


def test_a_team_in_the_way_goes_on(scene):
    """To stand there would be to be run over."""
    begin = float(np.linalg.norm(CROSSING))
    waits, room, _ = follow(scene(0.3, 8.0), begin=begin, seconds=6.0)
    assert not waits.any()
    assert room > 0.0


def test_noise_does_not_make_it_dither(scene):
    waits, room, _ = follow(scene(0.3, 3.5), noise=0.03)
    assert np.sum(waits[1:] != waits[:-1]) <= 4
    assert room > 0.0
