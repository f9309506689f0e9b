"""Robots alone on flat ground in MuJoCo: they stand, trot, turn, stop, and do what they are asked."""

import asked
import numpy as np
import pytest
from flat_ground import FlatGround

from jaxlocomanip.robots.model import ROBOT_TYPES

every_robot = pytest.mark.parametrize("name", ROBOT_TYPES)


def upright(log, duration):
    """Ran to the end (a fall ends a run) and stayed level."""
    return log.time[-1] > duration - 0.01 and log.tilt.max() < 0.2


def turned(log, since):
    """[] rad/s, mean yaw rate."""
    first = log.after(since)
    return (log.yaw[-1] - log.yaw[first]) / (log.time[-1] - log.time[first])


@every_robot
def test_stands_where_it_is(name, gains):
    log = FlatGround(name, gains[name]).run(3.0, asked.stand)
    assert upright(log, 3.0)
    # Everything that holds it up is known, so that nothing is left for errors to make up for.
    assert log.position[-1] == pytest.approx(log.position[0], abs=2e-4)
    assert log.tilt.max() < 0.002


@every_robot
def test_stand_walk_turn_stop_and_again(name, gains):
    ask = asked.walk(
        (0.0, None),
        (0.5, 0.5, 0.0, 0.0),
        (3.03, 0.0, 0.2, 0.0),
        (5.0, 0.2, 0.0, 0.5),
        (7.12, None),
        (8.5, 0.3, 0.0, 0.0),
    )
    log = FlatGround(name, gains[name]).run(10.5, ask)
    assert upright(log, 10.5)
    assert log.mean_velocity(1.5, 3.0) == pytest.approx([0.5, 0.0, 0.0], abs=0.025)
    assert log.mean_velocity(3.8, 5.0) == pytest.approx([0.0, 0.2, 0.0], abs=0.02)
    first, last = log.after(5.5), log.after(7.0)
    assert (log.yaw[last] - log.yaw[first]) / 1.5 == pytest.approx(0.5, abs=0.015)
    rest = slice(log.after(7.8), log.after(8.5))
    assert not log.swinging[rest].any() and np.abs(log.velocity[rest]).max() < 0.02
    assert log.mean_velocity(9.5)[0] == pytest.approx(0.3, abs=0.02)
    height = log.position[log.after(1.0) :, 2]
    assert np.abs(height / log.position[0, 2] - 1.0).max() < 0.05


@pytest.mark.slow
@every_robot
@pytest.mark.parametrize(
    ("forward", "left", "turn", "off"),
    [
        (0.0, 0.0, 0.0, 2e-4),
        (0.5, 0.0, 0.0, 0.0017),
        (0.0, 0.2, 0.0, 0.003),
        (0.0, 0.0, 0.5, 0.013),
        (1.0, 0.0, 0.0, 0.005),
    ],
)
def test_twenty_seconds(name, forward, left, turn, off, gains):
    """Mean velocities are right within `off` m/s, five times the error of the worst robot."""
    log = FlatGround(name, gains[name]).run(20.0, asked.walk((0.5, forward, left, turn)))
    assert upright(log, 20.0)
    assert log.mean_velocity(2.0) == pytest.approx([forward, left, 0.0], abs=off)
    assert turned(log, 2.0) == pytest.approx(turn, abs=5e-4)
    assert log.position[log.after(2.0) :, 2].mean() == pytest.approx(log.position[0, 2], abs=0.006)


@pytest.mark.slow
@every_robot
@pytest.mark.parametrize("hold", [0.002, 0.01])
def test_command_may_be_held_shorter_or_longer(name, hold, gains):
    log = FlatGround(name, gains[name], hold=hold).run(8.0, asked.walk((0.5, 0.5, 0.0, 0.3)))
    assert upright(log, 8.0)
    assert log.mean_velocity(2.0)[0] == pytest.approx(0.5, rel=0.05)


@pytest.mark.slow
@every_robot
def test_recovers_from_a_shove(name, gains):
    ground = FlatGround(name, gains[name])
    ground.run(2.0, asked.walk((0.3, 0.3, 0.0, 0.0)))
    ground.data.qvel[1] += 0.5  # sideways, of the whole robot
    log = ground.run(4.0, asked.walk((0.3, 0.3, 0.0, 0.0)))
    assert log.time[-1] > 5.99
    assert np.abs(log.mean_velocity(5.0)[1]) < 0.011


def test_swinging_feet_clear_the_ground_and_land_softly(gains):
    log = FlatGround("aliengo", gains["aliengo"]).run(4.0, asked.walk((0.5, 0.5, 0.0, 0.0)))
    since = log.after(2.0)
    for leg in range(4):
        height, lifted = log.foot[since:, leg, 2] - 0.0265, log.swinging[since:, leg]
        assert 0.06 < height[lifted].max() < 0.1
        assert height[~lifted].max() < 0.01  # down when the schedule says so
