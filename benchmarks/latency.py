"""Latency of one planner tick and of its parts, for a single scenario on its way."""

from __future__ import annotations

import dataclasses
from typing import Any

import jax
import jax.numpy as jnp
from jax import Array

from benchmarks.timing import milliseconds
from jaxlocomanip import PlannerConfig, build_scenario, find_scenario
from jaxlocomanip.numerics import pytree
from jaxlocomanip.planner import nmpc, problem, reference, safety
from jaxlocomanip.planner.nmpc import Measurement, PlannerState, Task
from jaxlocomanip.planner.problem import PushProblem
from jaxlocomanip.planner.shapes import shapes_of
from jaxlocomanip.scenario import Scenario
from jaxlocomanip.solver import riccati, sqp
from jaxlocomanip.solver.ocp import Plan
from jaxlocomanip.solver.riccati import Direction
from jaxlocomanip.solver.sqp import Iterate
from jaxlocomanip.worlds.interface import Push
from jaxlocomanip.worlds.planar import PlanarState, PlanarWorld

STAGES = (30, 50)
"""horizons N that are measured"""
LEAD_IN = 100
"""ticks before the measured one, so that the object moves and the plan is warm"""
WORLD = PlanarWorld()


@pytree
class Situation:
    """The arguments of one tick and of its parts."""

    scenario: Scenario
    config: PlannerConfig
    task: Task
    state: PlannerState
    measured: Measurement
    world: PlanarState
    push: Push
    problem: PushProblem
    solver: Iterate
    x0: Array


def measure(calls: int) -> list[dict[str, Any]]:
    """One record for each horizon in `STAGES`: stages, sqp_iterations and the times of the parts in ms."""
    return [_measure(stages, calls) for stages in STAGES]


def _measure(stages: int, calls: int) -> dict[str, Any]:
    base = PlannerConfig()
    config = dataclasses.replace(base, horizon=dataclasses.replace(base.horizon, steps=stages))
    s = situation(config)
    lq, _ = jax.jit(sqp.linearise)(s.problem, s.solver.plan)
    settings = nmpc.options(config)
    direction = jax.jit(riccati.solve)(lq, jnp.zeros_like(s.x0), s.solver.damping)
    lengths = jnp.asarray(settings.step_lengths)
    observed = nmpc.observe(s.state, s.measured, s.task, config)
    targets = _targets(s.state, config)
    force = s.solver.plan.us[0, : s.push.force.shape[0]]
    parts = {
        "tick": (nmpc.tick, s.state, s.measured, s.task, config),
        "observe": (nmpc.observe, s.state, s.measured, s.task, config),
        "assemble": (_assemble, s.state, targets, s.task, config),
        "second start": (_second_start, s.problem, s.solver, s.x0),
        "sqp": (sqp.solve, s.problem, s.x0, s.solver, settings),
        "sqp: linearise": (sqp.linearise, s.problem, s.solver.plan),
        "sqp: riccati": (riccati.solve, lq, jnp.zeros_like(s.x0), s.solver.damping),
        "sqp: line search": (_line_search, s.problem, s.solver.plan, direction, lengths),
        "filter": (_filter, force, s.push.offset_rate, observed, s.measured, s.task, config),
        "path search": (nmpc.replan, s.state, s.task, config),
        "world step": (_world_step, s.world, s.scenario, s.push, config),
        "empty call": (_nothing, s.state, s.measured, s.task, config),
    }
    times = {name: milliseconds(*call, calls=calls) for name, call in parts.items()}
    return {"stages": stages, "sqp_iterations": config.horizon.sqp_iterations, "parts_ms": times}


def situation(config: PlannerConfig) -> Situation:
    """The scenario `adaptive` after `LEAD_IN` ticks of closed loop."""
    scenario = build_scenario(find_scenario("adaptive"))
    task = Task(shapes_of(scenario), scenario.object, scenario.goal)
    world = WORLD.start(scenario)
    measured = _measurement(world, scenario, jnp.zeros(()))
    state = nmpc.replan(nmpc.start(task, measured, config), task, config)
    tick, step = jax.jit(nmpc.tick), jax.jit(_world_step)
    push = Push(jnp.zeros_like(measured.offset), jnp.zeros_like(measured.offset))
    for k in range(LEAD_IN):
        measured = _measurement(world, scenario, jnp.asarray(k * config.horizon.tick))
        state, command, _ = tick(state, measured, task, config)
        push = Push(command.force, command.offset_rate)
        world = step(world, scenario, push, config)
    measured = _measurement(world, scenario, jnp.asarray(LEAD_IN * config.horizon.tick))
    x0 = jnp.concatenate([measured.pose, state.object.twist, measured.offset])
    solver = nmpc.shift(state.solver, config.horizon.tick / config.horizon.dt)
    solver = dataclasses.replace(solver, plan=Plan(solver.plan.xs.at[0].set(x0), solver.plan.us))
    ocp = jax.jit(_assemble)(state, _targets(state, config), task, config)
    return Situation(scenario, config, task, state, measured, world, push, ocp, solver, x0)


def _measurement(world: PlanarState, scenario: Scenario, time: Array) -> Measurement:
    view = WORLD.view(world, scenario)
    return Measurement(view.pose, view.offset, scenario.obstacles.at(time))


def _targets(state: PlannerState, config: PlannerConfig) -> reference.Targets:
    times = config.horizon.dt * jnp.arange(config.horizon.steps + 1.0)
    return reference.targets(state.progress, state.path, times, config.reference)


def _assemble(state: PlannerState, targets: reference.Targets, task: Task, config: PlannerConfig) -> PushProblem:
    body = state.parameters.body
    return problem.assemble(targets, state.solver.plan, body, task.shapes, state.obstacles, config)


def _second_start(ocp: PushProblem, solver: Iterate, x0: Array) -> Iterate:
    return sqp.better_start(ocp, solver, problem.pushing_start(ocp, x0), nmpc.DEFECT_WEIGHT)


def _line_search(ocp: PushProblem, plan: Plan, direction: Direction, lengths: Array) -> tuple[Array, Array]:
    def tried(a: Array) -> tuple[Array, Array]:
        return sqp.evaluate(ocp, Plan(plan.xs + a * direction.dxs, plan.us + a * direction.dus))

    return jax.vmap(tried)(lengths)


def _filter(
    force: Array, rate: Array, observed: Any, measured: Measurement, task: Task, config: PlannerConfig
) -> safety.Filtered:
    estimate, parameters, obstacles, _ = observed
    return safety.safety_filter(force, rate, estimate, measured.offset, obstacles, parameters.body, task.shapes, config)


def _world_step(world: PlanarState, scenario: Scenario, push: Push, config: PlannerConfig) -> PlanarState:
    return WORLD.step(world, scenario, push, config.horizon.tick)


def _nothing(state: PlannerState, measured: Measurement, task: Task, config: PlannerConfig) -> Array:
    return measured.pose
