"""Random scenarios of a study, varied at random within `variation.Bounds`: what a search is held against."""

from __future__ import annotations

import dataclasses
from collections.abc import Callable, Iterator, Sequence

import numpy as np

from jaxlocomanip import checked
from jaxlocomanip.checked import InputError
from jaxlocomanip.planner.config import PlannerConfig
from jaxlocomanip.sampling.sampler import draw
from jaxlocomanip.sampling.study import Study
from jaxlocomanip.trials import Found, Place, Trials, place_at
from jaxlocomanip.variation import Bounds, check_bounds, dimension

TRIALS = 8
"""random places that are tried around a scenario of a study before the next one is drawn"""
BATCH = 8
"""episodes that are simulated side by side"""


@dataclasses.dataclass(frozen=True)
class Falsified:
    """What a search found."""

    worst: tuple[Found, ...]
    """scenarios of different origin, least clearance first"""
    episodes: int
    """that it cost"""
    collisions: int
    """scenarios that collided with an obstacle (`Found.hit_obstacle`)"""
    touches: int
    """scenarios in which robots touched each other"""
    counted: int
    """of so many: of all random scenarios, but of `worst` alone after a search, which forgets the others"""


Keep = Callable[[Falsified], None]


def sample_worst(
    study: Study,
    config: PlannerConfig,
    episodes: int,
    seed: int = 0,
    keep: int = 16,
    bounds: Bounds | None = None,
    kept: Keep = lambda found: None,
) -> Falsified:
    """The worst of random scenarios, the first that `falsify` of this seed draws.

    Args:
      study: as of `falsify`, like `config`, `seed` and `bounds`.
      config: planner settings.
      episodes: how many.
      seed: of scenarios and noise.
      keep: how many to return.
      bounds: how far scenarios may be varied.
      kept: given what has been found so far after every batch.

    Raises:
      InputError: bad numbers, or a study without scenarios within the bounds.
    """
    box = bounds or Bounds()
    check_bounds(box)
    checked.seed("seed", seed)
    checked.count("episodes", episodes)
    checked.count("keep", keep)
    trial, places = Trials(study, config, box, BATCH), list(random_places(study, seed, episodes, box))
    every: list[Found] = []
    found = summed((), (), 0)
    for first in range(0, episodes, BATCH):
        every += [one for _, one in trial.run(places[first : first + BATCH])]
        worst = tuple(sorted(every, key=lambda one: one.clearance)[:keep])
        found = summed(worst, every, len(every))
        kept(found)
    return found


def summed(worst: Sequence[Found], every: Sequence[Found], episodes: int) -> Falsified:
    """What was found, with what happened in every scenario counted."""
    collisions, touches = sum(one.hit_obstacle for one in every), sum(one.robots_touched for one in every)
    return Falsified(tuple(worst), episodes, collisions, touches, len(every))


def random_places(study: Study, seed: int, count: int, bounds: Bounds) -> Iterator[Place]:
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
