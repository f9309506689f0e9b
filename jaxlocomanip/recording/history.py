"""An episode as NumPy arrays, ready to be drawn."""

from __future__ import annotations

import dataclasses
from typing import Any, NamedTuple

import jax
import numpy as np
from numpy.typing import NDArray

from jaxlocomanip.closed_loop import Log
from jaxlocomanip.outcome import CLEAR
from jaxlocomanip.robots.model import ROBOT_TYPES
from jaxlocomanip.scenario import Scenario

Floats = NDArray[np.floating[Any]]


def as_numpy(tree: Any) -> Any:
    """The same pytree with NumPy leaves."""
    return jax.tree.map(np.asarray, tree)


STRIDE = 0.5
"""s, one stride of a trot; what is averaged over it no longer shows the footfalls"""


class History(NamedTuple):
    """One episode with NumPy leaves, without the frozen rows after the scenario's duration."""

    scenario: Any
    """`Scenario` of NumPy arrays"""
    log: Any
    """`Log` of NumPy arrays, T rows"""


def history(scenario: Scenario, log: Log) -> History:
    """An episode as arrays, from a scenario without batch axis and its trajectory."""
    scenario, log = as_numpy(scenario), as_numpy(log)
    kept = max(1, int(np.sum(log.time < scenario.duration - 1e-4)))
    rows = jax.tree.map(lambda leaf: leaf[:kept], dataclasses.replace(log, path=log.time, path_time=log.time))
    searched = log.path_time <= rows.time[-1]
    rows = dataclasses.replace(rows, path=log.path[searched], path_time=log.path_time[searched])
    return History(scenario, rows)


def robot_names(scenario: Scenario) -> list[str]:
    """Names of the team's robots, such as `0_aliengo`."""
    return [f"{i}_{ROBOT_TYPES[int(kind)]}" for i, kind in enumerate(scenario.team.kind)]


def to_world(poses: Floats, points: Floats) -> Floats:
    """Points [..., K, 2] of bodies with poses [..., 3], in world coordinates, m."""
    c, s = np.cos(poses[..., 2])[..., None], np.sin(poses[..., 2])[..., None]
    x, y = points[..., 0], points[..., 1]
    return np.stack([c * x - s * y, s * x + c * y], axis=-1) + poses[..., None, :2]


def rectangle(half_length: float, half_width: float) -> Floats:
    """[4, 2] m, corners of a rectangle about the origin, its length along x, counter-clockwise."""
    return np.array([[-1, -1], [1, -1], [1, 1], [-1, 1]]) * np.array([half_length, half_width])


def contact_points(scenario: Any, view: Any) -> Floats:
    """[T, N_r, 2] m, contact points in the world, in whatever formation the team is."""
    origin = _by_formation(view, scenario.team.origin, scenario.formations.team.origin)
    normal = _by_formation(view, scenario.team.normal, scenario.formations.team.normal)
    tangent = np.stack([-normal[..., 1], normal[..., 0]], axis=-1)
    return to_world(view.pose, origin + view.offset[..., None] * tangent)


def push_directions(scenario: Any, view: Any) -> Floats:
    """[T, N_r, 2] unit push directions in the world."""
    turn = np.concatenate([np.zeros((len(view.pose), 2)), view.pose[:, 2:]], axis=1)
    return to_world(turn, _by_formation(view, scenario.team.normal, scenario.formations.team.normal))


def _by_formation(view: Any, first: Floats, others: Floats) -> Floats:
    """[T, N_r, 2] what the team has in its formation at each instant."""
    return np.concatenate([np.asarray(first)[None], np.asarray(others)])[view.formation]


def finite_clearance(distance: Floats) -> Floats:
    """Distances with NaN where there is nothing to hit."""
    return np.where(np.abs(distance) < 0.5 * CLEAR, distance, np.nan)


def psi_com(psi: Floats) -> Floats:
    """[..., 2] m, centre of mass of parameter vectors [..., 6]."""
    return psi[..., 2:4] / psi[..., :1]


def goal_errors(scenario: Scenario, pose: Floats) -> tuple[Floats, Floats]:
    """Distance [T] m and absolute heading error [T] rad of object poses [T, 3] to the goal."""
    off = pose - scenario.goal.pose
    return np.hypot(off[:, 0], off[:, 1]), np.abs((off[:, 2] + np.pi) % (2.0 * np.pi) - np.pi)


def stride_mean(values: Floats, time: Floats) -> Floats:
    """Values [T, ...] at times [T] s, evenly spaced, averaged over a `STRIDE` about each of them."""
    count = len(time)
    half = round(0.5 * STRIDE / float(time[1] - time[0])) if count > 1 else 0
    total = np.concatenate([np.zeros_like(values[:1], dtype=float), np.cumsum(values, axis=0, dtype=float)])
    rows = np.arange(count)
    first, end = np.maximum(rows - half, 0), np.minimum(rows + half + 1, count)
    return (total[end] - total[first]) / (end - first).reshape(-1, *[1] * (values.ndim - 1))


def rotated(quaternion: Floats, vector: Floats) -> Floats:
    """Vectors [..., 3] turned by unit quaternions [..., 4], w, x, y, z."""
    scalar, axis = quaternion[..., :1], quaternion[..., 1:]
    across = np.cross(axis, vector)
    return vector + 2.0 * (scalar * across + np.cross(axis, across))


def scene_points(episode: History) -> Floats:
    """[n, 2] m, corners of squares about what matters: the ways of all bodies, the goal, near obstacles."""
    scenario, log = episode
    radius = 0.3 + float(np.max(np.linalg.norm(scenario.object.vertices, axis=1)))
    bodies = [
        log.view.pose[::10, :2],
        log.view.robots[::10, :, :2].reshape(-1, 2),
        scenario.goal.pose[None, :2],
    ]
    visited = _squares(np.concatenate(bodies), radius)
    low, high = visited.min(axis=0), visited.max(axis=0)
    # An obstacle that leaves for the horizon must not shrink the rest.
    positions = log.obstacles[::10, scenario.obstacles.mask].reshape(-1, 2)
    near = positions[np.all((positions > low - 1.0) & (positions < high + 1.0), axis=1)]
    return np.concatenate([visited, _squares(near, 0.5)])


def _squares(centers: Floats, half: float) -> Floats:
    """[4 n, 2] corners of squares about centres [n, 2]."""
    return (centers[:, None] + rectangle(half, half)).reshape(-1, 2)
