"""From the cost to go back to a path: the cheapest node to begin with, then move by move to the goal.

A team that cannot pull cannot correct a miss on the spot, so its cost to go jumps: beside and behind the goal it is
that of a whole loop. Interpolation would smear the jump and lead off it; the moves of the grid do not.
"""

from __future__ import annotations

import jax
import jax.numpy as jnp
import numpy as np
from jax import Array

from jaxlocomanip.numerics import Floats, safe_norm
from jaxlocomanip.planar.dynamics import Body
from jaxlocomanip.planar.geometry import cross, rotate
from jaxlocomanip.planner.moves import Moves, misfit, unpushable
from jaxlocomanip.planner.pose_grid import CELL_MOVES, CELLS, FAR, HEADINGS, TURN, TURNS, Grid
from jaxlocomanip.planner.shapes import Shapes

STEPS = 96
"""moves of a path at most"""
_REACH = 2
"""cells around the start among which the first node is chosen"""
_TIE = 1e-3
"""m, cost of a cell off the straight line: of equal moves, in whatever order, mirror images choose mirror images"""
_EARLY = 0.37
"""of it, cost of a bin off the goal's heading"""
_MOVES = np.array([(t, *move) for move in CELL_MOVES for t in TURNS] + [(-1, 0, 0), (1, 0, 0)])
"""[n, 3] heading bins and cells of all moves, in the order of `Moves`"""
_NEIGHBOURS = np.array(
    [(h, i, j) for h in TURNS for i in range(-_REACH, _REACH + 1) for j in range(-_REACH, _REACH + 1)]
)


def descend(
    start: Array,
    first: Array,
    grid: Grid,
    value: Array,
    ending: Array,
    density: Array,
    moves: Moves,
) -> tuple[Array, Array]:
    """[STEPS + 2, 3] goal-frame poses from the start to an end, where they stay; the heading is continuous.

    Also the last node [3].

    Args:
      start: [3] goal-frame pose.
      first: [3] node to begin with (`first_node`).
      grid: the grid.
      value: [HEADINGS, CELLS, CELLS] cost to go.
      ending: [HEADINGS, CELLS, CELLS] cost of ending at each pose.
      density: [HEADINGS, CELLS, CELLS] cost of a unit of length.
      moves: costs of moves.
    """

    def aside(nodes: Array) -> Array:
        """[n] distance of nodes [n, 3] from the straight line and from the goal's heading, in cells and bins."""
        line = start[:2] / (safe_norm(start[:2]) + grid.spacing)
        bins = nodes[:, 0] - HEADINGS * jnp.rint(nodes[:, 0] / HEADINGS)
        return jnp.abs(cross((nodes[:, 1:] - grid.goal_cell).astype(start.dtype), line)) + _EARLY * jnp.abs(bins)

    def step(node: Array, _: None) -> tuple[Array, Array]:
        here = _inside(node)
        price = jnp.concatenate([moves.by_heading[:, here[0]].reshape(-1), moves.on_the_spot])
        targets = node + jnp.asarray(_MOVES, node.dtype)
        cost = price * density[here[0], here[1], here[2]] + _at(value, targets) + _TIE * aside(targets)
        arrived = ending[here[0], here[1], here[2]] <= value[here[0], here[1], here[2]]
        new = jnp.where(arrived, node, targets[jnp.argmin(cost)])
        return new, new

    last, rest = jax.lax.scan(step, first, None, length=STEPS)
    nodes = jnp.concatenate([first[None], rest]).astype(start.dtype)
    poses = jnp.concatenate([grid.origin + grid.spacing * nodes[:, 1:], TURN * nodes[:, :1]], axis=1)
    return jnp.concatenate([start[None], poses]), _inside(last)


def first_node(
    start: Array, grid: Grid, value: Array, density: Array, shapes: Shapes, body: Body, turn_radius: Floats
) -> tuple[Array, Array]:
    """Heading bin and cell [3] of the node at which a path from the pose `start` [3] had best begin, and its cost."""
    bin_ = jnp.rint(start[2] / TURN).astype(jnp.int32)
    cell = jnp.rint((start[:2] - grid.origin) / grid.spacing).astype(jnp.int32)
    here = jnp.concatenate([bin_[None], cell])
    nodes = here + jnp.asarray(_NEIGHBOURS, here.dtype)
    places = grid.origin + grid.spacing * nodes[:, 1:]
    change = jnp.concatenate([places - start[:2], TURN * nodes[:, :1] - start[2]], axis=1)
    middle = start[2] + 0.5 * change[:, 2]
    twists_B = jnp.concatenate([jax.vmap(rotate)(-middle, change[:, :2]), change[:, 2:]], axis=1)
    length = jnp.sqrt(jnp.sum(change[:, :2] ** 2, axis=1) + (turn_radius * change[:, 2]) ** 2)
    at = _inside(here)
    price = length * unpushable(misfit(shapes, body, twists_B)) * density[at[0], at[1], at[2]]
    total = price + _at(value, nodes)
    best = jnp.argmin(total)
    return nodes[best], total[best]


def _inside(node: Array) -> Array:
    """Indices [..., 3] of nodes [..., 3] whose headings wrap and whose cells are held at the border."""
    return jnp.concatenate([node[..., :1] % HEADINGS, jnp.clip(node[..., 1:], 0, CELLS - 1)], axis=-1)


def _at(value: Array, nodes: Array) -> Array:
    """[n] cost to go at nodes [n, 3]; far outside of the grid."""
    at = _inside(nodes)
    within = jnp.all(nodes[:, 1:] == at[:, 1:], axis=1)
    return jnp.where(within, value[at[:, 0], at[:, 1], at[:, 2]], 2.0 * FAR)
