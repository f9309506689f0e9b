"""Throughput of batches of closed-loop episodes, in seconds of scenarios a wall second."""

from __future__ import annotations

import dataclasses
import time
from collections.abc import Sequence
from typing import Any

import jax
import numpy as np

from jaxlocomanip import Scenario, ScenarioSpec, build_scenario, compiled, find_scenario, stack

DURATION = 4.0
"""s, of every lane"""
SEED = 1


def measure(lanes: Sequence[int], repeats: int) -> list[dict[str, Any]]:
    """One record for each number of lanes: compile_s, wall_s, scenario seconds a wall second."""
    spec = dataclasses.replace(find_scenario("adaptive"), duration=DURATION)
    every = [build_scenario(jittered(spec, lane), lane) for lane in range(max(lanes))]
    return [_measure(every[:count], repeats) for count in lanes]


def _measure(scenarios: Sequence[Scenario], repeats: int) -> dict[str, Any]:
    batch = stack(scenarios)
    start = time.perf_counter()
    run = compiled(batch, record=False)
    compile_s = time.perf_counter() - start
    jax.block_until_ready(run(0))
    taken = []
    for _ in range(repeats):
        start = time.perf_counter()
        result = jax.block_until_ready(run(0))
        taken.append(time.perf_counter() - start)
    simulated = DURATION * len(scenarios)
    return {
        "lanes": len(scenarios),
        "duration_s": DURATION,
        "repeats": repeats,
        "compile_s": round(compile_s, 3),
        "run_s": round(min(taken), 3),
        "speed": round(simulated / min(taken), 2),
        "nonfinite_ticks": int(np.sum(result.outcome.nonfinite)),
    }


def jittered(spec: ScenarioSpec, lane: int) -> ScenarioSpec:
    """A scenario with another truth, start and layout; lane k is the same in any batch."""
    random = np.random.default_rng([SEED, lane])
    x, y = random.uniform(-0.2, 0.2, 2)
    truth = dataclasses.replace(spec.truth, mass=random.uniform(4.0, 10.0), friction=random.uniform(0.2, 0.5))
    obstacles = []
    for obstacle in spec.obstacles:
        dx, dy = random.uniform(-0.2, 0.2, 2)
        place = (obstacle.position[0] + dx, obstacle.position[1] + dy)
        obstacles.append(dataclasses.replace(obstacle, position=place))
    return dataclasses.replace(spec, start=(x, y, 0.0), truth=truth, obstacles=tuple(obstacles))
