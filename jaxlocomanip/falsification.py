"""Falsification: the scenarios, within bounds, in which the planner keeps the least clearance.

    found = falsify(find_study("standard"), preset("paper"), seed=0)
    found.worst[0].spec, found.worst[0].clearance

Random scenarios of a study, each varied at random within `variation.Bounds`, are simulated in batches. Those that come
closest are then improved side by side: the gradient of the soft clearance through the whole closed loop gives each of
them a direction, and steps of several lengths along it are simulated; the best one is kept. A step to a scenario that
no planner could solve is shortened until one could (`sampling.feasibility`). Every clearance that is reported is that
of an episode as `simulate` runs it, never the soft one.

The cost is counted in episodes, a gradient at `Search.gradient_cost` of them, so that `sample_worst`, random sampling
within the same bounds, can be given the same budget.
"""

from __future__ import annotations

import dataclasses
import math
from collections.abc import Callable, Iterator, Sequence
from typing import Any

import numpy as np
from numpy.typing import NDArray

from jaxlocomanip.checked import InputError
from jaxlocomanip.planner.config import PlannerConfig
from jaxlocomanip.sampling.sampler import draw
from jaxlocomanip.sampling.study import Study
from jaxlocomanip.trials import Found, Place, Trials, place_at
from jaxlocomanip.variation import Bounds, dimension

Floats = NDArray[np.floating[Any]]

TRIALS = 8
"""random places that are tried around a scenario of a study before the next one is drawn"""
HALVINGS = 3
"""times that a step to an impossible scenario is halved before it is given up"""


@dataclasses.dataclass(frozen=True)
class Search:
    """How long and how wide to search."""

    screened: int = 128
    """random scenarios to begin with: most of the budget, since what is improved is as bad as these are"""
    lanes: int = 8
    """of them, the worst, are improved"""
    rounds: int = 2
    """gradients taken of each of these"""
    steps: tuple[float, ...] = (0.02, 0.06, 0.2, 0.5)
    """changes of every coordinate, down its gradient, that are tried; the box is 2 wide"""
    memory: float = 0.03
    """s, time constant with which gradients fade back in time (`gradients.soft_outcome`)"""
    gradient_cost: float = 8.0
    """episodes that take as long as one gradient"""

    @property
    def episodes(self) -> int:
        """Episodes that the search costs."""
        each = self.gradient_cost + len(self.steps)
        return math.ceil(self.screened + self.lanes * self.rounds * each)


@dataclasses.dataclass(frozen=True)
class Falsified:
    """What a search found."""

    worst: tuple[Found, ...]
    """scenarios of different origin, least clearance first"""
    episodes: int
    """that it cost"""
    collisions: int
    """of `worst`, those that collided and were not merely run over"""


Say = Callable[[str], None]


def falsify(
    study: Study,
    config: PlannerConfig,
    seed: int = 0,
    search: Search | None = None,
    bounds: Bounds | None = None,
    say: Say = lambda text: None,
) -> Falsified:
    """Search for the scenarios that the planner comes closest to an obstacle in.

    Args:
      study: random scenarios to vary; all teams of one size.
      config: planner settings.
      seed: of the scenarios and of the measurement noise; each scenario has its own.
      search: how long.
      bounds: how far scenarios may be varied.
      say: told of the progress, line by line.

    Returns:
      At most `search.lanes` scenarios.

    Raises:
      InputError: no episodes to run, or a study without scenarios within the bounds.
    """
    plan, box = search or Search(), bounds or Bounds()
    if plan.screened < plan.lanes or plan.lanes < 1:
        raise InputError(f"search.lanes = {plan.lanes}: must be >= 1 and <= search.screened = {plan.screened}")
    trial = Trials(study, config, box, plan.lanes * len(plan.steps), plan.memory)
    begun = trial.run(list(_random_places(study, seed, plan.screened, box)))
    begun.sort(key=lambda pair: pair[1].clearance)
    best = begun[: plan.lanes]
    say(f"{plan.screened} random scenarios: least clearance {best[0][1].clearance:.3f} m")
    for number in range(plan.rounds):
        gradients = trial.gradients([place for place, _ in best])
        tried = [
            _step(place, g, size, box) for (place, _), g in zip(best, gradients, strict=True) for size in plan.steps
        ]
        results = trial.run(tried)
        count = len(plan.steps)
        best = [
            min([best[k], *results[k * count : (k + 1) * count]], key=lambda pair: pair[1].clearance)
            for k in range(len(best))
        ]
        say(f"round {number + 1}: least clearance {min(found.clearance for _, found in best):.3f} m")
    return _falsified([found for _, found in best], plan.episodes)


def sample_worst(
    study: Study,
    config: PlannerConfig,
    episodes: int,
    seed: int = 0,
    keep: int = 16,
    lanes: int = 64,
    bounds: Bounds | None = None,
) -> Falsified:
    """The worst of random scenarios: those that `falsify` of this seed begins with, and more of the same.

    Args:
      study: as of `falsify`, like `config`, `seed` and `bounds`.
      config: planner settings.
      episodes: how many.
      seed: of scenarios and noise.
      keep: how many to return.
      lanes: episodes in one batch.
      bounds: how far scenarios may be varied.
    """
    box = bounds or Bounds()
    pairs = Trials(study, config, box, lanes, math.inf).run(list(_random_places(study, seed, episodes, box)))
    found = sorted((found for _, found in pairs), key=lambda one: one.clearance)
    return _falsified(found[:keep], episodes)


def _falsified(found: Sequence[Found], episodes: int) -> Falsified:
    worst = tuple(sorted(found, key=lambda one: one.clearance))
    return Falsified(worst, episodes, sum(one.collided and not one.run_over for one in worst))


def _random_places(study: Study, seed: int, count: int, bounds: Bounds) -> Iterator[Place]:
    """The first `count` scenarios of a study and seed, each varied at random."""
    index = made = 0
    while made < count:
        if index > 100 + 10 * count:
            raise InputError(f"{study.name}: hardly any of its scenarios can be solved within the bounds")
        lane = draw(study, seed, index)
        rng = np.random.default_rng([seed, index])
        noise = int(rng.integers(2**32))
        for _ in range(TRIALS):
            place = place_at(lane, noise, rng.uniform(-1.0, 1.0, dimension(lane.scenario)), bounds)
            if place is not None:
                made += 1
                yield place
                break
        index += 1


def _step(place: Place, gradient: Floats, size: float, bounds: Bounds) -> Place:
    """The scenario a step down the gradient, or as far on the way as it can be solved.

    Each coordinate moves by `size`, the steepest descent within a box: where pushing is unstable, some components are
    larger than others by orders of magnitude, and along the gradient itself only those would move.
    """
    if not np.isfinite(gradient).all() or not gradient.any():
        return place
    for _ in range(HALVINGS + 1):
        where = np.clip(place.coordinates - size * np.sign(gradient), -1.0, 1.0)
        new = place_at(place.lane, place.seed, where, bounds)
        if new is not None:
            return new
        size *= 0.5
    return place
