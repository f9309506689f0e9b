"""What a sweep will do, checked before anything is compiled: scenarios, planners, chunks and their common shape."""

from __future__ import annotations

import math
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from jaxlocomanip import checked, config_file
from jaxlocomanip.batch import Shape
from jaxlocomanip.checked import InputError
from jaxlocomanip.footprint import covering_discs
from jaxlocomanip.obstacle_spec import box
from jaxlocomanip.padding import Padding
from jaxlocomanip.planner.config import PlannerConfig
from jaxlocomanip.sampling.distributions import Choice, Constant, Distribution, Normal
from jaxlocomanip.sampling.layout import team_size
from jaxlocomanip.sampling.study import MOST_LANES, Study, Variant


@dataclass(frozen=True)
class Planner:
    """A planner under study."""

    name: str
    config: PlannerConfig


@dataclass(frozen=True)
class Chunk:
    """Scenarios that run as one batch; their teams have one size."""

    number: int
    lanes: tuple[int, ...]


@dataclass(frozen=True)
class Plan:
    """A checked request for a sweep."""

    study: Study
    seed: int
    count: int
    """random draws at each point"""
    world: str
    backend: str | None
    planners: tuple[Planner, ...]
    shape: Shape
    chunks: tuple[Chunk, ...]

    @property
    def lanes(self) -> int:
        """Scenarios, each of which every planner tries."""
        return self.count * len(self.study.points)

    def headline(self) -> str:
        """One line on what is to be done."""
        planners = f" x {len(self.planners)} planners" if len(self.planners) > 1 else ""
        return f"{self.study.name}: {self.lanes} scenarios{planners} in chunks of {self.shape.lanes}"

    def units(self) -> Iterator[tuple[Chunk, int]]:
        """Pieces of work in their order: a chunk and the number of a planner."""
        return ((chunk, number) for chunk in self.chunks for number in range(len(self.planners)))


def plan_sweep(
    study: Study,
    config: PlannerConfig,
    *,
    seed: int = 0,
    count: int | None = None,
    world: str | None = None,
    backend: str | None = None,
    chunk: int | None = None,
    without: Sequence[str] = (),
) -> Plan:
    """Decide on a sweep.

    Args:
      study: what to run.
      config: planner of the variants that name none.
      seed: of the scenarios and of the measurement noise.
      count: random draws at each point; the study's own by default.
      world: name of the world; the study's own by default.
      backend: of the quadruped world; `c` by default, since a batch of `mjx` needs teams of the same types.
      chunk: scenarios in one compiled batch; the study's own by default.
      without: features switched off in every variant.

    Raises:
      InputError: unknown settings of a variant, or too many scenarios.
    """
    count = study.count if count is None else checked.whole("count", count, 1, MOST_LANES)
    total = count * len(study.points)
    if not 1 <= total <= MOST_LANES:
        raise InputError(f"count = {count}: must give 1 to {MOST_LANES} scenarios (at {len(study.points)} points)")
    planners = tuple(Planner(v.name, _config(v, config, without)) for v in study.variants)
    world = study.world if world is None else world
    if world == "quadruped" and backend is None:
        backend = "c"
    lanes = min(study.chunk if chunk is None else checked.whole("chunk", chunk, 1, MOST_LANES), total)
    return Plan(
        study=study,
        seed=checked.seed("seed", seed),
        count=count,
        world=world,
        backend=backend,
        planners=planners,
        shape=Shape(lanes, longest(study), padding(study)),
        chunks=_chunks(study, seed, total, lanes),
    )


def _config(variant: Variant, config: PlannerConfig, without: Sequence[str]) -> PlannerConfig:
    try:
        if variant.config is not None:
            config = config_file.named_config(variant.config)
        config = config_file.with_settings(config, variant.settings)
        return config_file.without(config, [*without, *variant.without])
    except InputError as error:
        raise InputError(f"variant '{variant.name}': {error}" if variant.name else str(error)) from None


def _chunks(study: Study, seed: int, total: int, size: int) -> tuple[Chunk, ...]:
    """Lanes in their order, those with teams of one size together."""
    groups: dict[int, list[int]] = {}
    for lane in range(total):
        groups.setdefault(team_size(study, seed, lane), []).append(lane)
    parts = [lanes[i : i + size] for _, lanes in sorted(groups.items()) for i in range(0, len(lanes), size)]
    return tuple(Chunk(number, tuple(part)) for number, part in enumerate(sorted(parts)))


def longest(study: Study) -> float:
    """s, duration of the longest scenario that a study can draw."""
    return max(_largest(one) for one in _each(study, "duration"))


def padding(study: Study) -> Padding:
    """Shapes that hold every scenario that a study can draw."""
    drawn, fixed = (
        [point.values.get(name, study.parameters[name]) for point in study.points]
        for name in ("obstacles.count", "obstacles.fixed")
    )
    obstacles = (int(_largest(a)) + max(map(len, _values(b))) for a, b in zip(drawn, fixed, strict=True))
    sizes = {size for one in _each(study, "object.size") for size in _values(one)}
    discs = max(len(covering_discs(np.array(box(size, "object.size")))[1]) for size in sizes)
    changes = any(value for one in _each(study, "team.change_faces") for value in _values(one))
    return Padding(
        obstacles=max(1, *obstacles), corners=4, marks=1, vertices=4, discs=discs, formations=3 if changes else 0
    )


def _each(study: Study, name: str) -> list[Distribution]:
    """What a parameter is drawn from at each point."""
    found = (point.values.get(name, study.parameters[name]) for point in study.points)
    return list({id(one): one for one in found}.values())


def _values(distribution: Distribution) -> tuple[Any, ...]:
    """All values of a parameter that has no range."""
    return distribution.values if isinstance(distribution, Choice) else (distribution.at(0.5),)


def _largest(distribution: Distribution) -> float:
    if isinstance(distribution, Constant | Choice):
        return max(_values(distribution))
    if isinstance(distribution, Normal):
        return distribution.high
    # Every other one is an increasing function of the quantile; rounding must not exceed the upper end.
    return distribution.at(math.nextafter(1.0, 0.0)) + 1e-9


def settings_of(plan: Plan) -> Mapping[str, Any]:
    """Everything that the rows of a sweep depend on, but for versions and device."""
    return {
        "name": plan.study.name,
        "study": dict(plan.study.data),
        "seed": plan.seed,
        "count": plan.count,
        "world": plan.world,
        "backend": plan.backend,
        "chunk": plan.shape.lanes,
        "variants": [
            {"name": planner.name, "config": config_file.config_to_toml(planner.config)} for planner in plan.planners
        ],
    }
