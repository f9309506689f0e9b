"""Many scenarios in closed loop: chunks of one size through one compiled program, over all local devices.

    outcome = run([draw(study, 0, k).scenario for k in range(1000)], config, chunk=256)   # fields [1000] in NumPy

Memory is bounded by the chunk, since no trajectories are kept. A last chunk that is not full is padded with repeated
lanes, which are dropped again. With several devices each of them runs its share of a chunk on its own: they need
nothing of each other, so the lanes are mapped explicitly instead of leaving the partition to the compiler, which would
have every device wait for all others at each step of the path search.
"""

from __future__ import annotations

import dataclasses
import math
import time
from collections.abc import Callable, Sequence
from functools import partial
from typing import Any

import jax
import numpy as np
from jax import Array
from jax.sharding import Mesh, NamedSharding, PartitionSpec

from jaxlocomanip import checked
from jaxlocomanip.checked import InputError
from jaxlocomanip.closed_loop import Result, compiled, episode, load_world
from jaxlocomanip.loop import suited
from jaxlocomanip.outcome import Outcome
from jaxlocomanip.padding import Padding, stack_on_host
from jaxlocomanip.planner.config import PlannerConfig
from jaxlocomanip.scenario import Scenario
from jaxlocomanip.worlds.interface import World

AXIS = "lanes"
"""Name of the devices' axis."""
WHOLE: dict[str, str | bool] = {"xla_disable_hlo_passes": "cpu-parallel-task-assigner"}
"""Option of XLA for CPUs: where several devices share the cores, to split each small operation among these as well
costs a third more."""


def cpu_options(devices: Sequence[Any]) -> dict[str, str | bool] | None:
    """Options of the compiler for devices that share a program; none but for several CPUs."""
    return dict(WHOLE) if len(devices) > 1 and devices[0].platform == "cpu" else None


@dataclasses.dataclass(frozen=True)
class Shape:
    """What one compilation is for; decided for a whole study, so that all of its chunks share it."""

    lanes: int
    """scenarios in a chunk"""
    duration: float
    """s, of the longest scenario"""
    padding: Padding


@dataclasses.dataclass(frozen=True)
class Compiled:
    """A compiled chunk."""

    program: Callable[..., Outcome]
    seconds: float
    """s, taken by the compilation"""
    memory: int | None
    """bytes of intermediate results, as far as the compiler tells"""


class Runner:
    """Runs chunks of scenarios; compiles once for each shape of chunk and structure of settings."""

    def __init__(
        self, world: str | World = "planar", backend: str | None = None, devices: Sequence[Any] | None = None
    ) -> None:
        """Choose a world and devices.

        Args:
          world: name in `closed_loop.WORLDS`, or a world of one's own.
          backend: of the quadruped world: `mjx` (default), or `c`, which takes the lanes one after the other.
          devices: JAX devices to share the lanes of a chunk; all local ones by default.

        Raises:
          InputError: unknown world or backend.
        """
        self._world = load_world(world, backend, batched=backend != "c") if isinstance(world, str) else world
        self.devices = list(jax.local_devices() if devices is None else devices)
        self._mesh = Mesh(np.array(self.devices), (AXIS,))
        self._programs: dict[Any, Compiled] = {}

    @property
    def compilations(self) -> tuple[Compiled, ...]:
        """What has been compiled so far."""
        return tuple(self._programs.values())

    def __call__(self, scenarios: Sequence[Scenario], config: PlannerConfig, seed: int, shape: Shape) -> Outcome:
        """Outcomes [n] of the n scenarios of a chunk, as NumPy arrays.

        Args:
          scenarios: at most `shape.lanes`, with teams of one size.
          config: planner settings.
          seed: of measurement noise; each lane folds in its own index.
          shape: of the compiled chunk.

        Raises:
          InputError: more scenarios than lanes, or scenarios that the shape or the world cannot hold.
        """
        if not self._world.traceable:
            return self._one_by_one(scenarios, config, seed, shape)
        arguments, ticks = self._arguments(scenarios, config, seed, shape)
        outcome = self._compiled(arguments, ticks).program(*arguments)
        return jax.tree.map(lambda leaf: np.asarray(leaf)[: len(scenarios)], outcome)

    def prepare(self, scenarios: Sequence[Scenario], config: PlannerConfig, shape: Shape) -> None:
        """Compile what a call with such scenarios will run; arguments as there."""
        if self._world.traceable:
            self._compiled(*self._arguments(scenarios, config, 0, shape))
            return
        for lane in self._single(scenarios[:1], shape):
            compiled(lane, config, self._world, record=False)

    def _arguments(
        self, scenarios: Sequence[Scenario], config: PlannerConfig, seed: int, shape: Shape
    ) -> tuple[tuple[Any, ...], int]:
        """Arguments of the compiled chunk, on the devices, and its number of ticks."""
        _refuse_too_many(scenarios, shape)
        lanes = math.ceil(shape.lanes / len(self.devices)) * len(self.devices)
        full = [*scenarios, *[scenarios[-1]] * (lanes - len(scenarios))]
        batch = stack_on_host(full, shape.padding)
        world = self._world.prepare(batch)
        ticks = math.ceil(shape.duration / config.horizon.tick - 1e-6)
        if float(np.max(batch.duration)) > shape.duration + 1e-6:
            raise InputError(f"duration = {float(np.max(batch.duration)):g} s: must be <= {shape.duration:g} s")
        spread = NamedSharding(self._mesh, PartitionSpec(AXIS))
        batch, world = jax.device_put((batch, world), spread)
        return (batch, suited(config, self._world), jax.random.key(seed), world), ticks

    def _compiled(self, arguments: tuple[Any, ...], ticks: int) -> Compiled:
        leaves, structure = jax.tree.flatten(arguments)
        kinds = tuple((np.shape(leaf), getattr(leaf, "dtype", type(leaf))) for leaf in leaves)
        key = (structure, kinds, ticks)
        if key not in self._programs:
            start = time.perf_counter()
            lowered = jax.jit(partial(_chunk, ticks=ticks, mesh=self._mesh)).lower(*arguments)
            program = lowered.compile(compiler_options=cpu_options(self.devices))
            analysis = program.memory_analysis()
            memory = getattr(analysis, "temp_size_in_bytes", None)
            self._programs[key] = Compiled(program, time.perf_counter() - start, memory)
        return self._programs[key]

    def _one_by_one(self, scenarios: Sequence[Scenario], config: PlannerConfig, seed: int, shape: Shape) -> Outcome:
        """A world that is stepped outside of compiled programs has no batches; its planner still compiles once."""
        lanes = self._single(scenarios, shape)
        outcomes = [compiled(lane, config, self._world, record=False)(seed).outcome for lane in lanes]
        return jax.tree.map(lambda *leaves: np.stack([np.asarray(leaf) for leaf in leaves]), *outcomes)

    def _single(self, scenarios: Sequence[Scenario], shape: Shape) -> list[Scenario]:
        """Scenarios padded to the common shape."""
        _refuse_too_many(scenarios, shape)
        batch = stack_on_host(scenarios, shape.padding)
        return [jax.tree.map(lambda leaf, k=k: leaf[k], batch) for k in range(len(scenarios))]


def _refuse_too_many(scenarios: Sequence[Scenario], shape: Shape) -> None:
    if len(scenarios) > shape.lanes:
        raise InputError(f"scenarios: {len(scenarios)} do not fit into a chunk of {shape.lanes}")


def _chunk(scenarios: Scenario, config: PlannerConfig, key: Array, world: World, *, ticks: int, mesh: Mesh) -> Outcome:
    """Outcomes of a chunk; with several devices each maps over the lanes that it holds."""

    def share(scenarios: Scenario, config: PlannerConfig, key: Array, world: World) -> Outcome:
        one = lambda s, w: episode(s, config, key, w, ticks, record=False)  # noqa: E731
        result: Result = jax.vmap(one)(scenarios, world)
        return result.outcome

    if mesh.size == 1:
        return share(scenarios, config, key, world)
    lanes, whole = PartitionSpec(AXIS), PartitionSpec()
    spread = jax.shard_map(share, mesh=mesh, in_specs=(lanes, whole, whole, lanes), out_specs=lanes, check_vma=False)
    return spread(scenarios, config, key, world)


def run(
    scenarios: Sequence[Scenario],
    config: PlannerConfig | None = None,
    world: str | World = "planar",
    *,
    backend: str | None = None,
    seed: int = 0,
    chunk: int = 256,
    devices: Sequence[Any] | None = None,
    progress: Callable[[int, int], None] | None = None,
) -> Outcome:
    """Outcomes of any number of scenarios with teams of one size, in their order.

    Args:
      scenarios: at least one, with or without NumPy leaves.
      config: planner settings; the `robust` preset by default.
      world: name in `closed_loop.WORLDS`, or a world of one's own.
      backend: of the quadruped world.
      seed: of measurement noise; each lane folds in its own index.
      chunk: scenarios in one compiled batch; bounds the memory.
      devices: JAX devices; all local ones by default.
      progress: called with (scenarios done, scenarios in all) after each chunk.

    Returns:
      Fields [n, ...] as NumPy arrays.

    Raises:
      InputError: no scenarios, teams of different sizes, unknown world or backend, a scenario that the world cannot
        represent.
    """
    if not scenarios:
        raise InputError("scenarios: at least one is needed")
    checked.seed("seed", seed)
    runner = Runner(world, backend, devices)
    shape = Shape(
        lanes=min(checked.whole("chunk", chunk, 1, 10**7), len(scenarios)),
        duration=max(float(s.duration) for s in scenarios),
        padding=Padding.of(scenarios),
    )
    parts = []
    for first in range(0, len(scenarios), shape.lanes):
        part = scenarios[first : first + shape.lanes]
        parts.append(runner(part, PlannerConfig() if config is None else config, seed, shape))
        if progress is not None:
            progress(first + len(part), len(scenarios))
    return jax.tree.map(lambda *leaves: np.concatenate(leaves), *parts)
