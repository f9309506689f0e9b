"""Tuning of a planner's settings over scenarios, by stochastic gradient or without gradients.

    settings = Settings(names=("weights", "constraints.robot_cbf"), steps=40)
    tuned = tune(preset("paper"), train, held_out, ticks=400, settings=settings, checkpoint=Path("out/tune.json"))
    Path("out/tuned.toml").write_text(config_to_toml(tuned.config))            # for --config

A setting is searched by its logarithm relative to where it starts (`knobs.py`), so it stays positive. Every step sees
a random part of the training scenarios. The loss of a scenario is a smooth function of its soft outcome: clearance,
errors at the goal, time and effort. The settings that are returned are those, of all that were validated, with the
least loss on the scenarios that were held out.

Pushing is unstable, and a few lanes have gradients many orders of magnitude larger than the others'. Of each
derivative the largest and the least quarters of the lanes are therefore left out of the mean that decides. The
method `cem`, the cross-entropy method, needs no gradients: it draws settings from a normal distribution, which moves to
the best of them.
"""

from __future__ import annotations

import dataclasses
import math
from collections.abc import Callable
from pathlib import Path
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
from numpy.typing import NDArray

from jaxlocomanip import checked
from jaxlocomanip.checked import InputError, installing
from jaxlocomanip.checkpoint import State, digest
from jaxlocomanip.checkpoint import read as read_checkpoint
from jaxlocomanip.checkpoint import write as write_checkpoint
from jaxlocomanip.config_file import config_to_toml
from jaxlocomanip.knobs import SPAN, as_numbers, knobs_of, turned
from jaxlocomanip.objective import Losses, Objective, picked
from jaxlocomanip.planner.config import PlannerConfig
from jaxlocomanip.scenario import Scenario

Floats = NDArray[np.floating[Any]]

METHODS = ("gradient", "cem")
"""How settings are searched."""
NAMES = ("weights", "constraints", "adaptation.gain", "adaptation.low_pass", "adaptation.prior_friction")
"""What is tuned by default: weights, barrier shapes, gains of the barrier functions, and the adaptation."""
KEEP = 0.2
"""share of the old spread in that of the next generation of the cross-entropy method"""
MOMENTUM = 0.8
"""share of the old in the running mean of gradients"""
LEAST_SPREAD = 0.02
"""that a setting's logarithm keeps"""


@dataclasses.dataclass(frozen=True)
class Settings:
    """How to tune."""

    names: tuple[str, ...] = NAMES
    """settings or groups of them"""
    method: str = "gradient"
    steps: int = 40
    batch: int = 8
    """scenarios of a step"""
    validate: int = 5
    """steps between two validations"""
    rate: float = 0.2
    """length of a step by gradient, in logarithms"""
    population: int = 16
    """settings drawn in a step of the cross-entropy method"""
    elite: int = 4
    """the best of them, which the distribution moves to"""
    spread: float = 0.3
    """standard deviation of the logarithms at the start"""
    memory: float = 0.3
    """s, time constant with which gradients fade back in time (`gradients.soft_outcome`)"""
    gradient_cost: float = 8.0
    """episodes that take as long as one gradient, to count the budget by"""
    seed: int = 0

    @property
    def episodes(self) -> int:
        """Episodes that one step costs."""
        return math.ceil(self.batch * (self.gradient_cost if self.method == "gradient" else self.population))

    def spent(self, steps: int, held_out: int) -> int:
        """Episodes after so many steps, with the looks at the held-out scenarios."""
        return steps * self.episodes + (1 + steps // self.validate) * held_out


@dataclasses.dataclass(frozen=True)
class Tuned:
    """What came of it."""

    config: PlannerConfig
    loss: float
    """on the held-out scenarios"""
    history: tuple[dict[str, float], ...]
    """step, episodes so far, mean loss in training, gradients that were not finite, and the mean loss on the held-out
    scenarios where they were looked at"""


def tune(
    config: PlannerConfig,
    train: Scenario,
    held_out: Scenario,
    ticks: int,
    settings: Settings | None = None,
    objective: Objective | None = None,
    checkpoint: Path | None = None,
    say: Callable[[str], None] = lambda text: None,
    kept: Callable[[Tuned], None] = lambda tuned: None,
) -> Tuned:
    """Tune settings of a configuration.

    Args:
      config: where to start.
      train: batch [n] of scenarios to learn from.
      held_out: batch [m] of scenarios to choose by, of the shapes of `train`.
      ticks: planner ticks of an episode.
      settings: what to tune, and how.
      objective: what is good.
      checkpoint: file that is written, whole, after every step; if it exists, tuning goes on from there.
      say: told of the progress, line by line.
      kept: given the best so far whenever the held-out scenarios were looked at.

    Returns:
      The configuration of least loss on the held-out scenarios, which may be the one it started with.

    Raises:
      InputError: unknown method or settings, a checkpoint of another run, or optax is not installed.
    """
    plan, aim = settings or Settings(), objective or Objective()
    lanes, looked = int(train.duration.shape[0]), int(held_out.duration.shape[0])
    _check(plan, lanes, looked)
    train, held_out = jax.tree.map(np.asarray, (train, held_out))  # batches are picked on the host
    knobs = knobs_of(config, plan.names)
    base = jax.tree.map(jnp.asarray, config)
    measure = Losses(base, knobs, aim, ticks, plan.batch, plan.memory)
    method = (_Gradient if plan.method == "gradient" else _CrossEntropy)(plan, measure)
    about = {
        "settings": dataclasses.asdict(plan),
        "objective": vars(aim),
        "ticks": ticks,
        "from": config_to_toml(config),
        "training scenarios": digest(train),
        "held-out scenarios": digest(held_out),
    }

    def best(state: State) -> Tuned:
        settings = as_numbers(turned(base, knobs, jnp.asarray(state.best, jnp.float32)))
        return Tuned(settings, state.best_loss, state.history)

    state = read_checkpoint(checkpoint, about) or _begin(method, knobs.first(), measure.mean(held_out), looked)
    for step in range(state.step, plan.steps):
        rng = np.random.default_rng([plan.seed, step])
        batch = picked(train, rng.choice(lanes, plan.batch, replace=False))
        center, memory, seen = method.step(state, batch, rng)
        state = dataclasses.replace(state, step=step + 1, center=center, memory=memory)
        row = {"step": step + 1.0, "episodes": float(plan.spent(step + 1, looked)), **seen}
        if (step + 1) % plan.validate == 0:
            row["held_out"] = measure.mean(held_out, center)
            if row["held_out"] < state.best_loss:
                state = dataclasses.replace(state, best=center, best_loss=row["held_out"])
        state = dataclasses.replace(state, history=(*state.history, row))
        say(", ".join(f"{name} {value:.6g}" for name, value in row.items()))
        if checkpoint is not None:
            write_checkpoint(checkpoint, about, state)
        if "held_out" in row:
            kept(best(state))
    if state.step % plan.validate:
        state = _last_look(state, measure.mean(held_out, state.center), looked)
    return best(state)


class _Gradient:
    """Steps of one length against the running mean of the lanes' trimmed gradients."""

    def __init__(self, plan: Settings, measure: Losses) -> None:
        try:
            import optax
        except ImportError as error:
            raise InputError(f"method = 'gradient': needs the tune extra: {installing('tune')}") from error
        self._measure = measure
        # Settings are alike in logarithms. Each scaled by itself, as by Adam, those that hardly matter would drift.
        self._optimiser = optax.chain(optax.ema(MOMENTUM), optax.normalize_by_update_norm(-plan.rate))
        self._update = jax.jit(self._optimiser.update)
        self._structure = jax.tree.structure(self._optimiser.init(jnp.zeros(1)))

    def start(self, count: int) -> tuple[Floats, ...]:
        return _leaves(self._optimiser.init(jnp.zeros(count, jnp.float32)))

    def step(
        self, state: State, batch: Scenario, rng: np.random.Generator
    ) -> tuple[Floats, tuple[Floats, ...], dict[str, float]]:
        del rng
        seen, slope, nonfinite = self._measure.slopes(state.center, batch)
        memory = self._structure.unflatten([jnp.asarray(leaf) for leaf in state.memory])
        update, memory = self._update(jnp.asarray(slope, jnp.float32), memory)
        new = np.clip(state.center + np.asarray(update, float), -SPAN, SPAN)
        return new, _leaves(memory), {"train": seen, "nonfinite_gradients": float(nonfinite)}


class _CrossEntropy:
    """A normal distribution with independent components, drawn to the best of its samples."""

    def __init__(self, plan: Settings, measure: Losses) -> None:
        self._plan = plan
        self._measure = measure

    def start(self, count: int) -> tuple[Floats, ...]:
        return (np.full(count, self._plan.spread),)

    def step(
        self, state: State, batch: Scenario, rng: np.random.Generator
    ) -> tuple[Floats, tuple[Floats, ...], dict[str, float]]:
        (spread,) = state.memory
        drawn = state.center + spread * rng.standard_normal((self._plan.population, len(state.center)))
        drawn = np.clip(drawn, -SPAN, SPAN)
        losses = self._measure.of(drawn, batch)
        elite = drawn[np.argsort(losses)[: self._plan.elite]]
        wide = np.maximum(KEEP * spread + (1.0 - KEEP) * elite.std(axis=0), LEAST_SPREAD)
        return elite.mean(axis=0), (wide,), {"train": float(losses.mean())}


def _leaves(tree: Any) -> tuple[Floats, ...]:
    return tuple(np.asarray(leaf) for leaf in jax.tree.leaves(tree))


def _check(plan: Settings, lanes: int, looked: int) -> None:
    checked.one_of("method", plan.method, METHODS)
    checked.count("steps", plan.steps)
    checked.count("validate", plan.validate)
    checked.count("population", plan.population)
    checked.positive("rate", plan.rate)
    checked.positive("spread", plan.spread)
    checked.positive("memory", plan.memory)
    checked.positive("gradient_cost", plan.gradient_cost)
    checked.seed("seed", plan.seed)
    checked.whole("elite", plan.elite, 1, plan.population)
    if not 1 <= plan.batch <= lanes:
        raise InputError(f"batch = {plan.batch}: must be >= 1 and <= the {lanes} training scenarios")
    if looked < 1:
        raise InputError("held_out: must have at least one scenario")


def _last_look(state: State, held_out: float, looked: int) -> State:
    """What is returned may also be the last settings; a run that goes on looks at them no sooner than at others."""
    last = {**state.history[-1], "held_out": held_out}
    last["episodes"] += looked
    history = (*state.history[:-1], last)
    if held_out < state.best_loss:
        return dataclasses.replace(state, best=state.center, best_loss=held_out, history=history)
    return dataclasses.replace(state, history=history)


def _begin(method: _Gradient | _CrossEntropy, center: Floats, held_out: float, looked: int) -> State:
    first = {"step": 0.0, "episodes": float(looked), "held_out": held_out}
    return State(0, center, method.start(len(center)), np.zeros_like(center), held_out, (first,))
