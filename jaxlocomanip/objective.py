"""What tuning minimises: the loss of an episode, and losses and gradients of settings over batches of scenarios."""

from __future__ import annotations

from functools import partial
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
from jax import Array
from numpy.typing import NDArray
from scipy import stats

from jaxlocomanip.gradients import SoftOutcome, off_goal, soft_outcome
from jaxlocomanip.knobs import Knobs, turned
from jaxlocomanip.numerics import pytree
from jaxlocomanip.planner.config import PlannerConfig
from jaxlocomanip.scenario import Scenario

Floats = NDArray[np.floating[Any]]

TRIMMED = 0.25
"""share of the lanes, at either end, whose derivatives do not count towards the mean"""
WORST = 1e3
"""loss of an episode with numbers that are not finite"""


@pytree
class Objective:
    """Loss of a scenario, from its soft outcome."""

    clearance: float = 0.05
    """m, wanted of the soft minima between bodies and obstacles, and between robots (too large where it is brief)"""
    softness: float = 0.02
    """m, over which the penalty of less sets in"""
    danger: float = 40.0
    """1/m, of clearance that is missing"""
    arrival: float = 1.0
    """of ln(1 + (error / tolerance)^2), for position and heading at the end"""
    approach: float = 5.0
    """of the mean of the same over the episode: what brings the object nearer shows at once, not only at the end"""
    time: float = 1.0
    """of the share of the time spent outside the goal tolerances"""
    effort: float = 1e-5
    """1/(N^2 s)"""


def loss(outcome: SoftOutcome, scenario: Scenario, objective: Objective) -> Array:
    """[] loss of an episode: finite and, but for the missing clearance and the effort, of slow growth."""
    goal, soft = scenario.goal, objective.softness
    clearances = jnp.stack([outcome.clearance_m, outcome.team_clearance_m])
    missing = jnp.sum(soft * jax.nn.softplus((objective.clearance - clearances) / soft))
    position = outcome.goal_error_m2 / goal.position_tolerance**2
    heading = outcome.heading_error_rad2 / goal.heading_tolerance**2
    time = outcome.time_s / scenario.duration
    total = (
        objective.danger * missing
        + objective.arrival * off_goal(position, heading)
        + objective.approach * outcome.off_goal
        + objective.time * time
        + objective.effort * outcome.effort_n2s
    )
    return jnp.where(outcome.alive, total, WORST)


def picked(scenarios: Scenario, lanes: NDArray[np.integer[Any]]) -> Scenario:
    """Some lanes of a batch."""
    return jax.tree.map(lambda leaf: leaf[lanes], scenarios)


class Losses:
    """Losses of settings over scenarios, and their gradients, in batches of one shape each."""

    def __init__(
        self, base: PlannerConfig, knobs: Knobs, aim: Objective, ticks: int, batch: int, memory: float
    ) -> None:
        """Of episodes of so many ticks; gradients fade with `memory`, s, and are of single iterations of plans."""
        self._given = (base, jax.tree.map(jnp.asarray, aim), jnp.asarray(memory))
        self._static = {"knobs": knobs, "ticks": ticks}
        self._batch = batch
        self.count = len(knobs.names)

    def of(self, settings: Floats, scenarios: Scenario) -> Floats:
        """[p] mean losses of settings [p, n] over scenarios [B]."""
        return np.stack([self.each(one, scenarios).mean() for one in settings])

    def each(self, center: Floats, scenarios: Scenario) -> Floats:
        """[B] losses of the settings [n]."""
        values = _values(jnp.asarray(center, jnp.float32), scenarios, *self._given, **self._static)
        return _finite(values)

    def mean(self, scenarios: Scenario, center: Floats | None = None) -> float:
        """Mean loss over any number of scenarios, a batch at a time."""
        where = np.zeros(self.count) if center is None else center
        total = int(scenarios.duration.shape[0])
        values: list[float] = []
        for first in range(0, total, self._batch):
            lanes = np.minimum(np.arange(first, first + self._batch), total - 1)
            part = self.each(where, picked(scenarios, lanes))
            values += part[: total - first].tolist()
        return float(np.mean(values))

    def slopes(self, center: Floats, scenarios: Scenario) -> tuple[float, Floats, int]:
        """Mean loss, trimmed mean of the lanes' gradients [n], and how many lanes had none that is finite."""
        values, slopes = _slopes(jnp.asarray(center, jnp.float32), scenarios, *self._given, **self._static)
        rows = np.asarray(slopes, float)
        finite = np.isfinite(rows).all(axis=1)
        return float(_finite(values).mean()), trimmed_mean(rows[finite]), int(np.sum(~finite))


def trimmed_mean(rows: Floats) -> Floats:
    """[n] mean of rows [B, n], in each column without the least and the largest; zero of no rows."""
    return stats.trim_mean(rows, TRIMMED, axis=0) if len(rows) else np.zeros(rows.shape[1])


def _finite(values: Array) -> Floats:
    """Losses [B]; a lane that is lost altogether counts as very bad, and not more."""
    return np.nan_to_num(np.asarray(values, float), nan=WORST, posinf=WORST, neginf=WORST)


def _loss_of(
    center: Array, scenario: Scenario, base: PlannerConfig, aim: Objective, memory: Array, knobs: Knobs, ticks: int
) -> Array:
    outcome = soft_outcome(scenario, turned(base, knobs, center), ticks, memory=memory, plans=0.0)
    return loss(outcome, scenario, aim)


@partial(jax.jit, static_argnames=("knobs", "ticks"))
def _values(
    center: Array, scenarios: Scenario, base: PlannerConfig, aim: Objective, memory: Array, *, knobs: Knobs, ticks: int
) -> Array:
    return jax.vmap(lambda s: _loss_of(center, s, base, aim, memory, knobs, ticks))(scenarios)


@partial(jax.jit, static_argnames=("knobs", "ticks"))
def _slopes(
    center: Array, scenarios: Scenario, base: PlannerConfig, aim: Objective, memory: Array, *, knobs: Knobs, ticks: int
) -> tuple[Array, Array]:
    one = jax.value_and_grad(_loss_of)
    return jax.vmap(lambda s: one(center, s, base, aim, memory, knobs, ticks))(scenarios)
