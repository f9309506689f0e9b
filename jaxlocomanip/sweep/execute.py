"""Running a planned sweep: chunk by chunk, the next one drawn while the device is at work."""

from __future__ import annotations

import time
from collections.abc import Callable, Iterator, Mapping, Sequence
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass, field
from datetime import UTC, datetime
from typing import Any

import jax
import jax.numpy as jnp

from jaxlocomanip.batch import Runner
from jaxlocomanip.sampling.feasibility import REASONS
from jaxlocomanip.sampling.sampler import Lane, draw
from jaxlocomanip.sweep import rows
from jaxlocomanip.sweep.plan import Chunk, Plan, settings_of
from jaxlocomanip.sweep.store import Store, code_digest, versions

Say = Callable[[str], None]
"""Shows progress; the text has its own line breaks"""


@dataclass
class Progress:
    """How far a sweep has come, and how fast it goes."""

    total: int
    """scenario runs, over all planners"""
    done: int
    found: int = field(init=False)
    started: float = field(default_factory=time.perf_counter)

    def __post_init__(self) -> None:
        self.found = self.done

    def line(self) -> str:
        """One line: what is done, the speed, and the time left."""
        elapsed = time.perf_counter() - self.started
        speed = (self.done - self.found) / elapsed if elapsed > 0.0 else 0.0
        left = duration((self.total - self.done) / speed) if speed > 0.0 else "-"
        return f"{self.done}/{self.total} scenarios, {speed:.2f} scenarios/s, {left} left"


def duration(seconds: float) -> str:
    """A time span for people."""
    if seconds < 60.0:
        return f"{seconds:.0f} s"
    return f"{seconds / 60.0:.0f} min" if seconds < 5400.0 else f"{seconds / 3600.0:.1f} h"


def environment(devices: Sequence[Any]) -> dict[str, Any]:
    """What results may depend on beside the settings."""
    return {
        "platform": devices[0].platform,
        "dtype": str(jnp.zeros(()).dtype),
        "versions": versions(),
        "code": code_digest(),
    }


def execute(plan: Plan, directory: str, runner: Runner, command: Sequence[str], say: Say) -> Mapping[str, Any]:
    """Do what is left to do of a sweep, and join its results.

    Args:
      plan: what to do.
      directory: where to keep it.
      runner: of the plan's world.
      command: arguments of the command line, for the manifest.
      say: shows progress.

    Returns:
      The manifest.

    Raises:
      InputError: the directory cannot be used, or holds a sweep with other settings.
    """
    store = Store(directory, {**settings_of(plan), **environment(runner.devices)})
    with store.held():
        say(f"{plan.headline()}\n")
        manifest = {"command": list(command), "device": device(runner.devices), "complete": False}
        if not store.complete:
            store.describe(manifest)
            _run_all(plan, store, runner, say)
        return finish(plan, store, manifest)


def finish(plan: Plan, store: Store, manifest: Mapping[str, Any]) -> Mapping[str, Any]:
    """Join the results and write the final manifest, unless that has been done."""
    if (before := store.finished()) is not None:
        return before
    table = store.join([key(chunk, number) for chunk, number in plan.units()])
    first = table.slice(0, plan.lanes)  # every planner has the same scenarios
    whole = {
        **manifest,
        "complete": True,
        "finished": datetime.now(UTC).isoformat(timespec="seconds"),
        "lanes": plan.lanes,
        "rejected": {reason: sum(first[f"rejected_{reason}"].to_pylist()) for reason in REASONS},
    }
    store.describe(whole)
    return whole


def key(chunk: Chunk, planner: int) -> str:
    """Name of a piece of work, in the order of the work."""
    return f"{chunk.number:06d}-{planner:03d}"


def device(devices: Sequence[Any]) -> dict[str, Any]:
    """The devices that a sweep ran on."""
    return {"kind": devices[0].device_kind, "count": len(devices)}


def _run_all(plan: Plan, store: Store, runner: Runner, say: Say) -> None:
    done = store.done()
    left = [(chunk, number) for chunk, number in plan.units() if key(chunk, number) not in done]
    sizes = {chunk.number: len(chunk.lanes) for chunk in plan.chunks}
    progress = Progress(
        total=plan.lanes * len(plan.planners),
        done=sum(sizes[chunk.number] for chunk, number in plan.units() if key(chunk, number) in done),
    )
    if done:
        say(f"going on after {progress.done} of {progress.total} scenarios\n")
    known = len(runner.compilations)
    for chunk, number, lanes in drawn_ahead(plan, left):
        columns = run_unit(plan, runner, number, lanes)
        for program in runner.compilations[known:]:
            megabytes = f", {program.memory / 1e6:.0f} MB of intermediate results" if program.memory else ""
            say(f"compiled in {program.seconds:.1f} s{megabytes}\n")
            progress.started += program.seconds
        known = len(runner.compilations)
        store.keep(key(chunk, number), columns)
        progress.done += len(lanes)
        say(f"{progress.line()}\n")


def drawn_ahead(plan: Plan, units: Sequence[tuple[Chunk, int]]) -> Iterator[tuple[Chunk, int, list[Lane]]]:
    """Units with their lanes; those of the next chunk are drawn meanwhile by another thread."""
    chunks = list({chunk.number: chunk for chunk, _ in units}.values())
    with ThreadPoolExecutor(1) as pool:
        pending = {chunks[0].number: pool.submit(draw_chunk, plan, chunks[0])} if chunks else {}
        for i, chunk in enumerate(chunks):
            lanes = pending.pop(chunk.number).result()
            if i + 1 < len(chunks):
                pending[chunks[i + 1].number] = pool.submit(draw_chunk, plan, chunks[i + 1])
            for owner, number in units:
                if owner.number == chunk.number:
                    yield chunk, number, lanes


def draw_chunk(plan: Plan, chunk: Chunk) -> list[Lane]:
    """The scenarios of a chunk."""
    return [draw(plan.study, plan.seed, lane) for lane in chunk.lanes]


def run_unit(plan: Plan, runner: Runner, number: int, lanes: Sequence[Lane]) -> rows.Columns:
    """The rows of one planner over the scenarios of a chunk."""
    planner = plan.planners[number]
    scenarios = [lane.scenario for lane in lanes]
    outcome = jax.block_until_ready(runner(scenarios, planner.config, plan.seed, plan.shape))
    return rows.columns(plan.study, number, lanes, outcome)
