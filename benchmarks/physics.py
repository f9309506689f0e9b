"""Throughput of the physics under the quadruped world: MuJoCo C, MJX in batches, and MJX's compilation."""

from __future__ import annotations

import json
import os
import subprocess
import sys
import tempfile
import time
from collections.abc import Callable
from importlib.metadata import version
from pathlib import Path
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np

from jaxlocomanip.build import build
from jaxlocomanip.locomotion.robot import JointCommand
from jaxlocomanip.specification import parse_scenario
from jaxlocomanip.worlds.physics import Observation
from jaxlocomanip.worlds.physics_c import CPhysics
from jaxlocomanip.worlds.physics_mjx import MjxPhysics, stack_models
from jaxlocomanip.worlds.scene import Scene, build_scene

LANES = (1, 8, 32)
FRESH_LANES = 8
"""lanes of the program whose compilation is measured in fresh processes"""
HELD = 3
"""physics steps in a control period"""
STEPS = 100
"""physics steps in a call of MJX"""
ROOT = Path(__file__).parents[1]


def measure(repeats: int) -> dict[str, Any]:
    """Steps a second of C and of MJX, and MJX's compilation in s."""
    return {
        "mujoco": version("mujoco"),
        "mujoco_mjx": version("mujoco-mjx"),
        "c": _measure_c(repeats),
        "mjx": [_measure_mjx(lanes, repeats) for lanes in LANES],
        **_measure_fresh(),
    }


def scene(lane: int) -> Scene:
    """Two Aliengos and a box; each lane has a box of its own."""
    random = np.random.default_rng([2, lane])
    box = {"size": random.uniform(0.4, 0.9, 2).tolist(), "mass": random.uniform(4.0, 12.0), "friction": 0.4}
    robots = [{"type": "aliengo", "face": face} for face in ("-x", "-y")]
    table = {"name": "physics", "duration": 1.0, "start": {"pose": [0, 0, 0]}, "goal": {"pose": [3, 3, 0]}}
    return build_scene(build(parse_scenario({**table, "object": box, "robots": robots}), lane), scenery=False)


def _hold(seen: Observation) -> JointCommand:
    one = np.ones_like(seen.robots.joint)
    return JointCommand(seen.robots.joint, 0 * one, 300 * one, 8 * one, 0 * one)  # pyright: ignore[reportArgumentType]


def _measure_c(repeats: int) -> dict[str, Any]:
    physics = CPhysics(scene(0))
    start = physics.start()
    command = _hold(physics.observe(start))
    state = physics.advance(start, command, 500)
    long = _least(lambda: physics.advance(state, command, 2000), repeats)

    def periods() -> None:
        now = state
        for _ in range(500):
            now = physics.advance(now, command, HELD)
            physics.observe(now)

    period_us = 1e6 * _least(periods, repeats) / 500
    return {"steps_per_s": round(2000 / long, 1), "held": HELD, "period_us": round(period_us, 2)}


def _measure_mjx(lanes: int, repeats: int) -> dict[str, Any]:
    started = time.perf_counter()
    models = stack_models([scene(lane) for lane in range(lanes)])
    states = jax.vmap(MjxPhysics.start)(models)
    one = CPhysics(scene(0))
    hold = _hold(one.observe(one.start()))
    command = jax.tree.map(lambda leaf: jnp.asarray(np.stack([leaf] * lanes), states.qpos.dtype), hold)
    built = time.perf_counter()
    program = jax.jit(jax.vmap(MjxPhysics.advance, in_axes=(0, 0, 0, None)))
    run = program.lower(models, states, command, STEPS).compile()
    compiled = time.perf_counter()
    last = jax.block_until_ready(run(models, states, command, STEPS))
    taken = _least(lambda: jax.block_until_ready(run(models, states, command, STEPS)), repeats)
    return {
        "lanes": lanes,
        "build_s": round(built - started, 3),
        "compile_s": round(compiled - built, 3),
        "steps_per_s": round(lanes * STEPS / taken, 1),
        "finite": bool(np.isfinite(np.asarray(last.qpos)).all()),
    }


def _least(function: Callable[[], Any], repeats: int) -> float:
    """Least wall time of some calls, s."""
    taken = []
    for _ in range(repeats):
        start = time.perf_counter()
        function()
        taken.append(time.perf_counter() - start)
    return min(taken)


def _measure_fresh() -> dict[str, Any]:
    """The same program compiled in two fresh processes that share one, at first empty, compilation cache."""
    with tempfile.TemporaryDirectory() as cache:
        settings = {"JAX_COMPILATION_CACHE_DIR": cache, "JAX_PERSISTENT_CACHE_MIN_COMPILE_TIME_SECS": "0"}
        results = {}
        for name in ("cold", "cached"):
            command = [sys.executable, "-m", "benchmarks.physics"]
            environment = {**os.environ, **settings}
            done = subprocess.run(command, cwd=ROOT, env=environment, stdout=subprocess.PIPE, text=True, check=True)
            results[name] = json.loads(done.stdout)
    return results


if __name__ == "__main__":
    print(json.dumps(_measure_mjx(FRESH_LANES, 1)))
