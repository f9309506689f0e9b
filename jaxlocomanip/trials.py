"""Varied scenarios of a study in batches: their episodes, and gradients of the clearance by the coordinates."""

from __future__ import annotations

import dataclasses
import math
from collections.abc import Iterator, Sequence
from functools import partial
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
from jax import Array
from numpy.typing import NDArray

from jaxlocomanip.aiming import INSTANTS, Motion
from jaxlocomanip.approach import closest_approach
from jaxlocomanip.build import start_gaps
from jaxlocomanip.closed_loop import episode
from jaxlocomanip.outcome import Outcome
from jaxlocomanip.padding import stack
from jaxlocomanip.planner.config import PlannerConfig
from jaxlocomanip.sampling.feasibility import judged
from jaxlocomanip.sampling.sampler import Lane
from jaxlocomanip.sampling.study import Study
from jaxlocomanip.scenario import Scenario
from jaxlocomanip.specification import ScenarioSpec
from jaxlocomanip.sweep.plan import longest, padding
from jaxlocomanip.variation import Bounds, dimension, varied_spec, vary
from jaxlocomanip.worlds.planar import PlanarWorld

Floats = NDArray[np.floating[Any]]


@dataclasses.dataclass(frozen=True)
class Found:
    """A scenario and what the planner made of it."""

    spec: ScenarioSpec
    seed: int
    """of the measurement noise: `simulate(build(spec), config, seed=seed)` is this episode, but for rounding"""
    clearance: float
    """m, least distance of object and robots to the obstacles"""
    team_clearance: float
    """m, least distance of robots to each other"""
    run_over: bool
    """see `Outcome.run_over`"""
    reached: bool
    motion: Motion = dataclasses.field(compare=False, repr=False)
    """some instants of it"""

    @property
    def hit_obstacle(self) -> bool:
        """Whether object or robots overlapped an obstacle, and were not merely run over (`Outcome.run_over`)."""
        return self.clearance < 0.0 and not self.run_over

    @property
    def robots_touched(self) -> bool:
        """Whether robots overlapped each other."""
        return self.team_clearance < 0.0


@dataclasses.dataclass(frozen=True)
class Place:
    """A scenario of a study at coordinates within the bounds."""

    lane: Lane
    seed: int
    coordinates: Floats
    spec: ScenarioSpec
    scenario: Scenario


def place_at(lane: Lane, seed: int, coordinates: Floats, bounds: Bounds) -> Place | None:
    """A varied scenario; None where no planner could solve it, or an obstacle is too near at the start."""
    spec = varied_spec(lane.spec, lane.scenario, coordinates, bounds)
    if (start_gaps(spec) < bounds.start_room).any():
        return None
    scenario = judged(spec, 0)
    return None if isinstance(scenario, str) else Place(lane, seed, coordinates, spec, scenario)


class Trials:
    """Runs scenarios of a study, and takes gradients of them, in batches of one shape each."""

    def __init__(
        self, study: Study, config: PlannerConfig, bounds: Bounds, lanes: int, window: int = 1, memory: float = math.inf
    ) -> None:
        """Batches of so many lanes; gradients over a window of so many ticks (`approach.closest_approach`)."""
        self._config = jax.tree.map(jnp.asarray, config)
        self._bounds = jax.tree.map(jnp.asarray, bounds)
        self._padding = padding(study)
        self._ticks = math.ceil(longest(study) / config.horizon.tick - 1e-6)
        self._lanes = lanes
        self._window = window
        self._memory = jnp.asarray(memory)

    def run(self, places: Sequence[Place]) -> list[tuple[Place, Found]]:
        """Each with its outcome."""
        pairs: list[tuple[Place, Found]] = []
        for part, full in self._batches(places):
            scenarios = stack([place.scenario for place in full], self._padding)
            world = PlanarWorld().prepare(scenarios)
            results = _outcomes(scenarios, self._config, _seeds(full), world, ticks=self._ticks)
            outcome, poses, obstacles = jax.tree.map(np.asarray, results)
            pairs += [
                (place, _found(place, outcome, Motion(poses[k], obstacles[k]), k)) for k, place in enumerate(part)
            ]
        return pairs

    def gradients(self, places: Sequence[Place]) -> list[Floats]:
        """Of the soft clearance by the coordinates [d] of each place; zero where they are not finite."""
        rows: list[Floats] = []
        for part, full in self._batches(places):
            slopes = self._slopes(full)
            finite = np.isfinite(slopes).all(axis=1, keepdims=True)
            every = np.where(finite, slopes, 0.0)
            rows += [row[: len(place.coordinates)] for row, place in zip(every, part, strict=False)]
        return rows

    def _slopes(self, places: Sequence[Place]) -> Floats:
        scenarios = stack([place.lane.scenario for place in places], self._padding)
        scenarios = dataclasses.replace(scenarios, index=jnp.zeros_like(scenarios.index))
        coordinates = np.zeros((len(places), dimension(jax.tree.map(lambda leaf: leaf[0], scenarios))))
        for row, place in zip(coordinates, places, strict=True):
            row[: len(place.coordinates)] = place.coordinates
        where = jnp.asarray(coordinates, scenarios.start.dtype)
        given = (where, scenarios, self._config, _seeds(places), self._bounds, self._memory)
        return np.asarray(_slopes(*given, ticks=self._ticks, window=self._window), float)

    def _batches(self, places: Sequence[Place]) -> Iterator[tuple[list[Place], list[Place]]]:
        """Places in groups, and each group filled up to the size of a batch."""
        for first in range(0, len(places), self._lanes):
            part = list(places[first : first + self._lanes])
            yield part, part + part[-1:] * (self._lanes - len(part))


def _seeds(places: Sequence[Place]) -> Array:
    return jnp.asarray([place.seed for place in places], jnp.uint32)


@partial(jax.jit, static_argnames="ticks")
def _outcomes(
    scenarios: Scenario, config: PlannerConfig, seeds: Array, world: PlanarWorld, *, ticks: int
) -> tuple[Outcome, Array, Array]:
    """[B] outcomes of the exact world; at some instants the object's poses [B, K, 3], the obstacles [B, K, N_o, 2]."""
    every = max(1, ticks // INSTANTS)

    def one(scenario: Scenario, seed: Array, behind: PlanarWorld) -> tuple[Outcome, Array, Array]:
        result = episode(scenario, config, jax.random.key(seed), behind, ticks, record=True)
        assert result.log is not None
        return result.outcome, result.log.view.pose[::every], result.log.obstacles[::every]

    return jax.vmap(one)(scenarios, seeds, world)


@partial(jax.jit, static_argnames=("ticks", "window"))
def _slopes(
    coordinates: Array,
    scenarios: Scenario,
    config: PlannerConfig,
    seeds: Array,
    bounds: Bounds,
    memory: Array,
    *,
    ticks: int,
    window: int,
) -> Array:
    """[B, d] gradients of the soft clearance."""

    def clearance(where: Array, scenario: Scenario, seed: Array) -> Array:
        made = vary(scenario, where, bounds)
        return closest_approach(made, config, ticks, window, key=jax.random.key(seed), memory=memory)

    return jax.vmap(jax.grad(clearance))(coordinates, scenarios, seeds)


def _found(place: Place, outcome: Outcome, motion: Motion, k: int) -> Found:
    return Found(
        spec=place.spec,
        seed=place.seed,
        clearance=float(min(outcome.min_object_clearance_m[k], outcome.min_robot_clearance_m[k])),
        team_clearance=float(outcome.min_team_clearance_m[k]),
        run_over=bool(outcome.run_over[k]),
        reached=bool(outcome.reached[k]),
        motion=motion,
    )
