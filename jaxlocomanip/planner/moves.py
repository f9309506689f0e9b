"""What moves between the poses of the grid cost a team that can only push."""

from __future__ import annotations

import jax.numpy as jnp
import numpy as np
from jax import Array

from jaxlocomanip.numerics import Floats, pytree
from jaxlocomanip.planar.dynamics import Body
from jaxlocomanip.planner.authority import pushability
from jaxlocomanip.planner.pose_grid import DIRECTIONS, HEADINGS, LENGTHS, TURN, TURNS
from jaxlocomanip.planner.shapes import Shapes

_UNPUSHABLE = 200.0
"""times dearer is a move for which the team has no wrench at all: a loop of several metres is cheaper than one cell"""
_INEXACT = 0.02
"""relative residual below which a wrench counts as found"""
_EDGE = 1.5
"""weight of the neighbouring moves' unpushability: keeps away from the edge of what the team can do"""
_SPOT = 1.5
"""cost factor of a turn on the spot, if the team could make one"""


@pytree
class Moves:
    """Costs of moves where the density of cost is one."""

    by_heading: Array
    """[DIRECTIONS in the goal's frame, HEADINGS, TURNS]"""
    on_the_spot: Array
    """[2] turns by -TURN, TURN"""


def price_moves(shapes: Shapes, body: Body, spacing: Array, turn_radius: Floats) -> Moves:
    """Costs of all moves on a grid.

    Args:
      shapes: geometry and team.
      body: the object as estimated.
      spacing: [] m.
      turn_radius: m, length of a radian.
    """
    factors, spots = _factors(shapes, body, spacing)
    heading, each = np.arange(HEADINGS), []
    for m in range(DIRECTIONS):
        length = jnp.sqrt((LENGTHS[m] * spacing) ** 2 + (turn_radius * TURN * TURNS) ** 2)
        each.append(factors[(m * HEADINGS // DIRECTIONS - heading) % HEADINGS] * length)
    return Moves(jnp.stack(each), turn_radius * TURN * spots)


def misfit(shapes: Shapes, body: Body, twists_B: Array) -> Array:
    """[n] how far the team is from being able to push the object along twists [n, 3]; 0: it can, 1: not at all."""
    residual = pushability(shapes.team, body, twists_B, shapes.torsion_radius)
    return jnp.maximum(residual - _INEXACT, 0.0)


def unpushable(misfits: Array) -> Array:
    """Cost factors of moves with these misfits."""
    return 1.0 + _UNPUSHABLE * misfits


def _factors(shapes: Shapes, body: Body, spacing: Array) -> tuple[Array, Array]:
    """Cost factors of moves [HEADINGS, directions in the body frame, TURNS] and of turns on the spot [2]."""
    turn = jnp.asarray(TURN * TURNS, spacing.dtype)
    # A move that turns is made, on the whole, at the heading half-way.
    angles = (TURN * jnp.arange(HEADINGS, dtype=spacing.dtype)[:, None] - 0.5 * turn).reshape(-1)
    advance = 1.5 * spacing * jnp.stack([jnp.cos(angles), jnp.sin(angles)], axis=1)
    twists = jnp.concatenate([advance, jnp.tile(turn, HEADINGS)[:, None]], axis=1)
    spots = jnp.array([[0.0, 0.0, -TURN], [0.0, 0.0, TURN]], spacing.dtype)
    misfits = misfit(shapes, body, jnp.concatenate([twists, spots]))
    table = misfits[:-2].reshape(HEADINGS, len(TURNS))
    beside = 0.5 * (jnp.roll(table, 1, axis=0) + jnp.roll(table, -1, axis=0))
    return unpushable(table) + _EDGE * beside, _SPOT * unpushable(misfits[-2:])
