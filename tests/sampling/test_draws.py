"""The generator is Philox, and a number belongs to seed, lane, attempt, name and item."""

import numpy as np
import pytest

from jaxlocomanip.sampling.draws import Draws, philox

ONES = 0xFFFFFFFF


@pytest.mark.parametrize(
    ("counter", "key", "expected"),
    [
        ((0, 0, 0, 0), (0, 0), (0x6627E8D5, 0xE169C58D, 0xBC57AC4C, 0x9B00DBD8)),
        ((ONES,) * 4, (ONES,) * 2, (0x408F276D, 0x41C83B0E, 0xA20BC7C6, 0x6D5451FD)),
        (
            (0x243F6A88, 0x85A308D3, 0x13198A2E, 0x03707344),
            (0xA4093822, 0x299F31D0),
            (0xD16CFE09, 0x94FDCCEB, 0x5001E420, 0x24126EA1),
        ),
    ],
)
def test_the_known_answers_of_philox(counter, key, expected):
    assert philox(counter, key) == expected


def test_every_part_of_the_address_matters():
    base = Draws(1, 2, 3).uniform("goal.distance", 4)
    assert Draws(1, 2, 3).uniform("goal.distance", 4) == base
    others = [
        Draws(2, 2, 3).uniform("goal.distance", 4),
        Draws(1 + 2**32, 2, 3).uniform("goal.distance", 4),
        Draws(1, 3, 3).uniform("goal.distance", 4),
        Draws(1, 2, 4).uniform("goal.distance", 4),
        Draws(1, 2, 3).uniform("goal.bearing", 4),
        Draws(1, 2, 3).uniform("goal.distance", 5),
    ]
    assert len({base, *others}) == 7


def test_numbers_are_uniform_and_independent():
    values = np.array([[Draws(7, lane).uniform("x", item) for item in range(4)] for lane in range(4000)])
    assert ((values > 0.0) & (values < 1.0)).all()
    assert values.mean(axis=0) == pytest.approx(np.full(4, 0.5), abs=0.02)
    assert values.std(axis=0) == pytest.approx(np.full(4, 12**-0.5), abs=0.01)
    assert np.abs(np.corrcoef(values.T) - np.eye(4)).max() < 0.06


def test_numbers_stay_what_they_are():
    """A change here changes every study that was ever run."""
    assert Draws(0, 0).uniform("truth.friction") == 0.1440815735753937
