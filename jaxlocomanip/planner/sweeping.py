"""Cost to go on the grid of poses by fast sweeping: dynamic programming in the order in which costs spread.

A sweep goes through the rows of the grid in one direction and takes each row's best moves into rows that are already
done, so that one sweep carries costs along whole straight stretches of a path. Sweeps in the four directions make a
round; rounds go on until no cost changes, which takes three or four where updating all poses at once takes sixty
steps, each a quarter of a round.
"""

from __future__ import annotations

import jax
import jax.numpy as jnp
from jax import Array

from jaxlocomanip.planner.moves import Moves
from jaxlocomanip.planner.pose_grid import CELL_MOVES, CELLS, FAR, HEADINGS, TURNS

ROUNDS = 6
"""at most"""
SETTLED = 1e-2
"""change of cost below which a round has changed nothing"""


def cost_to_go(ending: Array, density: Array, moves: Moves) -> Array:
    """[HEADINGS, CELLS, CELLS] cost from each pose to where it is best to end.

    Args:
      ending: [HEADINGS, CELLS, CELLS] cost of ending at each pose.
      density: [HEADINGS, CELLS, CELLS] cost of a unit of length at each pose.
      moves: costs of moves.
    """

    def unsettled(carry: tuple[Array, Array, Array]) -> Array:
        return (carry[0] < ROUNDS) & (carry[2] > SETTLED)

    def around(carry: tuple[Array, Array, Array]) -> tuple[Array, Array, Array]:
        count, value, _ = carry
        new = value
        for axis, sign in ((0, 1), (0, -1), (1, 1), (1, -1)):
            new = _sweep(new, density, moves, axis, sign)
        return count + 1, new, jnp.max(value - new)

    first = (jnp.zeros((), jnp.int32), ending, jnp.full((), FAR, density.dtype))
    return jax.lax.while_loop(unsettled, around, first)[1]


def _sweep(value: Array, density: Array, moves: Moves, axis: int, sign: int) -> Array:
    """Costs after one sweep over the rows across `axis` (0: x, 1: y), against the direction `sign`."""
    ahead = [(m, sign * move[axis], move[1 - axis]) for m, move in enumerate(CELL_MOVES) if sign * move[axis] >= 0]

    def row(done: tuple[Array, Array], here: tuple[Array, ...]) -> tuple[tuple[Array, Array], Array]:
        old, cost = here
        # By distance: this row, as it was, and the two rows last done.
        rows = [_widened(row) for row in (old, *done)]
        spot = moves.on_the_spot
        best = jnp.minimum(spot[0] * cost + _turned(rows[0], -1, 0), spot[1] * cost + _turned(rows[0], 1, 0))
        for m, distance, aside in ahead:
            for k, turn in enumerate(TURNS.tolist()):
                best = jnp.minimum(best, moves.by_heading[m, :, k, None] * cost + _turned(rows[distance], turn, aside))
        new = jnp.minimum(best, old)
        return (new, done[0]), new

    by_row = tuple(jnp.moveaxis(field, 1 + axis, 0) for field in (value, density))
    far = jnp.full((HEADINGS, CELLS), FAR, density.dtype)
    _, new = jax.lax.scan(row, (far, far), by_row, reverse=sign > 0)
    return jnp.moveaxis(new, 0, 1 + axis)


_PAD = 2
"""cells of the longest move, and most headings by which one turns"""


def _widened(row: Array) -> Array:
    """[HEADINGS + 2 _PAD, CELLS + 2 _PAD] of [HEADINGS, CELLS]: headings go around, places end.

    Written in place, so that the compiler keeps it as an array; a concatenation it would put together anew for each of
    the moves that read it, which takes four times as long.
    """
    wide = jnp.pad(row, _PAD, constant_values=FAR)
    return wide.at[:_PAD].set(wide[HEADINGS : HEADINGS + _PAD]).at[HEADINGS + _PAD :].set(wide[_PAD : 2 * _PAD])


def _turned(wide: Array, turn: int, aside: int) -> Array:
    """[HEADINGS, CELLS] values of a widened row at other headings and places."""
    return wide[_PAD + turn : _PAD + turn + HEADINGS, _PAD + aside : _PAD + aside + CELLS]
