"""The closed loop around a world that is stepped outside of JAX: one scenario, the ticks counted by Python.

The planner's halves of a tick are the compiled functions of `loop.py`; between them the world moves by itself.
"""

from __future__ import annotations

import dataclasses
from collections.abc import Callable
from functools import partial
from typing import Any

import jax
import numpy as np
from jax import Array

from jaxlocomanip import loop as closing
from jaxlocomanip.loop import Decision, Log, Loop, Result
from jaxlocomanip.planner.config import PlannerConfig
from jaxlocomanip.scenario import Scenario
from jaxlocomanip.worlds.interface import View, World


def compiled_on_host(
    scenario: Scenario, config: PlannerConfig, world: World, ticks: int, record: bool
) -> Callable[[int], Result]:
    """The closed loop of one scenario, compiled as far as it is traced: a function seed -> Result."""
    # Placed once: arguments that are already arrays of the device cost least in each call.
    scenario, config = jax.device_put((scenario, config))
    view = world.view(world.start(scenario), scenario)
    key = jax.random.key(0)
    loop = _begin(scenario, config, key, view)
    loop = _replan(loop, scenario, config)
    decision = _decide(loop, view, scenario, config, key, record)
    _settle(loop, decision, view, view, scenario, config)

    def run(seed: int) -> Result:
        return _run(scenario, config, world, jax.random.key(seed), ticks, record)

    return run


def _run(scenario: Scenario, config: PlannerConfig, world: World, key: Array, ticks: int, record: bool) -> Result:
    state = world.start(scenario)
    view = world.view(state, scenario)
    loop = _begin(scenario, config, key, view)
    rows, paths, path_times = [], [], []
    period, per_block = config.horizon.tick, closing.ticks_per_search(config)
    moves = True
    for k in range(ticks):
        if k % per_block == 0:
            path_times.append(k * period)
            loop = _replan(loop, scenario, config)
            paths.append(loop.planner.path.poses)
        decision = _decide(loop, view, scenario, config, key, record)
        rows.append(decision.row)
        # A lane that has ended (a fall, non-finite numbers) keeps its last state; its log goes on to the end.
        if moves:
            state = world.step(state, scenario, decision.push, k * period, period)
            after = world.view(state, scenario)
        else:
            after = view
        loop, moved = _settle(loop, decision, view, after, scenario, config)
        moves = bool(moved)
        view = after if moves else view
    outcome = closing.finish(loop, scenario, view)
    if not record:
        return Result(outcome, None)
    log: Log = jax.tree.map(lambda *leaves: np.stack(leaves), *rows)
    return Result(outcome, dataclasses.replace(log, path=np.stack(paths), path_time=np.array(path_times)))


@jax.jit
def _begin(scenario: Scenario, config: PlannerConfig, key: Array, view: View) -> Loop:
    return closing.begin(scenario, config, key, view)


@jax.jit
def _replan(loop: Loop, scenario: Scenario, config: PlannerConfig) -> Loop:
    return closing.replan(loop, scenario, config)


@partial(jax.jit, static_argnames=("record",))
def _decide(loop: Loop, view: View, scenario: Scenario, config: PlannerConfig, key: Array, record: bool) -> Decision:
    return closing.decide(loop, view, scenario, config, key, record)


@jax.jit
def _settle(
    loop: Loop, decision: Decision, before: View, after: View, scenario: Scenario, config: PlannerConfig
) -> tuple[Loop, Any]:
    return closing.settle(loop, decision, before, after, scenario, config)
