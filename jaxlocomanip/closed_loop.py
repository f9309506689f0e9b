"""The closed loop of planner and world: whole episodes, for one scenario or a batch.

    result = simulate(scenario)                  # one Scenario, or a batch with a leading axis: the same function
    result.outcome.reached, result.log.view.pose # arrays, with the batch axis first if there is one

The planner ticks at its own rate, searches its path at a slower one, and the world takes its own steps in between.
A lane whose state becomes non-finite, whose robot falls or whose duration has passed is frozen and never harms its
neighbours. Worlds in JAX run with the planner in one compiled scan; a world outside of JAX is stepped from Python.
"""

from __future__ import annotations

import dataclasses
import math
from functools import partial
from typing import Any

import jax
import numpy as np
from jax import Array

from jaxlocomanip import loop as closing
from jaxlocomanip.checked import InputError, installing, one_of
from jaxlocomanip.hosted import compiled_on_host
from jaxlocomanip.loop import Log, Loop, Result
from jaxlocomanip.numerics import select
from jaxlocomanip.planner.config import PlannerConfig
from jaxlocomanip.scenario import Scenario
from jaxlocomanip.worlds.interface import View, World
from jaxlocomanip.worlds.planar import PlanarWorld

WORLDS: tuple[str, ...] = ("planar", "quadruped")
"""Worlds by name."""
BACKENDS: tuple[str, ...] = ("c", "mjx")
"""Physics of the quadruped world: MuJoCo's own (one scenario, fast on a CPU), or MJX (batches in one program)."""
_Carry = tuple[Loop, Any, View]
"""What an episode carries from tick to tick: loop, state of the world, and how it looks."""


def simulate(
    scenarios: Scenario,
    config: PlannerConfig | None = None,
    world: str | World = "planar",
    *,
    backend: str | None = None,
    seed: int = 0,
    record: bool = True,
) -> Result:
    """Run scenarios in closed loop.

    Args:
      scenarios: one scenario, or a batch with a leading axis (`padding.stack`).
      config: planner settings; the `robust` preset by default.
      world: name in `WORLDS`, or a world of one's own (`worlds.interface.World`).
      backend: of the quadruped world, one of `BACKENDS`; by default `c` for one scenario and `mjx` for a batch.
      seed: of measurement noise; each lane folds in its own index.
      record: keep trajectories. Without, memory does not grow with the duration.

    Returns:
      Outcome and log; leaves have the batch axis first if `scenarios` has one.

    Raises:
      InputError: unknown world or backend, or a scenario that the world cannot represent.
    """
    return compiled(scenarios, config, world, backend=backend, record=record)(seed)


def compiled(
    scenarios: Scenario,
    config: PlannerConfig | None = None,
    world: str | World = "planar",
    *,
    backend: str | None = None,
    record: bool = True,
) -> Any:
    """`simulate` with its compilation done: a function seed -> Result. The compilation is shared by equal shapes."""
    batched = np.ndim(scenarios.duration) == 1
    chosen = load_world(world, backend, batched) if isinstance(world, str) else world
    behind = chosen.prepare(scenarios)
    settings = closing.suited(PlannerConfig() if config is None else config, behind)
    ticks = math.ceil(float(np.max(np.asarray(scenarios.duration))) / settings.horizon.tick - 1e-6)
    if not behind.traceable:
        return compiled_on_host(scenarios, settings, behind, ticks, record)
    function = _batch if batched else _single
    program = function.lower(scenarios, settings, jax.random.key(0), behind, ticks, record).compile()

    def run(seed: int) -> Result:
        return program(scenarios, settings, jax.random.key(seed), behind)

    return run


def load_world(name: str, backend: str | None, batched: bool) -> World:
    """A world by name, not yet prepared for any scenario.

    Raises:
      InputError: unknown world or backend; a backend that cannot do what is asked; MuJoCo is not installed.
    """
    one_of("world", name, WORLDS)
    if backend is not None:
        one_of("backend", backend, BACKENDS)
    if name == "planar":
        if backend is not None:
            raise InputError(f"backend = {backend!r}: only the quadruped world has backends")
        return PlanarWorld()
    if backend == "c" and batched:
        raise InputError("backend = 'c': steps one scenario at a time; use 'mjx' for a batch")
    try:
        from jaxlocomanip.worlds import quadruped

        return quadruped.world(backend or ("mjx" if batched else "c"))
    except ModuleNotFoundError as missing:
        raise InputError(f"world = 'quadruped': needs the sim extra ({missing}): {installing('sim')}") from None


@partial(jax.jit, static_argnames=("ticks", "record"))
def _single(scenario: Scenario, config: PlannerConfig, key: Array, world: World, ticks: int, record: bool) -> Result:
    return episode(scenario, config, key, world, ticks, record)


@partial(jax.jit, static_argnames=("ticks", "record"))
def _batch(scenarios: Scenario, config: PlannerConfig, key: Array, world: World, ticks: int, record: bool) -> Result:
    return jax.vmap(lambda s, w: episode(s, config, key, w, ticks, record))(scenarios, world)


def episode(scenario: Scenario, config: PlannerConfig, key: Array, world: World, ticks: int, record: bool) -> Result:
    """One scenario, as a pure function.

    Args:
      scenario: without batch axis.
      config: planner settings.
      key: random key; the scenario's index is folded in.
      world: the world behind the measurement, prepared for the scenario.
      ticks: number of planner ticks to run; a shorter `scenario.duration` freezes the rest.
      record: keep the trajectory.
    """
    state = world.start(scenario)
    view = world.view(state, scenario)
    loop = closing.begin(scenario, config, key, view)
    per_block = closing.ticks_per_search(config)

    def tick(carry: _Carry, _: None) -> tuple[_Carry, Log | None]:
        loop, state, view = carry
        decision = closing.decide(loop, view, scenario, config, key, record)
        new = world.step(state, scenario, decision.push, loop.tick * config.horizon.tick, config.horizon.tick)
        after = world.view(new, scenario)
        loop, moves = closing.settle(loop, decision, view, after, scenario, config)
        return (loop, *select(moves, (new, after), (state, view))), decision.row

    def block(carry: _Carry, _: None) -> tuple[_Carry, tuple[Log | None, Array, Array]]:
        loop, state, view = carry
        started = loop.tick * config.horizon.tick
        loop = closing.replan(loop, scenario, config)
        carry, rows = jax.lax.scan(tick, (loop, state, view), None, length=per_block)
        return carry, (rows, loop.planner.path.poses, started)

    # Whole blocks, so that the tick is compiled once; ticks past the end are frozen and cut from the log.
    blocks = -(-ticks // per_block)
    (loop, _, view), (rows, paths, path_times) = jax.lax.scan(block, (loop, state, view), None, length=blocks)
    log = jax.tree.map(lambda leaf: leaf.reshape(blocks * per_block, *leaf.shape[2:])[:ticks], rows)
    if log is not None:
        log = dataclasses.replace(log, path=paths, path_time=path_times)
    return Result(closing.finish(loop, scenario, view), log)
