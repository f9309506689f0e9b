"""Where an obstacle would have been hit worst, had the object moved as it did.

A gradient of the clearance says in which direction an obstacle has to be moved, not how far. With the motion of an
episode held fixed the answer is plain: a convex body is overlapped most deeply by an obstacle that is centred on it, so
its ways through all places of the object are tried, and the clearance there is a matter of geometry. The object will
not move as it did; but what has to be simulated are a few promising scenarios, not many random ones. Before anything
has been simulated, it is supposed to go straight to its goal.
"""

from __future__ import annotations

import dataclasses
from typing import Any

import jax
import numpy as np
from numpy.typing import NDArray

from jaxlocomanip.footprint import placed, polygon_gap
from jaxlocomanip.scenario import Obstacles, Scenario
from jaxlocomanip.variation import BODY, NOISE, Bounds

Floats = NDArray[np.floating[Any]]

INSTANTS = 80
"""of an episode that are looked at"""


@dataclasses.dataclass(frozen=True)
class Motion:
    """Some instants of an episode."""

    pose: Floats
    """[K, 3] of the object"""
    obstacles: Floats
    """[K, N_o, 2] m"""


@dataclasses.dataclass(frozen=True)
class Aim:
    """Other coordinates of a scenario, and the clearance there if the object moved as before."""

    clearance: float
    coordinates: Floats


_places = jax.jit(jax.vmap(Obstacles.at, in_axes=(None, 0)))


def straight_motion(scenario: Scenario, speed: float) -> Motion:
    """The object on its way straight from start to goal, as fast as m/s `speed`, the obstacles on theirs."""
    start, goal = (np.asarray(pose, float) for pose in (scenario.start, scenario.goal.pose))
    way = goal - start
    way[2] = np.remainder(way[2] + np.pi, 2.0 * np.pi) - np.pi
    times = np.linspace(0.0, float(scenario.duration), INSTANTS)
    done = np.minimum(speed * times / max(float(np.hypot(*way[:2])), 1e-6), 1.0)
    return Motion(start + done[:, None] * way, np.asarray(_places(scenario.obstacles, times)))


def aims(scenario: Scenario, coordinates: Floats, motion: Motion, bounds: Bounds) -> list[Aim]:
    """One for each obstacle and instant, the least clearance first.

    Args:
      scenario: without batch axis.
      coordinates: [d] of the scenario.
      motion: of the object in it.
      bounds: how far obstacles may be displaced.
    """
    vertices, radii = np.asarray(scenario.obstacles.vertices), np.asarray(scenario.obstacles.radius)
    body = placed(motion.pose, np.asarray(scenario.object.vertices))
    found: list[Aim] = []
    for k in np.flatnonzero(np.asarray(scenario.obstacles.mask)):
        first = BODY + NOISE + 4 * int(k)
        middle = motion.obstacles[:, k] + 0.5 * (vertices[k].max(axis=0) + vertices[k].min(axis=0))
        wanted = coordinates[first : first + 2] + (body.mean(axis=1) - middle) / bounds.shift
        shift = np.clip(wanted, -1.0, 1.0)
        moved = motion.obstacles[:, k] + bounds.shift * (shift - coordinates[first : first + 2])
        gap = polygon_gap(body, moved[:, None, :] + vertices[k], radii[k])
        for instant, clearance in enumerate(gap):
            other = coordinates.copy()
            other[first : first + 2] = shift[instant]
            found.append(Aim(float(clearance), other))
    return sorted(found, key=lambda aim: aim.clearance)
