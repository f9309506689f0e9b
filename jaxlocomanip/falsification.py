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
BATCH = 8
"""episodes that are simulated side by side"""
HALVINGS = 3
"""times that a step to an impossible scenario is halved before it is given up"""


@dataclasses.dataclass(frozen=True)
class Search:
    """How long and how wide to search."""

    screened: int = 64
    """random scenarios to begin with"""
    lanes: int = 8
    """of them, the worst, are improved"""
    rounds: int = 4
    """gradients taken of each of these, of the better half only in each round but the first"""
    least: int = 2
    """lanes that are improved to the end"""
    steps: tuple[float, ...] = (0.3, 1.0, 3.0)
    """lengths that are tried along the gradient, in multiples of what was last the best one of the lane"""
    first: float = 0.1
    """length at the beginning: of the coordinate that moves most; the box is 2 wide"""
    window: int = 20
    """ticks up to the closest approach that are differentiated"""
    memory: float = 0.03
    """s, time constant with which gradients fade back in time (`gradients.soft_outcome`)"""
    gradient_cost: float = 1.5
    """episodes that take as long as one gradient"""

    @property
    def widths(self) -> tuple[int, ...]:
        """Lanes that are improved in each round."""
        return tuple(max(self.lanes >> k, min(self.least, self.lanes)) for k in range(self.rounds))

    @property
    def episodes(self) -> int:
        """Episodes that the search costs."""
        return math.ceil(self.screened + sum(self.widths) * (self.gradient_cost + len(self.steps)))


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
    trial = Trials(study, config, box, BATCH, plan.window, plan.memory)
    begun = trial.run(list(_random_places(study, seed, plan.screened, box)))
    best = [_Lane(place, found, plan.first) for place, found in begun]
    best = _sorted(best)[: plan.lanes]
    say(f"{plan.screened} random scenarios: least clearance {best[0].found.clearance:.3f} m")
    for number, width in enumerate(plan.widths):
        rng = np.random.default_rng([seed, number])
        best = _sorted(_improved(trial, best[:width], plan, box, rng) + best[width:])
        say(f"round {number + 1}: least clearance {best[0].found.clearance:.3f} m")
    return _falsified([lane.found for lane in best], plan.episodes)


@dataclasses.dataclass(frozen=True)
class _Lane:
    """The worst that was made of a scenario of the study."""

    place: Place
    found: Found
    length: float
    """of the next step"""


def _sorted(lanes: Sequence[_Lane]) -> list[_Lane]:
    return sorted(lanes, key=lambda lane: lane.found.clearance)


def _improved(
    trial: Trials, lanes: Sequence[_Lane], plan: Search, bounds: Bounds, rng: np.random.Generator
) -> list[_Lane]:
    """Each lane after a step of the best of several lengths down its gradient, or as it was."""
    slopes = trial.gradients([lane.place for lane in lanes])
    # Where a gradient says nothing, some direction does better than none.
    gradients = [slope if slope.any() else rng.standard_normal(slope.shape) for slope in slopes]
    lengths = [[lane.length * factor for factor in plan.steps] for lane in lanes]
    tried = [
        _step(lane.place, gradient, length, bounds)
        for lane, gradient, some in zip(lanes, gradients, lengths, strict=True)
        for length in some
    ]
    results = trial.run(tried)
    new: list[_Lane] = []
    for k, lane in enumerate(lanes):
        count = len(plan.steps)
        ways = [
            _Lane(place, found, length)
            for (place, found), length in zip(results[k * count : (k + 1) * count], lengths[k], strict=True)
        ]
        shorter = dataclasses.replace(lane, length=min(lengths[k]) * min(plan.steps))
        new.append(min([shorter, *ways], key=lambda one: one.found.clearance))
    return new


def sample_worst(
    study: Study,
    config: PlannerConfig,
    episodes: int,
    seed: int = 0,
    keep: int = 16,
    bounds: Bounds | None = None,
) -> Falsified:
    """The worst of random scenarios: those that `falsify` of this seed begins with, and more of the same.

    Args:
      study: as of `falsify`, like `config`, `seed` and `bounds`.
      config: planner settings.
      episodes: how many.
      seed: of scenarios and noise.
      keep: how many to return.
      bounds: how far scenarios may be varied.
    """
    box = bounds or Bounds()
    pairs = Trials(study, config, box, BATCH).run(list(_random_places(study, seed, episodes, box)))
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


def _step(place: Place, gradient: Floats, length: float, bounds: Bounds) -> Place:
    """The scenario a step down the gradient, or as far on the way as it can be solved.

    The coordinate with the largest slope moves by `length`, the others in proportion.
    """
    steepest = np.abs(gradient).max()
    for _ in range(HALVINGS + 1):
        where = np.clip(place.coordinates - length * gradient / steepest, -1.0, 1.0)
        new = place_at(place.lane, place.seed, where, bounds)
        if new is not None:
            return new
        length *= 0.5
    return place
