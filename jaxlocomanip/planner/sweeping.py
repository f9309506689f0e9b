"""Cost to go on the grid of poses by fast sweeping: dynamic programming in the order in which costs spread.

A sweep goes through the rows of the grid in one direction and takes each row's best moves into rows that are already
done, so that one sweep carries costs along whole straight stretches of a path. Sweeps in the four directions make a
round; rounds go on until no cost changes, which takes three or four where updating all poses at once takes sixty
steps, each a quarter of a round. A row is left out where nothing that it could move into has changed since the sweep
last came by: that is most of them in the last rounds, and in the first those that no cost has reached.
"""

from __future__ import annotations

import jax
import jax.numpy as jnp
from jax import Array

from jaxlocomanip.numerics import pytree, smaller
from jaxlocomanip.planner.moves import Moves
from jaxlocomanip.planner.pose_grid import CELL_MOVES, CELLS, FAR, HEADINGS, TURNS

ROUNDS = 6
"""at most"""
SETTLED = 1e-2
"""change of cost below which a round has changed nothing"""
_SWEEPS = 4
"""of a round"""


@pytree
class Spread:
    """How far costs have spread."""

    value: Array
    """[HEADINGS, CELLS, CELLS] cost to go"""
    changed: tuple[Array, Array]
    """[CELLS] int each, number of the last sweep that changed a row across x, and across y"""
    sweeps: Array
    """[] int, so far"""
    change: Array
    """[] largest change of a cost in the last round"""


def cost_to_go(ending: Array, density: Array, moves: Moves) -> Array:
    """[HEADINGS, CELLS, CELLS] cost from each pose to where it is best to end.

    Args:
      ending: [HEADINGS, CELLS, CELLS] cost of ending at each pose.
      density: [HEADINGS, CELLS, CELLS] cost of a unit of length at each pose.
      moves: costs of moves.
    """
    by_row = [jnp.moveaxis(density, 1 + axis, 0) for axis in range(2)]

    def unsettled(now: Spread) -> Array:
        return (now.sweeps < ROUNDS * _SWEEPS) & (now.change > SETTLED)

    def around(now: Spread) -> Spread:
        new = now
        for axis in range(2):
            new = _to_and_fro(new, by_row[axis], moves, axis)
        return Spread(new.value, new.changed, new.sweeps, jnp.max(now.value - new.value))

    known = ending < FAR
    never = -2 * _SWEEPS
    reached = tuple(jnp.where(jnp.any(known, axis=(0, 2 - axis)), 0, never).astype(jnp.int32) for axis in range(2))
    first = Spread(ending, (reached[0], reached[1]), jnp.zeros((), jnp.int32), jnp.full((), FAR, density.dtype))
    return jax.lax.while_loop(unsettled, around, first).value


def _to_and_fro(now: Spread, density: Array, moves: Moves, axis: int) -> Spread:
    """Costs after two sweeps over the rows across `axis` (0: x, 1: y), backwards and forwards.

    Args:
      now: costs so far.
      density: [CELLS, HEADINGS, CELLS] cost of a unit of length, by row.
      moves: costs of moves.
      axis: across which the rows lie.
    """
    value, sweeps = jnp.moveaxis(now.value, 1 + axis, 0), now.sweeps
    along, beside = now.changed[axis], now.changed[1 - axis]
    for sign in (1, -1):
        value, along, less = _sweep(value, along, density, moves, axis, sign, sweeps)
        beside = jnp.where(less, sweeps, beside)
        sweeps = sweeps + 1
    changed = (along, beside) if axis == 0 else (beside, along)
    return Spread(jnp.moveaxis(value, 0, 1 + axis), changed, sweeps, now.change)


def _sweep(
    value: Array, changed: Array, density: Array, moves: Moves, axis: int, sign: int, number: Array
) -> tuple[Array, Array, Array]:
    """Costs by row after a sweep against the direction `sign`, when rows last changed, and what changed beside."""
    ahead = [(m, sign * move[axis], move[1 - axis]) for m, move in enumerate(CELL_MOVES) if sign * move[axis] >= 0]
    before = number - _SWEEPS

    def better(old: Array, cost: Array, done: tuple[Array, Array]) -> tuple[Array, Array]:
        # By distance: this row, as it was, and the two rows last done.
        rows = [_widened(old), *done]
        spot = moves.on_the_spot
        best = smaller(spot[0] * cost + _turned(rows[0], -1, 0), spot[1] * cost + _turned(rows[0], 1, 0))
        for m, distance, aside in ahead:
            for k, turn in enumerate(TURNS.tolist()):
                best = smaller(best, moves.by_heading[m, :, k, None] * cost + _turned(rows[distance], turn, aside))
        new = smaller(best, old)
        return new, jnp.any(new < old, axis=0)

    def row(
        carry: tuple[tuple[Array, Array], tuple[Array, Array], Array], here: tuple[Array, Array, Array]
    ) -> tuple[tuple[tuple[Array, Array], tuple[Array, Array], Array], tuple[Array, Array]]:
        done, when, less = carry
        old, cost, own = here
        # A change that this sweep itself made to the row last time came after the row had been looked at.
        stale = (own >= before) | (jnp.maximum(*when) > before)
        new, change = jax.lax.cond(stale, better, lambda old, *_: (old, jnp.zeros_like(less)), old, cost, done)
        now = jnp.where(jnp.any(change), number, own)
        return ((_widened(new), done[0]), (now, when[0]), less | change), (new, now)

    far, never = jnp.full((HEADINGS + 2 * _PAD, CELLS + 2 * _PAD), FAR, value.dtype), before - 1
    first = ((far, far), (never, never), jnp.zeros(CELLS, bool))
    (_, _, less), (new, now) = jax.lax.scan(row, first, (value, density, changed), reverse=sign > 0)
    return new, now, less


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
