"""Cost to go by fast sweeping, against updating all poses at once until nothing changes."""

import jax.numpy as jnp
import numpy as np
import pytest

from jaxlocomanip.planner.moves import Moves
from jaxlocomanip.planner.pose_grid import CELL_MOVES, CELLS, DIRECTIONS, FAR, HEADINGS, LENGTHS, TURN, TURNS
from jaxlocomanip.planner.sweeping import cost_to_go

RADIUS, SPACING = 0.6, 0.15
FINER = HEADINGS // DIRECTIONS


def simple(density, ending, moves, turns, sweeps=250):
    """Costs by Jacobi iteration, every move of every pose spelt out."""
    value = ending
    for _ in range(sweeps):
        old, best = value, value.copy()
        for k in range(HEADINGS):
            for side, change in ((0, -1), (1, 1)):
                turned = old[(k + change) % HEADINGS]
                best[k] = np.minimum(best[k], RADIUS * TURN * turns[side] * density[k] + turned)
            for m, (i, j) in enumerate(CELL_MOVES):
                here = tuple(slice(max(0, -s), CELLS - max(0, s)) for s in (i, j))
                there = tuple(slice(max(0, s), CELLS + min(0, s)) for s in (i, j))
                straight = LENGTHS[m] * SPACING
                for t, turn in enumerate(TURNS):
                    length = np.hypot(straight, RADIUS * TURN * turn)
                    price = moves[(FINER * m - k) % HEADINGS, t] * length
                    cost = price * density[k][here] + old[(k + turn) % HEADINGS][there]
                    best[k][here] = np.minimum(best[k][here], cost)
        value = best
        if np.array_equal(value, old):
            break
    return value


def priced(factors, spots):
    """Costs of moves with factors [HEADINGS, directions in the body frame, TURNS] and [2] turns on the spot."""
    lengths = SPACING * LENGTHS[:, None, None]
    bent = np.hypot(lengths, RADIUS * TURN * TURNS)
    directions, headings = np.arange(DIRECTIONS)[:, None], np.arange(HEADINGS)[None, :]
    table = factors[(FINER * directions - headings) % HEADINGS] * bent
    return Moves(jnp.asarray(table, jnp.float32), jnp.asarray(RADIUS * TURN * spots, jnp.float32))


@pytest.mark.parametrize("seed", range(2))
def test_costs_are_those_of_plain_iteration(seed):
    random = np.random.default_rng(seed)
    density = np.ones((HEADINGS, CELLS, CELLS))
    for _ in range(6):
        x, y = random.integers(0, CELLS - 8, 2)
        density[:, x : x + 8, y : y + 8] *= 10.0
    moves = 1.0 + 15.0 * random.uniform(0.0, 1.0, (HEADINGS, len(TURNS))) * (random.uniform(size=(HEADINGS, 1)) < 0.6)
    turns, ending = np.array([3.0, 1.5]), np.full(density.shape, FAR)
    ending[0, 11, 30], ending[1, 11, 31] = 0.0, 0.7
    given = (jnp.asarray(a, jnp.float32) for a in (ending, density))
    found = cost_to_go(*given, priced(moves, turns))
    expected = simple(density, ending, moves, turns)
    assert float(found[0, 11, 30]) == 0.0
    np.testing.assert_allclose(found, expected, rtol=2e-3, atol=2e-2)
