"""Start-up and speed of one closed-loop episode in fresh processes, without and with a compilation cache."""

from __future__ import annotations

import json
import os
import subprocess
import sys
import tempfile
import time
from collections.abc import Sequence
from pathlib import Path
from typing import Any

SCENARIO = "adaptive"
PLANAR = (("planar", None),)
QUADRUPED = (("quadruped", "c"), ("quadruped", "mjx"))
"""worlds and their backends"""
ROOT = Path(__file__).parents[1]


def measure(worlds: Sequence[tuple[str, str | None]]) -> list[dict[str, Any]]:
    """For each world two runs of the same episode in fresh processes that share one, at first empty, cache."""
    return [_measure(world, backend) for world, backend in worlds]


def _measure(world: str, backend: str | None) -> dict[str, Any]:
    with tempfile.TemporaryDirectory() as cache:
        environment = {
            **os.environ,
            "JAX_COMPILATION_CACHE_DIR": cache,
            "JAX_PERSISTENT_CACHE_MIN_COMPILE_TIME_SECS": "0",
        }
        asked = [world, *([backend] if backend else [])]
        runs = {name: _in_fresh_process(environment, asked) for name in ("cold", "cached")}
        return {"scenario": SCENARIO, "world": world, "backend": backend, **runs}


def _in_fresh_process(environment: dict[str, str], asked: Sequence[str]) -> dict[str, Any]:
    start = time.perf_counter()
    command = [sys.executable, "-m", "benchmarks.episode", *asked]
    done = subprocess.run(command, cwd=ROOT, env=environment, stdout=subprocess.PIPE, text=True, check=True)
    # The last line: libraries may say something of their own before it.
    return {**json.loads(done.stdout.splitlines()[-1]), "process_s": round(time.perf_counter() - start, 3)}


def run(world: str, backend: str | None = None) -> dict[str, Any]:
    """The episode in this process: times in s, simulated over wall time, and whether it reached."""
    start = time.perf_counter()
    import jax

    from jaxlocomanip import build_scenario, compiled, find_scenario

    spec = find_scenario(SCENARIO)
    scenario = build_scenario(spec)
    ready = time.perf_counter()
    program = compiled(scenario, world=world, backend=backend, record=True)
    built = time.perf_counter()
    result = jax.block_until_ready(program(0))
    first = time.perf_counter()
    jax.block_until_ready(program(0))
    second = time.perf_counter()
    return {
        "import_s": round(ready - start, 3),
        "compile_s": round(built - ready, 3),
        "first_run_s": round(first - built, 3),
        "second_run_s": round(second - first, 3),
        "simulated_s": spec.duration,
        "speed": round(spec.duration / (second - first), 2),
        "reached": bool(result.outcome.reached),
    }


if __name__ == "__main__":
    print(json.dumps(run(*sys.argv[1:])))
