"""One robot pushes a box in MuJoCo: straight, at the asked speed, also with a wrong idea of the force."""

import asked
import numpy as np
import pytest
from flat_ground import Box, FlatGround

from jaxlocomanip.locomotion.srbd import GRAVITY

SPEED, DISTANCE = 0.3, 2.0


def pushed(name, gains, mass, share=1.0, **options):
    """Log of a push with `share` of the force that slides the box expected."""
    box = Box(mass=mass)
    sliding = box.friction * mass * GRAVITY
    ground = FlatGround(name, gains[name], box, **options)
    return ground.run(9.0, asked.push(share * sliding, SPEED)), sliding


def check(log, sliding, speed=(0.97, 1.03)):
    """The box went 2 m straight, at the asked speed, the robot level and always in touch."""
    assert log.time[-1] > 8.99 and log.tilt.max() < 0.2
    way = log.box[:, 0] - log.box[0, 0]
    there = int(np.searchsorted(way, DISTANCE))
    assert there < len(way)
    assert np.rad2deg(np.abs(log.box[:there, 2])).max() < 3.0
    assert np.abs(log.box[:there, 1]).max() < 0.15
    steady = slice(log.after(3.0), None)
    pace = np.polyfit(log.time[steady], log.box[steady, 0], 1)[0]
    assert speed[0] * SPEED < pace < speed[1] * SPEED
    assert (log.contact[steady] < 0.1).mean() < 0.02
    assert log.contact[steady].mean() == pytest.approx(sliding, rel=0.05)


def test_aliengo_pushes_eight_kilograms(gains):
    check(*pushed("aliengo", gains, 8.0))


@pytest.mark.slow
@pytest.mark.parametrize("share", [0.5, 1.0, 1.5])
@pytest.mark.parametrize(
    ("name", "mass", "speed"),
    [
        ("aliengo", 8.0, (0.97, 1.03)),
        ("aliengo", 16.0, (0.94, 1.04)),
        ("a1", 8.0, (0.97, 1.03)),
        ("go1", 8.0, (0.97, 1.03)),
    ],
)
def test_wrong_idea_of_the_force(name, mass, speed, share, gains):
    check(*pushed(name, gains, mass, share), speed)


@pytest.mark.slow
@pytest.mark.parametrize("hold", [0.002, 0.01])
def test_command_may_be_held_shorter_or_longer(hold, gains):
    check(*pushed("aliengo", gains, 8.0, hold=hold))


@pytest.mark.slow
@pytest.mark.parametrize("name", ["a1", "go1"])
def test_too_heavy_a_box_stalls_the_robot_but_does_not_throw_it(name, gains):
    log, sliding = pushed(name, gains, 16.0)  # more than its feet hold: mu m g = 61 N of 63
    assert log.time[-1] > 8.99 and log.tilt.max() < 0.3
    assert log.contact[log.after(3.0) :].mean() > 0.9 * sliding


@pytest.mark.parametrize("force", [30.0, 60.0])
def test_a_box_that_does_not_move_feels_the_force_asked_for(force, gains):
    log = FlatGround("aliengo", gains["aliengo"], Box(fixed=True)).run(6.0, asked.press(force))
    assert log.tilt.max() < 0.1
    steady = log.contact[log.after(4.0) :]
    assert 0.8 * force < steady.mean() < 1.05 * force
    assert (steady < 0.1).mean() == 0.0
