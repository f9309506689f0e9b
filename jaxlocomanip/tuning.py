"""Tuning of a planner's settings over scenarios, by stochastic gradient or without gradients.

    settings = Settings(names=("weights", "constraints.robot_cbf"), steps=40)
    tuned = tune(preset("paper"), train, held_out, ticks=400, settings=settings, checkpoint=Path("out/tune.json"))
    Path("out/tuned.toml").write_text(config_to_toml(tuned.config))            # for --config

A setting is searched by its logarithm relative to where it starts (`knobs.py`), so it stays positive. Every step sees
a random part of the training scenarios. The loss of a scenario is a smooth function of its soft outcome: clearance,
errors at the goal, time and effort. The settings that are returned are those, of all that were validated, with the
least loss on the scenarios that were held out.

Pushing is unstable, and a few lanes have gradients many orders of magnitude larger than the others'. Each lane's
gradient is therefore clipped by its norm before they are averaged and go to Adam. The method `cem`, the cross-entropy
method, needs no gradients: it draws settings from a normal distribution, which moves to the best of them.
"""

from __future__ import annotations

import dataclasses
import json
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
from jaxlocomanip.config_file import config_to_toml
from jaxlocomanip.files import write_whole
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
    rate: float = 0.05
    """of Adam: about the change of a logarithm in a step"""
    population: int = 16
    """settings drawn in a step of the cross-entropy method"""
    elite: int = 4
    """the best of them, which the distribution moves to"""
    spread: float = 0.3
    """standard deviation of the logarithms at the start"""
    memory: float = 0.03
    """s, time constant with which gradients fade back in time (`gradients.soft_outcome`)"""
    gradient_cost: float = 8.0
    """episodes that take as long as one gradient, to count the budget by"""
    seed: int = 0

    @property
    def episodes(self) -> int:
        """Episodes that one step costs."""
        return math.ceil(self.batch * (self.gradient_cost if self.method == "gradient" else self.population))


@dataclasses.dataclass(frozen=True)
class Tuned:
    """What came of it."""

    config: PlannerConfig
    loss: float
    """on the held-out scenarios"""
    history: tuple[dict[str, float], ...]
    """step, episodes and mean loss in training, and on the held-out scenarios where they were looked at"""


@dataclasses.dataclass(frozen=True)
class _State:
    """What goes from step to step and into the checkpoint."""

    step: int
    center: Floats
    """[n] logarithms"""
    memory: tuple[Floats, ...]
    """of the optimiser, or [n] the spread"""
    best: Floats
    """[n] logarithms of the least loss that was validated"""
    best_loss: float
    history: tuple[dict[str, float], ...]


def tune(
    config: PlannerConfig,
    train: Scenario,
    held_out: Scenario,
    ticks: int,
    settings: Settings | None = None,
    objective: Objective | None = None,
    checkpoint: Path | None = None,
    say: Callable[[str], None] = lambda text: None,
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

    Returns:
      The configuration of least loss on the held-out scenarios, which may be the one it started with.

    Raises:
      InputError: unknown method or settings, a checkpoint of another run, or optax is not installed.
    """
    plan, aim = settings or Settings(), objective or Objective()
    checked.one_of("method", plan.method, METHODS)
    lanes = int(train.duration.shape[0])
    if not 1 <= plan.batch <= lanes:
        raise InputError(f"batch = {plan.batch}: must be >= 1 and <= the {lanes} training scenarios")
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
    }
    state = _read(checkpoint, about) or _begin(method, len(knobs.names), measure.mean(held_out))
    for step in range(state.step, plan.steps):
        rng = np.random.default_rng([plan.seed, step])
        batch = picked(train, rng.choice(lanes, plan.batch, replace=False))
        center, memory, seen = method.step(state, batch, rng)
        state = dataclasses.replace(state, step=step + 1, center=center, memory=memory)
        row = {"step": step + 1.0, "episodes": (step + 1.0) * plan.episodes, "train": seen}
        if (step + 1) % plan.validate == 0 or step + 1 == plan.steps:
            row["held_out"] = measure.mean(held_out, center)
            if row["held_out"] < state.best_loss:
                state = dataclasses.replace(state, best=center, best_loss=row["held_out"])
        state = dataclasses.replace(state, history=(*state.history, row))
        say(", ".join(f"{name} {value:.6g}" for name, value in row.items()))
        if checkpoint is not None:
            _write(checkpoint, about, state)
    found = as_numbers(turned(base, knobs, jnp.asarray(state.best, jnp.float32)))
    return Tuned(found, state.best_loss, state.history)


class _Gradient:
    """Adam on the mean of the lanes' clipped gradients."""

    def __init__(self, plan: Settings, measure: Losses) -> None:
        try:
            import optax
        except ImportError as error:
            raise InputError(f"method = 'gradient': needs the tune extra: {installing('tune')}") from error
        self._measure = measure
        self._optimiser = optax.adam(plan.rate)
        self._update = jax.jit(self._optimiser.update)
        self._structure = jax.tree.structure(self._optimiser.init(jnp.zeros(1)))

    def start(self, count: int) -> tuple[Floats, ...]:
        return _leaves(self._optimiser.init(jnp.zeros(count, jnp.float32)))

    def step(
        self, state: _State, batch: Scenario, rng: np.random.Generator
    ) -> tuple[Floats, tuple[Floats, ...], float]:
        del rng
        seen, slope = self._measure.slopes(state.center, batch)
        memory = self._structure.unflatten([jnp.asarray(leaf) for leaf in state.memory])
        update, memory = self._update(jnp.asarray(slope, jnp.float32), memory)
        new = np.clip(state.center + np.asarray(update, float), -SPAN, SPAN)
        return new, _leaves(memory), seen


class _CrossEntropy:
    """A normal distribution with independent components, drawn to the best of its samples."""

    def __init__(self, plan: Settings, measure: Losses) -> None:
        self._plan = plan
        self._measure = measure

    def start(self, count: int) -> tuple[Floats, ...]:
        return (np.full(count, self._plan.spread),)

    def step(
        self, state: _State, batch: Scenario, rng: np.random.Generator
    ) -> tuple[Floats, tuple[Floats, ...], float]:
        (spread,) = state.memory
        drawn = state.center + spread * rng.standard_normal((self._plan.population, len(state.center)))
        drawn = np.clip(drawn, -SPAN, SPAN)
        losses = self._measure.of(drawn, batch)
        elite = drawn[np.argsort(losses)[: self._plan.elite]]
        wide = np.maximum(KEEP * spread + (1.0 - KEEP) * elite.std(axis=0), LEAST_SPREAD)
        return elite.mean(axis=0), (wide,), float(losses.mean())


def _leaves(tree: Any) -> tuple[Floats, ...]:
    return tuple(np.asarray(leaf) for leaf in jax.tree.leaves(tree))


def _begin(method: _Gradient | _CrossEntropy, count: int, held_out: float) -> _State:
    first = {"step": 0.0, "episodes": 0.0, "held_out": held_out}
    return _State(0, np.zeros(count), method.start(count), np.zeros(count), held_out, (first,))


def _write(path: Path, about: dict[str, Any], state: _State) -> None:
    """Checkpoint of a step, whole."""
    fields = {
        **vars(state),
        "center": state.center.tolist(),
        "memory": [{"dtype": str(leaf.dtype), "values": leaf.tolist()} for leaf in state.memory],
        "best": state.best.tolist(),
    }
    write_whole(path, json.dumps({"about": about, "state": fields}, indent=1) + "\n")


def _read(path: Path | None, about: dict[str, Any]) -> _State | None:
    """State of a checkpoint; None where there is none."""
    if path is None or not path.exists():
        return None
    try:
        content = json.loads(path.read_text(encoding="utf-8"))
        before, fields = content["about"], content["state"]
        state = _State(
            fields["step"],
            np.array(fields["center"], float),
            tuple(np.array(leaf["values"], leaf["dtype"]) for leaf in fields["memory"]),
            np.array(fields["best"], float),
            fields["best_loss"],
            tuple(fields["history"]),
        )
    except (OSError, ValueError, KeyError, TypeError) as error:
        raise InputError(f"{path}: cannot be read as a checkpoint ({error})") from error
    now = json.loads(json.dumps(about))
    for name in ("objective", "ticks", "from"):
        if before[name] != now[name]:
            raise InputError(f"{path}: is the checkpoint of a run with another {name}; choose another file")
    # More steps than before are what going on is for.
    if {**before["settings"], "steps": 0} != {**now["settings"], "steps": 0}:
        raise InputError(f"{path}: is the checkpoint of a run with other settings; choose another file")
    return state
