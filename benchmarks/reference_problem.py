"""The solver on the reference problem `push2`: latency, cold solve, throughput over both cores, compilation, memory."""

from __future__ import annotations

import dataclasses
import json
import os
import sys
import tempfile
import time
from collections.abc import Callable, Sequence
from typing import Any

from benchmarks.processes import in_fresh_process

LANES = (1, 4, 16, 64, 256, 1024)
COSTS = {"guess": 421.20244, "solution": -34.43354}
"""as other solvers find them"""
TOLERANCE = 1e-3
"""max |step| that ends a cold solve"""
LIMIT = 200
"""iterations of it at most"""
GROUP = 64
"""lanes that a device takes at once: what they need stays in the processor's fast memory"""


def measure(repeats: int, calls: int) -> dict[str, Any]:
    """All figures, from fresh processes: one scenario on one thread, twice with one cache, then batches on all cores.

    Raises:
      RuntimeError: a cost is not that of other solvers.
    """
    with tempfile.TemporaryDirectory() as cache:
        kept = {"JAX_COMPILATION_CACHE_DIR": cache, "JAX_PERSISTENT_CACHE_MIN_COMPILE_TIME_SECS": "0"}
        # A problem alone is too small for threads: handing an operation to another takes longer than the operation.
        alone = kept | {"PJRT_NPROC": "1", "JAX_CPU_ENABLE_ASYNC_DISPATCH": "false"}
        alone["XLA_FLAGS"] = os.environ.get("XLA_FLAGS", "")
        counts, name = (str(repeats), str(calls)), "benchmarks.reference_problem"
        first, found = (in_fresh_process(name, "alone", *counts, **alone) for _ in range(2))
        batch = in_fresh_process(name, "batch", *counts, **kept)
    for name, cost in COSTS.items():
        if abs(found["costs"][name] - cost) > 1e-3 * abs(cost):
            raise RuntimeError(f"push2: cost {found['costs'][name]} at the {name}, where other solvers find {cost}")
    return {**found, **batch, "compile_s": {"cold": first["compile_s"], "cached": found["compile_s"]}}


def run(part: str, repeats: int, calls: int) -> dict[str, Any]:
    """The figures of this process: of a problem `alone`, or of a `batch`."""
    import jax

    from benchmarks.push2 import push2
    from benchmarks.push2_model import FastPush2
    from jaxlocomanip.solver import sqp

    plain, guess = push2()
    problem, options = FastPush2(**vars(plain)), sqp.Options(tolerance=TOLERANCE)
    x0, start = guess.xs[0], sqp.start(guess, options)
    iterate = lambda p, x, i: sqp.solve(p, x, i, options)  # noqa: E731
    started = time.perf_counter()
    one = jax.jit(iterate).lower(problem, x0, start).compile(compiler_options=_options())
    compile_s = time.perf_counter() - started
    converge = lambda p, x, i: sqp.converge(p, x, i, options, LIMIT)  # noqa: E731
    whole = jax.jit(converge).lower(problem, x0, start).compile(compiler_options=_options())
    count, solution = _cold(whole, problem, x0, start)
    if part == "batch":
        figures = [_throughput(iterate, problem, x0, solution, lanes, repeats) for lanes in LANES]
        return {"batch": figures, "devices": jax.device_count()}
    cold = [_timed(lambda: _cold(whole, problem, x0, start)) for _ in range(max(repeats, 3))]
    costs = {"guess": sqp.evaluate(problem, guess)[0], "solution": solution.cost}
    return {
        "compile_s": round(compile_s, 3),
        "costs": {name: float(cost) for name, cost in costs.items()},
        "latency": _latency(one, problem, x0, solution, calls),
        "cold": {"iterations": count, **_spread(cold)},
    }


def _options() -> dict[str, str | bool] | None:
    """Of the compiler: on a CPU small operations are not split over threads; other devices know no such option."""
    import jax

    from jaxlocomanip.batch import WHOLE

    return dict(WHOLE) if jax.default_backend() == "cpu" else None


def _cold(solve: Callable[..., Any], problem: Any, x0: Any, start: Any) -> tuple[int, Any]:
    """Iterations from a cold guess until the step is small, and the last iterate."""
    from jaxlocomanip.solver.sqp import Status

    found, count = solve(problem, x0, start)
    if int(found.status) != Status.CONVERGED:
        raise RuntimeError(f"push2: no convergence within {LIMIT} iterations")
    return int(count), found


def _latency(one: Callable[..., Any], problem: Any, x0: Any, iterate: Any, calls: int) -> dict[str, Any]:
    """One warm iteration a call, the start state moved a little before each."""
    import jax
    import numpy as np

    noise = 0.01 * np.random.default_rng(1).standard_normal((calls + 20, len(x0))).astype(np.float32)
    taken = []
    for moved in jax.device_put([*noise]):
        start = time.perf_counter()
        iterate = jax.block_until_ready(one(problem, moved, iterate))
        taken.append(time.perf_counter() - start)
    return _spread(taken[20:])


def _throughput(
    iterate: Callable[..., Any], problem: Any, x0: Any, warm: Any, lanes: int, repeats: int
) -> dict[str, Any]:
    """Warm iterations a second of `lanes` scenarios with obstacles moved about, shared out over the devices."""
    import jax
    import jax.numpy as jnp
    import numpy as np
    from jax.sharding import Mesh, NamedSharding, PartitionSpec

    many = jax.tree.map(lambda leaf: jnp.broadcast_to(leaf, (lanes, *leaf.shape)), (problem, x0, warm))
    moved = np.random.default_rng(0).uniform(-0.3, 0.3, (lanes, *problem.places.shape))
    many = (dataclasses.replace(many[0], places=many[0].places + moved), *many[1:])
    mesh = Mesh(np.array(jax.devices()[: min(lanes, jax.device_count())]), ("lanes",))
    spread = PartitionSpec("lanes")
    problems, starts, warm = jax.device_put(many, NamedSharding(mesh, spread))

    # An accelerator takes all lanes at once.
    each = -(-lanes // mesh.size)
    group = min(GROUP, each) if jax.default_backend() == "cpu" else each

    def share(*held: Any) -> Any:
        return jax.lax.map(lambda lane: iterate(*lane), held, batch_size=group)

    shares = jax.shard_map(share, mesh=mesh, in_specs=spread, out_specs=spread, check_vma=False)
    started = time.perf_counter()
    lowered = jax.jit(shares, donate_argnums=2).lower(problems, starts, warm)
    program = lowered.compile(compiler_options=_options())
    compile_s = time.perf_counter() - started
    memory = program.memory_analysis()
    for _ in range(15):
        warm = program(problems, starts, warm)
    jax.block_until_ready(warm)
    taken = []
    for _ in range(5 * repeats):
        start = time.perf_counter()
        warm = jax.block_until_ready(program(problems, starts, warm))
        taken.append(time.perf_counter() - start)
    return {
        "lanes": lanes,
        "compile_s": round(compile_s, 3),
        "iterations_per_s": round(lanes / float(np.median(taken)), 1),
        "best": round(lanes / min(taken), 1),
        "temporary_mb_a_device": round(getattr(memory, "temp_size_in_bytes", 0) / 1e6, 3),
        "finite": bool(np.isfinite(np.asarray(warm.cost)).all()),
    }


def _timed(function: Callable[[], Any]) -> float:
    start = time.perf_counter()
    function()
    return time.perf_counter() - start


def _spread(taken: Sequence[float]) -> dict[str, Any]:
    """Median, least and 90th percentile in ms of times in s."""
    import numpy as np

    low, median, high = (1e3 * float(v) for v in (np.min(taken), np.median(taken), np.quantile(taken, 0.9)))
    return {"min": round(low, 4), "median": round(median, 4), "p90": round(high, 4), "calls": len(taken)}


if __name__ == "__main__":
    print(json.dumps(run(sys.argv[1], *map(int, sys.argv[2:4]))))
