"""One tick of the closed loop, in two halves around the world's own step, and what is kept of it.

The same halves serve worlds that are compiled into one program with the planner and worlds that step outside of it.
"""

from __future__ import annotations

import dataclasses

import jax
import jax.numpy as jnp
from jax import Array

from jaxlocomanip.numerics import all_finite, pytree, select
from jaxlocomanip.outcome import Clearances, Outcome, Tally, clearances, count, gaps, nearest, start_tally, summarise
from jaxlocomanip.planner import nmpc, state
from jaxlocomanip.planner.config import PlannerConfig
from jaxlocomanip.planner.decision import Report
from jaxlocomanip.planner.shapes import shapes_of
from jaxlocomanip.planner.state import Command, Measurement, PlannerState, Task
from jaxlocomanip.scenario import Scenario
from jaxlocomanip.solver.sqp import Status
from jaxlocomanip.specification import LONGEST_DELAY
from jaxlocomanip.worlds.interface import Push, View, World


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
class Loop:
    """What the closed loop carries from tick to tick, but for the world's own state."""

    planner: PlannerState
    commands: Command
    """the last commands, newest first, as many as the longest delay asks for"""
    tally: Tally
    least: Clearances
    """clearances now"""
    tick: Array
    """[] int, the same in every lane of a batch"""
    alive: Array
    """[] bool: finite, and nobody has fallen"""


@pytree
class Decision:
    """What the planner made of a measurement."""

    planner: PlannerState
    commands: Command
    push: Push
    """what acts now, after the command's delay"""
    row: Log | None


def task_of(scenario: Scenario) -> Task:
    """What the planner is told of a scenario."""
    return Task(shapes_of(scenario), scenario.formations, scenario.object, scenario.goal)


def suited(config: PlannerConfig, world: World) -> PlannerConfig:
    """Settings of the planner in a world: robots that sway need so much more room, to each other and to obstacles."""
    safety, constraints = config.safety, config.constraints
    safety = dataclasses.replace(safety, margin=safety.margin + world.sway, team_margin=safety.team_margin + world.sway)
    constraints = dataclasses.replace(constraints, margin=constraints.margin + world.sway)
    return dataclasses.replace(config, safety=safety, constraints=constraints)


def begin(scenario: Scenario, config: PlannerConfig, key: Array, view: View) -> Loop:
    """The loop before the first tick, the world in its first state."""
    # A look at the scene one tick ahead of the first: filters take what they see next for another, later look.
    measured = measure(view, scenario, key, jnp.full((), -1, jnp.int32), config)
    planner = state.start(task_of(scenario), measured, config)
    kept = round(LONGEST_DELAY / config.horizon.tick) + 1
    history = jax.tree.map(lambda leaf: jnp.stack([leaf] * kept), planner.command)
    least = clearances(scenario, view, scenario.obstacles.at(jnp.zeros(())))
    return Loop(planner, history, start_tally(scenario), least, jnp.zeros((), jnp.int32), jnp.ones((), bool))


def replan(loop: Loop, scenario: Scenario, config: PlannerConfig) -> Loop:
    """The planner's path searched anew."""
    return dataclasses.replace(loop, planner=nmpc.replan(loop.planner, task_of(scenario), config))


def measure(view: View, scenario: Scenario, key: Array, tick: Array, config: PlannerConfig) -> Measurement:
    """What the planner gets to see: the truth and noise, drawn by lane and tick."""
    sensing = scenario.sensing
    lane = jax.random.fold_in(key, scenario.index)
    pose_key, obstacle_key = jax.random.split(jax.random.fold_in(lane, tick))
    spread = jnp.stack([sensing.position_std, sensing.position_std, sensing.heading_std])
    positions = scenario.obstacles.at(tick * config.horizon.tick)
    return Measurement(
        pose=view.pose + spread * jax.random.normal(pose_key, (3,), view.pose.dtype),
        offset=view.offset,
        obstacles=positions + sensing.obstacle_std * jax.random.normal(obstacle_key, positions.shape, positions.dtype),
        contact=view.contact,
        formation=view.formation,
    )


def decide(loop: Loop, view: View, scenario: Scenario, config: PlannerConfig, key: Array, record: bool) -> Decision:
    """First half of a tick: measure, plan, command."""
    time = loop.tick * config.horizon.tick
    measured = measure(view, scenario, key, loop.tick, config)
    planner, command, report = nmpc.tick(loop.planner, measured, task_of(scenario), config)
    commands = jax.tree.map(lambda new, old: jnp.concatenate([new[None], old[:-1]]), command, loop.commands)
    delay = jnp.rint(scenario.sensing.command_delay / config.horizon.tick)
    acting = jax.tree.map(lambda leaf: leaf[delay.astype(jnp.int32)], commands)
    push = Push(acting.force, acting.offset_rate, acting.twist, acting.resting, acting.formation)
    if not record:
        return Decision(planner, commands, push, None)
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
    return Decision(planner, commands, push, row)


def settle(
    loop: Loop, decision: Decision, before: View, after: View, scenario: Scenario, config: PlannerConfig
) -> tuple[Loop, Array]:
    """Second half of a tick, the world having moved on: figures, and whether the lane takes its new state.

    A lane whose state is no longer finite keeps its last one for good; one with a fallen robot keeps the fall.
    """
    period = config.horizon.tick
    end = (loop.tick + 1) * period
    apart = gaps(scenario, after, scenario.obstacles.at(end))
    least = nearest(scenario, after, apart)
    finite = all_finite(after)
    status = jnp.where(finite, decision.planner.solver.status, Status.NONFINITE)
    tally = count(loop.tally, scenario, before, after, apart, least, status, end, period)
    running = loop.alive & (loop.tick * period < scenario.duration - 1e-4)
    nonfinite = loop.tally.nonfinite + (running & ~finite)
    frozen = dataclasses.replace(loop, tally=dataclasses.replace(loop.tally, nonfinite=nonfinite))
    moved = Loop(decision.planner, decision.commands, tally, least, loop.tick, loop.alive)
    moves = running & finite
    new = select(moves, moved, frozen)
    alive = loop.alive & finite & ~(moves & jnp.any(after.fallen))
    # The tick is kept out of every selection, so that in a batch it stays one number for all lanes.
    return dataclasses.replace(new, alive=alive, tick=loop.tick + 1), moves


def finish(loop: Loop, scenario: Scenario, view: View) -> Outcome:
    """The outcome of an episode that ended in the state `view`."""
    return summarise(loop.tally, scenario, view, loop.planner.parameters.psi)


def ticks_per_search(config: PlannerConfig) -> int:
    """Planner ticks between two searches of the path."""
    return max(1, round(config.reference.replan / config.horizon.tick))
