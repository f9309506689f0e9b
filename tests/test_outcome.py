"""Who ran into whom: collisions of a team that moves and of one that stands."""

import dataclasses

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from jaxlocomanip.outcome import STILL, Clearances, clearances, count, gaps, nearest, start_tally, summarise
from jaxlocomanip.worlds.planar import PlanarWorld

TICK = 0.02
WORLD = PlanarWorld()
CIRCLE = {"shape": "circle", "radius": 0.3, "position": [1.0, 0.0]}
PSI = jnp.zeros(6)


@pytest.fixture
def episode(make_scenario):
    """A function from obstacles and object velocities, one a tick, to the outcome."""

    def run(obstacles, velocities, robots=None):
        tables = {"robots": robots} if robots else {}
        scenario = make_scenario(obstacles=obstacles, **tables)
        state = WORLD.start(scenario)
        view, tally = WORLD.view(state, scenario), start_tally(scenario)

        @jax.jit
        def tick(tally, state, velocity, time):
            pose = state.pose + TICK * velocity
            before, state = WORLD.view(state, scenario), dataclasses.replace(state, pose=pose)
            after = WORLD.view(state, scenario)
            apart = gaps(scenario, after, scenario.obstacles.at(time))
            return count(
                tally, scenario, before, after, apart, nearest(scenario, after, apart), jnp.zeros(()), time, TICK
            ), state

        for k, velocity in enumerate(velocities):
            tally, state = tick(tally, state, jnp.asarray(velocity), (k + 1) * jnp.asarray(TICK))
            view = WORLD.view(state, scenario)
        return summarise(tally, scenario, view, PSI)

    return run


def still(seconds):
    return [(0.0, 0.0, 0.0)] * round(seconds / TICK)


def moving(speed, seconds, turn=0.0):
    return [(speed, 0.0, turn)] * round(seconds / TICK)


def flags(result):
    return bool(result.collided), bool(result.run_over)


def walking(speed):
    return CIRCLE | {"velocity": [-speed, 0.0]}


def test_nothing_is_run_over_without_a_collision(episode):
    assert flags(episode([walking(0.5)], still(0.5))) == (False, False)


def test_a_standing_team_is_run_over(episode):
    assert flags(episode([walking(0.5)], still(1.5))) == (True, True)
    assert flags(episode([walking(0.5)], still(3.0))) == (True, True)  # and when the obstacle has passed through


def test_a_team_that_walks_into_a_standing_obstacle_is_not(episode):
    assert flags(episode([CIRCLE], moving(0.5, 1.5))) == (True, False)


def test_a_team_that_moves_at_the_contact_is_not(episode):
    assert flags(episode([walking(0.5)], moving(0.05, 1.5))) == (True, False)
    assert flags(episode([walking(0.5)], moving(-0.05, 1.5))) == (True, False)


def test_a_team_that_stopped_before_the_contact_is(episode):
    assert flags(episode([walking(0.2)], moving(0.3, 0.5) + still(3.0))) == (True, True)


def test_a_team_that_sets_off_during_the_contact_is_not(episode):
    assert flags(episode([walking(0.2)], still(2.4) + moving(0.2, 0.3))) == (True, False)


def test_less_than_the_limit_is_standing_and_turning_counts(episode):
    assert flags(episode([walking(0.5)], moving(0.9 * STILL, 1.5))) == (True, True)
    corner = 0.25 * 2.0**0.5  # m, the lever of the object's corners
    assert flags(episode([walking(0.5)], moving(0.0, 1.5, turn=1.2 * STILL / corner))) == (True, False)
    # The robots stand farther out than the corners and move faster, but nothing touches them.
    assert flags(episode([walking(0.5)], moving(0.0, 1.2, turn=0.8 * STILL / corner))) == (True, True)


def test_each_body_is_judged_by_itself(episode):
    behind = {"shape": "circle", "radius": 0.3, "position": [-2.5, 0.0], "velocity": [1.0, 0.0]}
    assert flags(episode([behind], still(2.0))) == (True, True)  # a robot is hit
    both = [behind, CIRCLE | {"position": [0.7, 0.0]}]
    assert flags(episode(both, still(1.2) + moving(0.4, 1.0))) == (True, False)


def test_robots_that_overlap_each_other_are_to_blame(make_scenario):
    scenario = make_scenario()
    tally = start_tally(scenario)
    view = WORLD.view(WORLD.start(scenario), scenario)

    def judged(object_gap, team_gap):
        least = Clearances(jnp.asarray(object_gap), tally.least.robots, jnp.asarray(team_gap))
        return flags(summarise(dataclasses.replace(tally, least=least), scenario, view, PSI))

    assert judged(-0.1, 0.1) == (True, True)
    assert judged(-0.1, -0.1) == (True, False)
    assert judged(0.1, -0.1) == (True, False)


def test_distances_and_clearances_agree(make_scenario):
    scenario = make_scenario(obstacles=[CIRCLE, CIRCLE | {"position": [-1.5, 0.0]}])
    view = WORLD.view(WORLD.start(scenario), scenario)
    apart = np.asarray(gaps(scenario, view, scenario.obstacles.position))
    least = clearances(scenario, view, scenario.obstacles.position)
    assert apart.shape == (3, 2)
    assert (least.object, least.robots) == (apart[0].min(), apart[1:].min())
    assert apart[0] == pytest.approx([0.45, 0.95], abs=1e-5)
