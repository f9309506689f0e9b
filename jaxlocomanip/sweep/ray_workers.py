"""The chunks of a sweep on a Ray cluster: the same pieces of work, the same files, other hands.

Each worker is a Ray actor with its own compiled programs. The rows do not depend on how many there are: lane, chunk and
shape are those of the plan. A worker that is lost is started again, and its piece is done anew.
"""

from __future__ import annotations

import logging
import os
from collections.abc import Mapping, Sequence
from datetime import UTC, datetime
from typing import Any

from jaxlocomanip.checked import InputError
from jaxlocomanip.sweep.execute import Progress, Say, finish, key
from jaxlocomanip.sweep.plan import Plan, settings_of
from jaxlocomanip.sweep.store import Store

RETRIES = 3
"""times that a lost worker is replaced"""
AHEAD = 2
"""pieces of work that a worker has been given at most, so that it never waits"""
_PASSED_ON = ("PJRT_NPROC", "JAX_COMPILATION_CACHE_DIR", "JAX_PERSISTENT_CACHE_MIN_COMPILE_TIME_SECS", "JAX_ENABLE_X64")


class Worker:
    """What runs in each of Ray's processes."""

    def __init__(self, plan: Plan) -> None:
        """Prepare the plan's world, on all devices that this process sees."""
        from jaxlocomanip.batch import Runner

        self._plan = plan
        self._runner = Runner(plan.world, plan.backend)

    def environment(self) -> dict[str, Any]:
        """What results may depend on, and the device."""
        from jaxlocomanip.sweep import execute

        return {**execute.environment(self._runner.devices), "device": execute.device(self._runner.devices)}

    def run(self, chunk: int, planner: int) -> bytes:
        """The rows of a piece of work as Parquet."""
        from jaxlocomanip.sweep import execute
        from jaxlocomanip.sweep.store import to_parquet

        lanes = execute.draw_chunk(self._plan, self._plan.chunks[chunk])
        return to_parquet(execute.run_unit(self._plan, self._runner, planner, lanes))


def execute_on_ray(plan: Plan, directory: str, command: Sequence[str], say: Say, workers: int = 0) -> Mapping[str, Any]:
    """Do what is left to do of a sweep on a Ray cluster, and join its results.

    Args:
      plan: what to do.
      directory: where to keep it.
      command: arguments of the command line, for the manifest.
      say: shows progress.
      workers: how many; 0 for one on each GPU, or on each node of a cluster without any.

    Returns:
      The manifest.

    Raises:
      InputError: the directory cannot be used, or the workers' devices or versions differ.
    """
    import ray  # pyright: ignore[reportMissingImports]

    started = not ray.is_initialized()
    if started:
        passed_on = {name: os.environ[name] for name in _PASSED_ON if name in os.environ}
        ray.init(log_to_driver=False, logging_level=logging.ERROR, runtime_env={"env_vars": passed_on})
    try:
        gpus = int(ray.cluster_resources().get("GPU", 0))
        count = workers or gpus or len(ray.nodes())
        options = {"num_gpus": 1 if gpus else 0, "max_restarts": RETRIES, "max_task_retries": RETRIES}
        team = [ray.remote(Worker).options(**options).remote(plan) for _ in range(count)]
        environments = ray.get([worker.environment.remote() for worker in team])
        if any(one != environments[0] for one in environments):
            raise InputError(f"workers: devices or versions differ ({environments})")
        same = {name: value for name, value in environments[0].items() if name != "device"}
        store = Store(directory, {**settings_of(plan), **same})
        with store.held():
            say(f"{plan.headline()}, {count} Ray workers\n")
            about = {"command": list(command), "device": environments[0]["device"], "workers": count, "complete": False}
            if not store.complete:
                store.describe({**about, "started": datetime.now(UTC).isoformat(timespec="seconds")})
                _distribute(plan, store, team, say)
            return finish(plan, store, about)
    finally:
        if started:
            ray.shutdown()


def _distribute(plan: Plan, store: Store, team: Sequence[Any], say: Say) -> None:
    """Give every worker its next piece as soon as it has finished one."""
    import ray  # pyright: ignore[reportMissingImports]

    done = store.done()
    left = [(chunk, number) for chunk, number in plan.units() if key(chunk, number) not in done]
    left.reverse()
    total = plan.lanes * len(plan.planners)
    progress = Progress(total, total - sum(len(chunk.lanes) for chunk, _ in left))
    busy: dict[Any, tuple[Any, Any, int]] = {}

    def give(worker: Any) -> None:
        if left:
            chunk, number = left.pop()
            busy[worker.run.remote(chunk.number, number)] = (worker, chunk, number)

    for _ in range(AHEAD):
        for worker in team:
            give(worker)
    while busy:
        (ready,), _ = ray.wait(list(busy), num_returns=1)
        worker, chunk, number = busy.pop(ready)
        store.keep_bytes(key(chunk, number), ray.get(ready))
        progress.done += len(chunk.lanes)
        say(f"{progress.line()}\n")
        give(worker)
