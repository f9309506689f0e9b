"""Falsification: the scenarios, within bounds, in which the planner keeps the least clearance.

    found = falsify(find_study("standard"), preset("paper"), seed=0)
    found.worst[0].spec, found.worst[0].clearance

Random scenarios of a study are varied at random within `variation.Bounds`. Obstacles are put where the object would be
if it went straight to its goal (`aiming`), and the scenarios that promise most are simulated in batches. Then obstacles
are put where the object went, first in the scenarios that promise most. The worst of all are improved side
by side: the gradient of the closest approach (`approach`) gives each of them a direction, one step along it is
simulated (or one for each of several lengths, `Search.steps`), and kept if it is better. Pushing is unstable, and much
of what happens after any change is chance: every try also moves all coordinates a little at random. A scenario that no
planner could solve (`sampling.feasibility`) is never tried. Every clearance that is reported is that of an episode as
`simulate` runs it, never the soft one.

The cost is counted in episodes, a gradient at `Search.gradient_cost` of them, so that `random_worst.sample_worst`,
random sampling within the same bounds, can be given the same budget.
"""

from __future__ import annotations

import dataclasses
import math
from collections.abc import Callable, Sequence
from typing import Any

import numpy as np
from numpy.typing import NDArray

from jaxlocomanip import checked
from jaxlocomanip.aiming import Aim, aims, straight_motion
from jaxlocomanip.checked import InputError
from jaxlocomanip.planner.config import PlannerConfig
from jaxlocomanip.random_worst import BATCH, TRIALS, Falsified, Keep, random_places, summed
from jaxlocomanip.sampling.study import Study
from jaxlocomanip.trials import Found, Place, Trials, place_at
from jaxlocomanip.variation import Bounds, check_bounds

Floats = NDArray[np.floating[Any]]

APART = 0.2
"""coordinates within this of a scenario that cannot be solved are not tried"""
HALVINGS = 3
"""times that a step to an impossible scenario is halved before it is given up"""
BEGUN, AIMED, STEPPED = 1, 2, 3
"""stages of a search, of which each has its own random numbers"""


@dataclasses.dataclass(frozen=True)
class Search:
    """How long and how wide to search."""

    drawn: int = 160
    """random scenarios that are looked at, which takes no episodes"""
    screened: int = 16
    """of these, the ones that promise most and are begun with"""
    aimed: tuple[int, ...] = (8, 8, 8, 8)
    """scenarios that are tried with an obstacle in the way, round after round"""
    lanes: int = 8
    """worst scenarios, that are improved by gradients"""
    rounds: int = 4
    """gradients of each"""
    steps: tuple[float, ...] = (0.1,)
    """lengths that are tried along a gradient: of the coordinate that moves most; the box is 2 wide"""
    spread: float = 0.03
    """standard deviation of what is added to each coordinate in every try"""
    window: int = 20
    """ticks up to the closest approach that are differentiated"""
    memory: float = 0.03
    """s, time constant with which gradients fade back in time (`gradients.soft_outcome`)"""
    gradient_cost: float = 1.5
    """episodes that take as long as one gradient"""

    @property
    def episodes(self) -> int:
        """Episodes that the search costs."""
        stepped = self.lanes * self.rounds * (self.gradient_cost + len(self.steps))
        return math.ceil(self.screened + sum(self.aimed) + stepped)


Say = Callable[[str], None]


def falsify(
    study: Study,
    config: PlannerConfig,
    seed: int = 0,
    search: Search | None = None,
    bounds: Bounds | None = None,
    say: Say = lambda text: None,
    kept: Keep = lambda found: None,
) -> Falsified:
    """Search for the scenarios that the planner comes closest to an obstacle in.

    Args:
      study: random scenarios to vary; all teams of one size.
      config: planner settings.
      seed: of the scenarios and of the measurement noise; each scenario has its own.
      search: how long.
      bounds: how far scenarios may be varied.
      say: told of the progress, line by line.
      kept: given what has been found so far after every stage, so that a search that is stopped was not for nothing.

    Returns:
      At most `search.lanes` scenarios.

    Raises:
      InputError: bad numbers of the search or the bounds, or a study without scenarios within the bounds.
    """
    plan, box = search or Search(), bounds or Bounds()
    _check(plan)
    checked.seed("seed", seed)
    check_bounds(box)
    trial = Trials(study, config, box, BATCH, plan.window, plan.memory)
    drawn = list(random_places(study, seed, plan.drawn, box))
    rng = _stream(seed, BEGUN, 0)
    begun = trial.run(_promising(drawn, plan.screened, plan.spread, float(config.reference.speed), box, rng))
    lanes = [_Lane(place, found) for place, found in begun]
    say(f"{plan.screened} of {plan.drawn} random scenarios: least clearance {min(map(_clearance, lanes)):.3f} m")
    tried: list[int] = []
    kept(_so_far(lanes, plan, tried, 0))
    for number, count in enumerate(plan.aimed):
        rng = _stream(seed, AIMED, number)
        lanes, shots = _aimed(trial, lanes, count, plan.spread, box, rng)
        tried.append(shots)
        say(f"{shots} with an obstacle in the way: {min(map(_clearance, lanes)):.3f} m")
        kept(_so_far(lanes, plan, tried, 0))
    lanes = sorted(lanes, key=_clearance)[: plan.lanes]
    for number in range(plan.rounds):
        rng = _stream(seed, STEPPED, number)
        lanes = _improved(trial, lanes, plan, box, rng)
        say(f"gradients of {len(lanes)}: {min(map(_clearance, lanes)):.3f} m")
        kept(_so_far(lanes, plan, tried, number + 1))
    return _so_far(lanes, plan, tried, plan.rounds)


def _check(plan: Search) -> None:
    if plan.screened < plan.lanes or plan.lanes < 1:
        raise InputError(f"search.lanes = {plan.lanes}: must be >= 1 and <= search.screened = {plan.screened}")
    for count in plan.aimed:
        if not 1 <= count <= plan.screened:
            raise InputError(f"search.aimed = {count}: must be >= 1 and <= search.screened = {plan.screened}")
    if plan.drawn < plan.screened:
        raise InputError(f"search.drawn = {plan.drawn}: must be >= search.screened = {plan.screened}")
    if plan.rounds and not plan.steps:
        raise InputError("search.steps = (): must have at least one length")
    for k, length in enumerate(plan.steps):
        checked.number(f"search.steps[{k}]", length, 0.0, 2.0, strictly=True)
    checked.count("search.rounds", plan.rounds, 0)
    checked.count("search.window", plan.window)
    checked.number("search.spread", plan.spread, 0.0, 2.0)
    checked.positive("search.memory", plan.memory)
    checked.positive("search.gradient_cost", plan.gradient_cost)


def _stream(seed: int, stage: int, number: int) -> np.random.Generator:
    """Random numbers that neither another stage nor a scenario (`random_places`) draws."""
    return np.random.default_rng([seed, number, stage])


@dataclasses.dataclass(frozen=True)
class _Lane:
    """The worst that was made of a scenario of the study."""

    place: Place
    found: Found
    missed: float = 0.0
    """m, by how much clearances were larger than what was aimed at, lately"""


def _clearance(lane: _Lane) -> float:
    return lane.found.clearance


def _so_far(lanes: Sequence[_Lane], plan: Search, tried: Sequence[int], rounds: int) -> Falsified:
    """What a search has found after rounds with so many aims each, and so many of gradients."""
    done = dataclasses.replace(plan, aimed=tuple(tried), rounds=rounds)
    worst = sorted((lane.found for lane in lanes), key=lambda one: one.clearance)[: plan.lanes]
    return summed(worst, worst, done.episodes)


def _promising(
    places: Sequence[Place], count: int, spread: float, speed: float, bounds: Bounds, rng: np.random.Generator
) -> list[Place]:
    """Those that promise the least clearance with an obstacle where an object on a straight way would be."""
    every = [
        aims(place.scenario, place.coordinates, straight_motion(place.scenario, speed), bounds) for place in places
    ]
    order = sorted(range(len(places)), key=lambda k: every[k][0].clearance if every[k] else math.inf)
    shots = ((places[k], _shot(places[k], every[k], spread, bounds, rng)) for k in order[:count])
    return [place if shot is None else shot[1] for place, shot in shots]


def _aimed(
    trial: Trials, lanes: Sequence[_Lane], count: int, spread: float, bounds: Bounds, rng: np.random.Generator
) -> tuple[list[_Lane], int]:
    """All lanes, those that promise the least clearance after a try with an obstacle in the object's way; the tries."""
    every = [aims(lane.place.scenario, lane.place.coordinates, lane.found.motion, bounds) for lane in lanes]
    order = sorted((k for k in range(len(lanes)) if every[k]), key=lambda k: every[k][0].clearance + lanes[k].missed)
    chosen: list[tuple[int, Aim, Place]] = []
    for k in order:
        if len(chosen) == count:
            break
        shot = _shot(lanes[k].place, every[k], spread, bounds, rng)
        if shot is not None:
            chosen.append((k, *shot))
    results = trial.run([place for _, _, place in chosen])
    new = list(lanes)
    for (k, aim, _), (place, found) in zip(chosen, results, strict=True):
        missed = found.clearance - aim.clearance
        better = found.clearance < lanes[k].found.clearance
        new[k] = _Lane(place, found, missed) if better else dataclasses.replace(lanes[k], missed=missed)
    return new, len(chosen)


def _shot(
    place: Place, every: Sequence[Aim], spread: float, bounds: Bounds, rng: np.random.Generator
) -> tuple[Aim, Place] | None:
    """The aim of least clearance that leaves a scenario which can be solved."""
    refused: list[Floats] = []
    for aim in every:
        if any(np.abs(aim.coordinates - other).max() < APART for other in refused):
            continue
        where = aim.coordinates + spread * rng.standard_normal(aim.coordinates.shape)
        new = place_at(place.lane, place.seed, np.clip(where, -1.0, 1.0), bounds)
        if new is not None:
            return aim, new
        refused.append(aim.coordinates)
        if len(refused) == TRIALS:
            break
    return None


def _improved(
    trial: Trials, lanes: Sequence[_Lane], plan: Search, bounds: Bounds, rng: np.random.Generator
) -> list[_Lane]:
    """Each lane after the best of several steps down its gradient, or as it was."""
    gradients = trial.gradients([lane.place for lane in lanes])
    tried = [
        _step(lane.place, gradient, length, plan.spread, bounds, rng)
        for lane, gradient in zip(lanes, gradients, strict=True)
        for length in plan.steps
    ]
    results, count = trial.run(tried), len(plan.steps)
    new: list[_Lane] = []
    for k, lane in enumerate(lanes):
        ways = [(lane.place, lane.found), *results[k * count : (k + 1) * count]]
        place, found = min(ways, key=lambda pair: pair[1].clearance)
        new.append(dataclasses.replace(lane, place=place, found=found))
    return new


def _step(
    place: Place, gradient: Floats, length: float, spread: float, bounds: Bounds, rng: np.random.Generator
) -> Place:
    """The scenario about a step down the gradient, or on the way there as far as it can be solved.

    The coordinate with the largest slope moves by `length`, the others in proportion, and all of them at random by
    `spread`: pushing is so unstable that what happens after a step is partly chance, and worth another try each time.
    """
    way = spread * rng.standard_normal(gradient.shape)
    if gradient.any():
        way = way - length * gradient / np.abs(gradient).max()
    for _ in range(HALVINGS + 1):
        new = place_at(place.lane, place.seed, np.clip(place.coordinates + way, -1.0, 1.0), bounds)
        if new is not None:
            return new
        way = 0.5 * way
    return place
