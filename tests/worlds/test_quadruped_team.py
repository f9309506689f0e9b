"""The team of the quadruped world: how its rates fit into each other."""

import pytest

from jaxlocomanip.checked import InputError
from jaxlocomanip.worlds.quadruped_team import rates


@pytest.mark.parametrize(
    ("tick", "expected"),
    [(0.02, (2, 5, 2)), (0.01, (1, 5, 2)), (0.05, (5, 5, 2)), (0.006, (1, 3, 3)), (0.002, (1, 1, 10))],
)
def test_rates_fill_the_tick(tick, expected):
    updates, hold, every = rates(tick, 0.002)
    assert (updates, hold, every) == expected
    assert updates * hold * 0.002 == pytest.approx(tick)
    assert 0.01 < every * hold * 0.002 < 0.03


def test_a_tick_between_physics_steps_is_refused():
    with pytest.raises(InputError, match="horizon.tick = 0.005: must be a multiple of the physics step, 0.002 s"):
        rates(0.005, 0.002)
