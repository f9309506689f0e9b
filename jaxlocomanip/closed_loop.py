"""The closed loop of planner and world: a whole episode inside one compiled scan, for one scenario or a batch.

    result = simulate(scenario)                  # one Scenario, or a batch with a leading axis: the same function
    result.outcome.reached, result.log.pose      # arrays, with the batch axis first if there is one

The planner ticks at its own rate, searches its path at a slower one, and the world takes its substeps in between. A
lane whose state becomes non-finite, or whose duration has passed, is frozen and never harms its neighbours.
"""

from __future__ import annotations

import dataclasses
import math
from collections.abc import Mapping
from functools import partial
from types import MappingProxyType
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
from jax import Array

from jaxlocomanip.checked import one_of
from jaxlocomanip.numerics import all_finite, pytree, select
from jaxlocomanip.outcome import Clearances, Outcome, Tally, clearances, count, start_tally, summarise
from jaxlocomanip.planner import nmpc
from jaxlocomanip.planner.config import PlannerConfig
from jaxlocomanip.planner.nmpc import Command, Measurement, PlannerState, Report, Task
from jaxlocomanip.planner.shapes import shapes_of
from jaxlocomanip.scenario import Scenario
from jaxlocomanip.solver.sqp import Status
from jaxlocomanip.worlds.interface import Push, View, World
from jaxlocomanip.worlds.planar import PlanarWorld

WORLDS: Mapping[str, World] = MappingProxyType({"planar": PlanarWorld()})
"""Worlds by name."""

MAX_DELAY_TICKS = 6
"""longest command delay that the loop can represent, in ticks"""


@pytree
class Log:
    """Trajectory of an episode, one row a tick [T, ...], with the state before the row's command acts."""

    time: Array
    """[T] s"""
    view: View
    """true state"""
    obstacles: Array
    """[T, N_o, 2] m, true positions"""
    clearances: Clearances
    command: Command
    report: Report
    plan: Array
    """[T, N + 1, 3] predicted object poses"""
    path: Array
    """[P, POINTS, 3] paths found by the P searches of the episode"""
    path_time: Array
    """[P] s, from when each of them is in force"""
    estimate: Array
    """[T, 3] estimated object pose"""
    parameters: Array
    """[T, 6] estimated Psi"""
    solver: Array
    """[T, 5] cost, defect, step, step length, status"""


@pytree
class Result:
    """Outcome and, if recorded, the trajectory."""

    outcome: Outcome
    log: Log | None


@pytree
class _Loop:
    planner: PlannerState
    world: Any
    commands: Command
    """the last MAX_DELAY_TICKS + 1 commands, newest first"""
    tally: Tally
    least: Clearances
    """clearances now"""
    tick: Array
    alive: Array


def simulate(
    scenarios: Scenario,
    config: PlannerConfig | None = None,
    world: str = "planar",
    *,
    seed: int = 0,
    record: bool = True,
) -> Result:
    """Run scenarios in closed loop.

    Args:
      scenarios: one scenario, or a batch with a leading axis (`scenario.stack`).
      config: planner settings; the `robust` preset by default.
      world: name in `WORLDS`.
      seed: of measurement noise; each lane folds in its own index.
      record: keep trajectories. Without, memory does not grow with the duration.

    Returns:
      Outcome and log; leaves have the batch axis first if `scenarios` has one.

    Raises:
      InputError: unknown world.
    """
    return compiled(scenarios, config, world, record=record)(seed)


def compiled(
    scenarios: Scenario, config: PlannerConfig | None = None, world: str = "planar", *, record: bool = True
) -> Any:
    """`simulate` with its compilation done: a function seed -> Result. The compilation is shared by equal shapes."""
    one_of("world", world, list(WORLDS))
    settings = PlannerConfig() if config is None else config
    ticks = math.ceil(float(np.max(np.asarray(scenarios.duration))) / settings.horizon.tick - 1e-6)
    batched = np.ndim(scenarios.duration) == 1
    function = _batch if batched else _single
    key = jax.random.key(0)
    program = function.lower(scenarios, settings, key, world, ticks, record).compile()

    def run(seed: int) -> Result:
        return program(scenarios, settings, jax.random.key(seed))

    return run


@partial(jax.jit, static_argnames=("world", "ticks", "record"))
def _single(scenario: Scenario, config: PlannerConfig, key: Array, world: str, ticks: int, record: bool) -> Result:
    return episode(scenario, config, key, WORLDS[world], ticks, record)


@partial(jax.jit, static_argnames=("world", "ticks", "record"))
def _batch(scenarios: Scenario, config: PlannerConfig, key: Array, world: str, ticks: int, record: bool) -> Result:
    return jax.vmap(lambda s: episode(s, config, key, WORLDS[world], ticks, record))(scenarios)


def episode(scenario: Scenario, config: PlannerConfig, key: Array, world: World, ticks: int, record: bool) -> Result:
    """One scenario, as a pure function.

    Args:
      scenario: without batch axis.
      config: planner settings.
      key: random key; the scenario's index is folded in.
      world: the world behind the measurement.
      ticks: number of planner ticks to run; a shorter `scenario.duration` freezes the rest.
      record: keep the trajectory.
    """
    task = Task(shapes_of(scenario), scenario.object, scenario.goal)
    lane = jax.random.fold_in(key, scenario.index)
    state = world.start(scenario)
    planner = nmpc.start(
        task, _measure(world.view(state, scenario), scenario, lane, jnp.zeros((), jnp.int32), 0.0), config
    )
    history = jax.tree.map(lambda leaf: jnp.stack([leaf] * (MAX_DELAY_TICKS + 1)), planner.command)
    zero = jnp.zeros((), jnp.int32)
    least = clearances(scenario, world.view(state, scenario), scenario.obstacles.at(jnp.zeros(())))
    loop = _Loop(planner, state, history, start_tally(scenario), least, zero, jnp.ones((), bool))
    per_block = max(1, round(config.reference.replan / config.horizon.tick))

    def tick(carry: _Loop, _: None) -> tuple[_Loop, Log | None]:
        return _tick(carry, scenario, task, config, lane, world, record)

    def block(carry: _Loop, _: None) -> tuple[_Loop, tuple[Log | None, Array, Array]]:
        started = carry.tick * config.horizon.tick
        searched = nmpc.replan(carry.planner, task, config)
        carry, rows = jax.lax.scan(tick, dataclasses.replace(carry, planner=searched), None, length=per_block)
        return carry, (rows, searched.path.poses, started)

    # Whole blocks, so that the tick is compiled once; ticks past the end are frozen and cut from the log.
    blocks = -(-ticks // per_block)
    loop, (rows, paths, path_times) = jax.lax.scan(block, loop, None, length=blocks)
    log = jax.tree.map(lambda leaf: leaf.reshape(blocks * per_block, *leaf.shape[2:])[:ticks], rows)
    outcome = summarise(loop.tally, scenario, world.view(loop.world, scenario), loop.planner.parameters.psi)
    if log is not None:
        log = dataclasses.replace(log, path=paths, path_time=path_times)
    return Result(outcome, log)


def _measure(view: View, scenario: Scenario, lane: Array, tick: Array, time: Array | float) -> Measurement:
    sensing = scenario.sensing
    pose_key, obstacle_key = jax.random.split(jax.random.fold_in(lane, tick))
    spread = jnp.stack([sensing.position_std, sensing.position_std, sensing.heading_std])
    positions = scenario.obstacles.at(jnp.asarray(time, view.pose.dtype))
    return Measurement(
        pose=view.pose + spread * jax.random.normal(pose_key, (3,), view.pose.dtype),
        offset=view.offset,
        obstacles=positions + sensing.obstacle_std * jax.random.normal(obstacle_key, positions.shape, positions.dtype),
    )


def _tick(
    loop: _Loop,
    scenario: Scenario,
    task: Task,
    config: PlannerConfig,
    lane: Array,
    world: World,
    record: bool,
) -> tuple[_Loop, Log | None]:
    period = config.horizon.tick
    time = loop.tick * period
    view = world.view(loop.world, scenario)
    measured = _measure(view, scenario, lane, loop.tick, time)
    planner, command, report = nmpc.tick(loop.planner, measured, task, config)
    commands = jax.tree.map(lambda new, old: jnp.concatenate([new[None], old[:-1]]), command, loop.commands)
    delay = jnp.clip(jnp.rint(scenario.sensing.command_delay / period), 0, MAX_DELAY_TICKS).astype(jnp.int32)
    acting = jax.tree.map(lambda leaf: leaf[delay], commands)
    state = world.step(loop.world, scenario, Push(acting.force, acting.offset_rate), period)
    after = world.view(state, scenario)
    end = time + period
    least = clearances(scenario, after, scenario.obstacles.at(end))
    finite = all_finite(after)
    status = jnp.where(finite, planner.solver.status, Status.NONFINITE)
    tally = count(loop.tally, scenario, view, after, least, status, end, period)
    running = loop.alive & (time < scenario.duration - 1e-4)
    frozen = dataclasses.replace(
        loop, tally=dataclasses.replace(loop.tally, nonfinite=loop.tally.nonfinite + (running & ~finite))
    )
    moved = _Loop(planner, state, commands, tally, least, loop.tick + 1, loop.alive)
    new = select(running & finite, moved, frozen)
    new = dataclasses.replace(new, alive=loop.alive & finite, tick=loop.tick + 1)
    if not record:
        return new, None
    solver = planner.solver
    row = Log(
        time=time,
        view=view,
        obstacles=scenario.obstacles.at(time),
        clearances=loop.least,
        command=command,
        report=report,
        plan=solver.plan.xs[:, :3],
        path=jnp.zeros((0,)),
        path_time=jnp.zeros((0,)),
        estimate=planner.object.pose,
        parameters=planner.parameters.filtered,
        solver=jnp.stack([solver.cost, solver.defect, solver.step, solver.length, solver.status.astype(time.dtype)]),
    )
    return new, row
