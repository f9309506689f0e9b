"""Throughput of batches of closed-loop episodes, in seconds of scenarios a wall second, over all devices."""

from __future__ import annotations

import dataclasses
import json
import resource
import sys
import time
from collections.abc import Sequence
from typing import Any

import numpy as np

from benchmarks.processes import in_fresh_process

DURATION = 4.0
"""s, of every lane"""
SEED = 1


def measure(lanes: Sequence[int], repeats: int) -> list[dict[str, Any]]:
    """One record for each number of lanes, from a fresh process with a device a core (on an accelerator: all of it)."""
    return in_fresh_process("benchmarks.batch", json.dumps([list(lanes), repeats]))


def run(lanes: Sequence[int], repeats: int) -> list[dict[str, Any]]:
    """The records: devices, compile_s, run_s, scenario seconds a wall second, memory; the least number first."""
    from jaxlocomanip import build_scenario, find_scenario

    spec = dataclasses.replace(find_scenario("adaptive"), duration=DURATION)
    every = [build_scenario(jittered(spec, lane), lane) for lane in range(max(lanes))]
    return [_measure(every[:count], repeats) for count in sorted(lanes)]


def _measure(scenarios: Sequence[Any], repeats: int) -> dict[str, Any]:
    import jax

    from jaxlocomanip.batch import Runner, Shape
    from jaxlocomanip.padding import Padding
    from jaxlocomanip.planner.config import PlannerConfig

    runner = Runner(devices=jax.local_devices()[: len(scenarios)])
    shape = Shape(len(scenarios), DURATION, Padding.of(scenarios))
    outcome = runner(scenarios, PlannerConfig(), 0, shape)
    taken = []
    for _ in range(repeats):
        start = time.perf_counter()
        runner(scenarios, PlannerConfig(), 0, shape)
        taken.append(time.perf_counter() - start)
    (program,) = runner.compilations
    return {
        "lanes": len(scenarios),
        "devices": len(runner.devices),
        "duration_s": DURATION,
        "repeats": repeats,
        "compile_s": round(program.seconds, 3),
        "run_s": round(min(taken), 3),
        "speed": round(DURATION * len(scenarios) / min(taken), 2),
        "temporary_mb_a_device": None if program.memory is None else round(program.memory / 1e6, 1),
        "peak_mb": _peak_mb(runner.devices[0]),
        "nonfinite_ticks": int(np.sum(outcome.nonfinite)),
    }


def _peak_mb(device: Any) -> float:
    """Most memory so far: the device's own, or on a CPU that of the process, compilation included."""
    own = (device.memory_stats() or {}).get("peak_bytes_in_use")
    return round((own or 1024 * resource.getrusage(resource.RUSAGE_SELF).ru_maxrss) / 1e6, 1)


def jittered(spec: Any, lane: int) -> Any:
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


if __name__ == "__main__":
    print(json.dumps(run(*json.loads(sys.argv[1]))))
