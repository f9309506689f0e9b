"""Scenarios of unlike layouts in one batch: padded to common shapes, and stacked.

Absent obstacles and formations are masked, outlines repeat their last entry, so that different layouts share one
compilation.
"""

from __future__ import annotations

import dataclasses
from collections.abc import Sequence
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np

from jaxlocomanip.checked import InputError
from jaxlocomanip.scenario import Formations, Obstacles, Scenario


def pad_obstacles(obstacles: Obstacles, count: int) -> Obstacles:
    """The same obstacles followed by absent ones, `count` in all, with NumPy leaves; absent ones stand far away."""
    missing = count - obstacles.mask.shape[0]
    if missing < 0:
        raise InputError(f"obstacles: {obstacles.mask.shape[0]} do not fit into {count}")

    def grow(leaf: Any, fill: float) -> Any:
        leaf = np.asarray(leaf)
        return np.concatenate([leaf, np.full((missing, *leaf.shape[1:]), fill, dtype=leaf.dtype)])

    padded = jax.tree.map(lambda leaf: grow(leaf, 0), obstacles)
    return dataclasses.replace(
        padded,
        position=grow(obstacles.position, 1e3),
        period=grow(obstacles.period, 1.0),
        radius=grow(obstacles.radius, 0.1),
    )


@dataclasses.dataclass(frozen=True)
class Padding:
    """Shapes that the scenarios of a batch are padded to; equal ones share one compilation."""

    obstacles: int = 1
    """obstacles"""
    corners: int = 4
    """vertices of an obstacle"""
    marks: int = 1
    """waypoints of an obstacle"""
    vertices: int = 1
    """vertices of the object"""
    discs: int = 1
    """discs that cover the object"""
    formations: int = 0
    """formations that a team may change to"""

    @staticmethod
    def of(scenarios: Sequence[Scenario]) -> Padding:
        """The least padding that scenarios can share."""
        return Padding(
            obstacles=max(s.obstacles.mask.shape[0] for s in scenarios),
            corners=max(s.obstacles.vertices.shape[1] for s in scenarios),
            marks=max(s.obstacles.times.shape[1] for s in scenarios),
            vertices=max(s.object.vertices.shape[0] for s in scenarios),
            discs=max(s.object.disc_radii.shape[0] for s in scenarios),
            formations=max(s.formations.usable.shape[0] for s in scenarios),
        )


def stack(scenarios: Sequence[Scenario], padding: Padding | None = None) -> Scenario:
    """One batch [B, ...] of scenarios with teams of one size, on the device.

    Args:
      scenarios: at least one.
      padding: shapes to pad to; by default the least that they can share. Obstacles are padded by absent ones, shapes
        (vertices, waypoints, covering discs) by repeating their last entry.

    Raises:
      InputError: no scenarios, teams of different sizes, or a scenario larger than the padding.
    """
    return jax.tree.map(jnp.asarray, stack_on_host(scenarios, padding))


def stack_on_host(scenarios: Sequence[Scenario], padding: Padding | None = None) -> Scenario:
    """`stack` with NumPy leaves, for whoever decides where to put them.

    Raises:
      InputError: as `stack`.
    """
    if not scenarios:
        raise InputError("scenarios: at least one is needed")
    sizes = {s.team.offset.shape[0] for s in scenarios}
    if len(sizes) > 1:
        raise InputError(f"team sizes {sorted(sizes)}: scenarios of one batch must have teams of one size")
    least = Padding.of(scenarios)
    padding = padding or least
    for field in dataclasses.fields(padding):
        if getattr(least, field.name) > getattr(padding, field.name):
            raise InputError(
                f"padding.{field.name} = {getattr(padding, field.name)}: must be >= {getattr(least, field.name)}"
            )
    grown = [_padded(s, padding) for s in scenarios]
    return jax.tree.map(lambda *leaves: np.stack(leaves), *grown)


def _padded(scenario: Scenario, padding: Padding) -> Scenario:
    """One scenario with NumPy leaves of the padded shapes."""
    obstacles = pad_obstacles(scenario.obstacles, padding.obstacles)
    body = scenario.object
    return dataclasses.replace(
        scenario,
        object=dataclasses.replace(
            body,
            vertices=_repeat_last(body.vertices, padding.vertices, axis=0),
            disc_centers=_repeat_last(body.disc_centers, padding.discs, axis=0),
            disc_radii=_repeat_last(body.disc_radii, padding.discs, axis=0),
        ),
        formations=_padded_formations(scenario, padding.formations),
        obstacles=dataclasses.replace(
            obstacles,
            vertices=_repeat_last(obstacles.vertices, padding.corners, axis=1),
            times=_repeat_last(obstacles.times, padding.marks, axis=1),
            waypoints=_repeat_last(obstacles.waypoints, padding.marks, axis=1),
        ),
    )


def _padded_formations(scenario: Scenario, count: int) -> Formations:
    """Formations followed by unusable ones, `count` in all."""
    present = scenario.formations
    missing = count - present.usable.shape[0]

    def grow(leaf: Any, own: Any) -> Any:
        return np.concatenate([np.asarray(leaf), np.broadcast_to(np.asarray(own), (missing, *np.shape(own)))])

    return Formations(jax.tree.map(grow, present.team, scenario.team), grow(present.usable, False))


def _repeat_last(leaf: Any, count: int, axis: int) -> Any:
    leaf = np.asarray(leaf)
    present = leaf.shape[axis]
    return leaf if present == count else np.take(leaf, np.minimum(np.arange(count), present - 1), axis=axis)
