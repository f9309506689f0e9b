"""When to go on along the path and when to wait, past obstacles that move.

A team that only stops for what comes its way is run over where it stops: to cross an obstacle's way takes it seconds,
longer than any filter on the next input looks ahead. So time is planned along the path (path-velocity decomposition;
Kant & Zucker, Int. J. Robotics Research 5(3), 1986): dynamic programming over how far the team is (in seconds at its
usual speed) and when, with the moves "go on" and "wait". Wherever the team is at a time, waiting or not, the true
shapes of object and robots keep room to where the obstacles are predicted to be. The schedule is made anew every tick,
and only its first move is used.

The choice is piecewise constant and is held fixed when gradients are taken.
"""

from __future__ import annotations

import jax
import jax.numpy as jnp
import numpy as np
from jax import Array

from jaxlocomanip.planner import reference
from jaxlocomanip.planner.config import PlannerConfig
from jaxlocomanip.planner.estimation import PREDICTED
from jaxlocomanip.planner.path import Path
from jaxlocomanip.planner.reference import Progress
from jaxlocomanip.planner.room import bodies_of, rooms_at
from jaxlocomanip.planner.shapes import Shapes
from jaxlocomanip.planner.situation import Situation

STEP, STEPS = 0.5, 16
"""s, of a move, and how many are planned"""
DRIFT = 0.05
"""m/s, by which the room asked for grows with time: nobody walks at constant velocity for long"""
BERTH = 0.2
"""m, of room below which a moment costs a little"""
_OVERLAP = 100.0
"""cost of a metre of missing room in one moment; waiting for a step costs 1"""
_HIT = 20.0
"""cost of a moment of contact"""
_CHANGE = 1.0
"""cost of another first move than before, lest noise decide"""
_REACHED = np.array([(j, k) for k in range(STEPS + 1) for j in range(k + 1)]).T
"""steps made and steps of time of all moments that can be reached"""


def has_to_wait(path: Path, progress: Progress, situation: Situation, shapes: Shapes, config: PlannerConfig) -> Array:
    """[] bool: the best schedule begins with waiting.

    Args:
      path: in force.
      progress: on it; whether the team waits now.
      situation: what is known.
      shapes: geometry.
      config: settings.
    """
    given = jax.lax.stop_gradient((path, progress, situation, shapes, config))
    room = moments(*given)
    price = _OVERLAP * jnp.maximum(-room, 0.0) + jnp.maximum(BERTH - room, 0.0)
    price = price + jnp.where(room < -config.safety.margin, _HIT, 0.0)
    # What comes to and fro turns round before it gets to where it would be much later.
    price = price * jnp.asarray(np.exp(-((STEP * _REACHED[1] / PREDICTED) ** 2)), price.dtype)
    wait, on = _first_moves(price)
    return jnp.where(progress.held, wait < on + _CHANGE, wait + _CHANGE < on)


def _first_moves(price: Array) -> tuple[Array, Array]:
    """Costs [] of the best schedules that begin with waiting and with going on, given those of the moments [n]."""
    places = np.full((STEPS + 1, STEPS + 1), price.shape[0])
    places[_REACHED[0], _REACHED[1]] = np.arange(price.shape[0])
    at = jnp.append(price, 0.0)[places]
    value = at[:, STEPS]
    for k in range(STEPS - 1, 0, -1):
        value = at[:, k] + jnp.minimum(jnp.append(value[1:], jnp.inf), 1.0 + value)
    return 1.0 + value[0], value[1]


def moments(path: Path, progress: Progress, situation: Situation, shapes: Shapes, config: PlannerConfig) -> Array:
    """[n] m, room to obstacles that move, beyond what is asked for, at the moments `_REACHED`; arguments as above."""
    places = [progress.projected]
    for _ in range(STEPS):
        places.append(places[-1] + STEP * reference.speed_at(places[-1], path, config.reference))
    along = jnp.stack(places)
    poses = path.at(along).at[0].set(situation.estimate.pose)
    offsets = path.feed_forward(along)[1].at[0].set(situation.offset)
    made, passed = _REACHED
    times = STEP * jnp.asarray(passed, along.dtype)
    obstacles = situation.obstacles
    moved = obstacles.position[..., None] + times * obstacles.velocity[..., None]
    room = rooms_at(poses[made].T, offsets[made].T, moved, bodies_of(shapes, config)).moving
    return room - config.safety.margin - DRIFT * times
