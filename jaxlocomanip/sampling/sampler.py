"""Drawing the scenarios of a study, lane by lane.

    spec = sample("standard", seed=0, index=17)        # a ScenarioSpec
    lane = draw(find_study("standard"), 0, 17)         # the same with its arrays and what was rejected on the way

Lane k depends on the study, the seed and k, and on nothing else. An attempt that is rejected (`feasibility`) is drawn
anew with the next attempt number.
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Mapping
from dataclasses import dataclass

from jaxlocomanip import checked
from jaxlocomanip.checked import InputError
from jaxlocomanip.sampling.draws import INDEX_LIMIT, Draws
from jaxlocomanip.sampling.feasibility import judged
from jaxlocomanip.sampling.layout import scenario_tables
from jaxlocomanip.sampling.study import Study, find_study
from jaxlocomanip.scenario import Scenario
from jaxlocomanip.specification import ScenarioSpec, parse_scenario

MOST_ATTEMPTS = 1000
"""attempts at a lane before the study is held to be impossible"""


@dataclass(frozen=True)
class Lane:
    """One scenario of a study."""

    index: int
    spec: ScenarioSpec
    scenario: Scenario
    """its arrays, on the host"""
    rejected: Mapping[str, int]
    """attempts that were rejected, by reason"""


def sample(study: str | Study, seed: int, index: int) -> ScenarioSpec:
    """Scenario number `index` of a study.

    Args:
      study: a study, or the name or file of one.
      seed: from 0 to 2^32 - 1.
      index: from 0 to 2^31 - 1.

    Raises:
      InputError: bad study, seed or index; a study whose scenarios no planner could solve.
    """
    return draw(find_study(study) if isinstance(study, str) else study, seed, index).spec


def draw(study: Study, seed: int, index: int) -> Lane:
    """Scenario number `index` of a study, with its arrays.

    Raises:
      InputError: as `sample`.
    """
    checked.seed("seed", seed)
    checked.whole("index", index, 0, INDEX_LIMIT)
    rejected: Counter[str] = Counter()
    for attempt in range(MOST_ATTEMPTS):
        spec = parse_scenario(scenario_tables(study, Draws(seed, index, attempt)), study.name)
        verdict = judged(spec, index)
        if not isinstance(verdict, str):
            return Lane(index, spec, verdict, dict(rejected))
        rejected[verdict] += 1
    reasons = ", ".join(f"{count} x {reason}" for reason, count in rejected.most_common())
    raise InputError(f"{study.name}: lane {index} has no feasible scenario in {MOST_ATTEMPTS} attempts ({reasons})")
