"""Settings of a planner as one vector of logarithms, so that whatever searches them keeps them positive.

What starts at zero has no logarithm; a few such settings are searched by that of their distance to `-FLOORS`.

knobs = knobs_of(preset("paper"), ("weights", "constraints.robot_cbf.weight"))
config = turned(preset("paper"), knobs, jnp.zeros(len(knobs.names)))        # the preset itself
"""

from __future__ import annotations

import dataclasses
import math
from collections.abc import Sequence
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
from jax import Array
from numpy.typing import NDArray

from jaxlocomanip.checked import InputError, nearest
from jaxlocomanip.config_file import RANGES, SWITCHES
from jaxlocomanip.planner.config import Barrier, PlannerConfig

SPAN = math.log(10.0)
"""largest change of a logarithm: a setting stays between a tenth and ten times of what it was"""
FLOORS = {"Barrier.weight": 0.1, "Constraints.margin": 0.01, "Adaptation.prior_friction": 0.2}
"""of settings that may start at zero: an amount that begins to matter; they go up to nine times of it"""
FIRST = math.log(2.0)
"""logarithm at which the search of a setting that is zero begins, at its floor: at zero there is nothing to be seen"""
REACH = 1.05
"""a barrier reaches at least so many times as far as where its logarithm ends"""


@dataclasses.dataclass(frozen=True)
class Knobs:
    """Which settings are searched; hashable, so that it may be a static argument."""

    names: tuple[str, ...]
    """dotted, with the position in a tuple: `weights.pose[0]`"""
    places: tuple[int, ...]
    """among the leaves of the configuration"""
    ranges: tuple[tuple[float, float], ...]
    """allowed values"""
    floors: tuple[float, ...]
    """of settings that start at zero; zero for the others"""

    def first(self) -> NDArray[np.floating[Any]]:
        """[n] logarithms at which a search begins."""
        return np.where(np.array(self.floors) > 0.0, FIRST, 0.0)


def knobs_of(config: PlannerConfig, names: Sequence[str]) -> Knobs:
    """The settings that go by the given names, single ones or whole groups.

    Left out are switches, and settings that are zero and have no floor: those are switched off.

    Raises:
      InputError: a name that no setting has, or under which there is nothing to search.
    """
    leaves = jax.tree_util.tree_flatten_with_path(config)[0]
    dotted = [jax.tree_util.keystr(path).removeprefix(".") for path, _ in leaves]
    groups = {name[:i] for name in dotted for i, c in enumerate(name) if c in ".["}
    chosen: set[int] = set()
    for name in names:
        below = [i for i, one in enumerate(dotted) if one == name or one.startswith((f"{name}.", f"{name}["))]
        if not below:
            raise InputError(f"tune = {name!r}: no setting has this name{nearest(name, groups | set(dotted))}")
        free = [i for i in below if _is_free(config, dotted[i], leaves[i][1])]
        if not free:
            raise InputError(f"tune = {name!r}: is zero, which stays so, or a switch; nothing there can be tuned")
        chosen.update(free)
    places = tuple(sorted(chosen))
    picked = tuple(dotted[i] for i in places)
    ranges = tuple(_range(config, name) for name in picked)
    return Knobs(picked, places, ranges, tuple(_floor(config, dotted[i], leaves[i][1]) for i in places))


def turned(config: PlannerConfig, knobs: Knobs, logarithms: Array) -> PlannerConfig:
    """The configuration with the knobs [n] turned by logarithms [n] from where they are; differentiable."""
    leaves, structure = jax.tree.flatten(config)
    inside = jnp.clip(logarithms, -SPAN, SPAN)
    for i, place in enumerate(knobs.places):
        low, high = knobs.ranges[i]
        value = leaves[place] * jnp.exp(inside[i]) + knobs.floors[i] * jnp.expm1(inside[i])
        # The derivative passes the bounds: what starts at one, or was driven there by noise, has to find the way back.
        leaves[place] = value + jax.lax.stop_gradient(jnp.clip(value, low, high) - value)
    new = structure.unflatten(leaves)
    return _consistent(new, knobs)


def as_numbers(config: PlannerConfig) -> PlannerConfig:
    """The configuration with plain numbers of at most six significant digits, for a file."""
    return jax.tree.map(lambda leaf: float(f"{float(leaf):.6g}"), config)


def _consistent(config: PlannerConfig, knobs: Knobs) -> PlannerConfig:
    """The configuration with what has to be larger than a knob raised where it no longer is."""
    turned_here, constraints, pace = set(knobs.names), config.constraints, config.reference
    for name in (field.name for field in dataclasses.fields(constraints)):
        barrier = getattr(constraints, name)
        if isinstance(barrier, Barrier) and {f"constraints.{name}.{k}" for k in ("switch", "reach")} & turned_here:
            reach = jnp.maximum(jnp.asarray(barrier.reach), REACH * barrier.switch)
            constraints = dataclasses.replace(constraints, **{name: dataclasses.replace(barrier, reach=reach)})
    if {"reference.arrive", "reference.leave"} & turned_here:
        pace = dataclasses.replace(pace, leave=jnp.maximum(jnp.asarray(pace.leave), pace.arrive))
    return dataclasses.replace(config, constraints=constraints, reference=pace)


def _is_free(config: PlannerConfig, name: str, value: Any) -> bool:
    return _kind(config, name) not in SWITCHES and float(value) + _floor(config, name, value) > 0.0


def _range(config: PlannerConfig, name: str) -> tuple[float, float]:
    """Allowed values of a setting."""
    return RANGES.get(_kind(config, name), (0.0, 1e9))


def _floor(config: PlannerConfig, name: str, value: Any) -> float:
    return FLOORS.get(_kind(config, name), 0.0) if float(value) == 0.0 else 0.0


def _kind(config: PlannerConfig, name: str) -> str:
    """Class and field of a setting."""
    *groups, field = name.partition("[")[0].split(".")
    node: Any = config
    for group in groups:
        node = getattr(node, group)
    return f"{type(node).__name__}.{field}"


def changes(before: PlannerConfig, after: PlannerConfig, knobs: Knobs) -> dict[str, tuple[float, float]]:
    """Values of each knob in two configurations, by name."""
    old, new = jax.tree.leaves(before), jax.tree.leaves(after)
    return {name: (float(old[k]), float(new[k])) for name, k in zip(knobs.names, knobs.places, strict=True)}
