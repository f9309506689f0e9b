"""Room to keep between bodies and obstacles."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from jaxlocomanip.planner import keeping
from jaxlocomanip.planner.keeping import Kept

MARGIN = 0.03
STANDS, MOVES = jnp.array([False]), jnp.array([True])


def kept_after(gaps, moves=STANDS):
    """Room to keep [T] after each of the gaps [T], of one body and one obstacle."""

    def tick(kept, gap):
        kept = keeping.watch(kept, gap, 0.02)
        return kept, keeping.room_to_keep(kept, gap, moves, MARGIN)

    gaps = jnp.asarray(gaps, jnp.float32)[:, None, None]
    return np.asarray(jax.lax.scan(tick, keeping.start(gaps[0]), gaps)[1])[:, 0, 0]


@pytest.mark.parametrize("gap", [0.001, 0.01, 0.025])
def test_within_the_margin_what_there_is_is_kept(gap):
    assert np.allclose(kept_after(np.full(100, gap)), gap, atol=2.0 * keeping.ROUNDING)


def test_beyond_the_margin_the_margin_is_kept():
    assert np.allclose(kept_after(np.full(100, 0.5)), MARGIN)


def test_obstacles_that_move_are_always_kept_clear_of():
    assert np.allclose(kept_after(np.full(100, 0.01), MOVES), MARGIN)


@pytest.mark.parametrize(("gap", "used"), [(0.5, keeping.SLACK), (0.03, keeping.SLACK), (0.01, 0.005)])
def test_a_body_that_creeps_uses_up_a_centimetre_and_no_more(gap, used):
    """However slowly it comes closer, and whatever it has been allowed tick by tick."""
    creeping = np.concatenate([np.full(200, gap), np.linspace(gap, -0.05, 3000)])
    least = min(gap, MARGIN) - used
    assert kept_after(creeping)[-1] == pytest.approx(least, abs=1e-4)


def test_once_it_has_left_it_keeps_the_margin():
    leaving = np.concatenate([np.full(100, 0.005), np.linspace(0.005, 0.2, 100), np.full(100, 0.2)])
    assert np.allclose(kept_after(leaving)[-50:], MARGIN)
    assert (np.diff(kept_after(leaving)[100:]) >= -1e-6).all()


def test_what_was_room_for_the_object_is_remembered_when_robots_go_to_other_places():
    before = Kept(jnp.array([[0.02], [0.02]]), jnp.array([[0.3], [0.3]]))
    after = keeping.regrouped(before, jnp.array([[0.01], [0.25]]))
    assert np.allclose(after.best, [[0.3], [0.25 - 0.02]]) and np.allclose(after.mean, [[0.02], [0.25 - 0.02]])


def test_a_first_measurement_that_is_too_good_is_not_remembered():
    """One with two centimetres too much, of a body that has one."""
    gaps = np.full(400, 0.01)
    gaps[0] = 0.03
    assert kept_after(gaps)[-1] == pytest.approx(0.01, abs=1e-3)
    assert float(keeping.start(jnp.asarray(gaps[:1, None])).best[0, 0]) <= gaps[-1] + 1e-6
