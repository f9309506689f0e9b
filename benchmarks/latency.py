"""Latency of one planner tick and of its parts, for a single scenario on its way."""

from __future__ import annotations

import dataclasses
from collections.abc import Callable, Mapping
from typing import Any

import jax
import jax.numpy as jnp
from jax import Array

from benchmarks.timing import compiled, milliseconds
from jaxlocomanip import PlannerConfig, build_scenario, find_scenario
from jaxlocomanip.loop import task_of
from jaxlocomanip.numerics import pytree
from jaxlocomanip.planner import decision, keeping, nmpc, problem, reference, safety
from jaxlocomanip.planner.problem import PushProblem
from jaxlocomanip.planner.room import bodies_of, standing_room
from jaxlocomanip.planner.situation import Situation
from jaxlocomanip.planner.state import Command, Measurement, PlannerState, Task, start
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
LOOPED = 20
"""ticks of the compiled loop, which shows what a tick costs without the call"""
WORLD = PlanarWorld()


@pytree
class Instant:
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


def measure(calls: int) -> dict[str, Any]:
    """Times in ms of the parts that do not depend on the horizon, and of the others for each horizon in `STAGES`."""
    base = PlannerConfig()
    horizons, common = [], {}
    for stages in STAGES:
        config = dataclasses.replace(base, horizon=dataclasses.replace(base.horizon, steps=stages))
        tick = compiled(nmpc.tick)
        s = instant(jax.device_put(config), tick)
        loop = milliseconds(compiled(_loop), s, calls=max(calls // LOOPED, 20))
        parts = {
            "tick": milliseconds(tick, s.state, s.measured, s.task, s.config, calls=calls),
            "tick and world step in a compiled loop": {
                name: value if name == "calls" else value / LOOPED for name, value in loop.items()
            },
            **_timed(_depending(s), calls),
        }
        iterations = config.horizon.sqp_iterations
        horizons.append({"stages": stages, "sqp_iterations": iterations, "parts_ms": parts})
        common = common or _timed(_independent(s), calls)
    return {"horizons": horizons, "common_ms": common}


def _timed(parts: Mapping[str, tuple[Any, ...]], calls: int) -> dict[str, dict[str, float | int]]:
    return {name: milliseconds(compiled(part), *arguments, calls=calls) for name, (part, *arguments) in parts.items()}


def _depending(s: Instant) -> dict[str, tuple[Any, ...]]:
    """Parts of a tick whose work grows with the horizon: a function and its arguments each."""
    lq, *_ = jax.jit(sqp.linearise)(s.problem, s.solver.plan)
    settings = decision.options(s.config)
    still = jnp.zeros_like(s.x0)
    direction = jax.jit(riccati.solve)(lq, still, s.solver.damping)
    return {
        "assemble": (_assemble, s.state, _targets(s.state, s.config), s.task, s.config),
        "second start": (_second_start, s.problem, s.x0),
        "sqp": (sqp.solve, s.problem, s.x0, s.solver, settings),
        "sqp: linearise": (sqp.linearise, s.problem, s.solver.plan),
        "sqp: riccati": (riccati.solve, lq, still, s.solver.damping),
        "sqp: line search": (_line_search, s.problem, s.solver.plan, direction, jnp.asarray(settings.step_lengths)),
    }


def _independent(s: Instant) -> dict[str, tuple[Any, ...]]:
    """The other parts, what happens between ticks, and a call that computes nothing."""
    observed = nmpc.observe(s.state, s.measured, s.task, s.config)
    force = s.solver.plan.us[0, : s.push.force.shape[0]]
    return {
        "observe": (nmpc.observe, s.state, s.measured, s.task, s.config),
        "filter": (_filter, force, s.push.offset_rate, observed, s.measured, s.task, s.config),
        "path search": (nmpc.replan, s.state, s.task, s.config),
        "world step": (_world_step, s.world, s.scenario, s.push, s.config),
        "empty call": (_nothing, s.state, s.measured, s.task, s.config),
    }


def instant(config: PlannerConfig, tick: Callable[..., Any]) -> Instant:
    """The scenario `adaptive` after `LEAD_IN` ticks of closed loop."""
    scenario = build_scenario(find_scenario("adaptive"))
    task = task_of(scenario)
    world = WORLD.start(scenario)
    measured = _measurement(world, scenario, 0)
    state = nmpc.replan(start(task, measured, config), task, config)
    step = jax.jit(_world_step)
    push = _asked(state.command)
    for k in range(LEAD_IN):
        measured = _measurement(world, scenario, k * config.horizon.tick)
        state, command, _ = tick(state, measured, task, config)
        push = _asked(command)
        world = step(world, scenario, push, config)
    measured = _measurement(world, scenario, LEAD_IN * config.horizon.tick)
    x0 = jnp.concatenate([measured.pose, state.object.twist, measured.offset])
    solver = nmpc.shift(state.solver, config.horizon.tick / config.horizon.dt)
    solver = dataclasses.replace(solver, plan=Plan(solver.plan.xs.at[0].set(x0), solver.plan.us))
    ocp = jax.jit(_assemble)(state, _targets(state, config), task, config)
    return Instant(scenario, config, task, state, measured, world, push, ocp, solver, x0)


def _loop(s: Instant) -> tuple[PlannerState, PlanarState]:
    start = LEAD_IN * s.config.horizon.tick

    def body(carry: tuple[PlannerState, PlanarState], k: Array) -> tuple[tuple[PlannerState, PlanarState], None]:
        state, world = carry
        measured = _measurement(world, s.scenario, start + k * s.config.horizon.tick)
        state, command, _ = nmpc.tick(state, measured, s.task, s.config)
        push = _asked(command)
        return (state, WORLD.step(world, s.scenario, push, k, s.config.horizon.tick)), None

    return jax.lax.scan(body, (s.state, s.world), jnp.arange(float(LOOPED)))[0]


def _asked(command: Command) -> Push:
    return Push(command.force, command.offset_rate, command.twist, command.resting)


def _measurement(world: PlanarState, scenario: Scenario, time: float | Array) -> Measurement:
    view = WORLD.view(world, scenario)
    return Measurement(view.pose, view.offset, scenario.obstacles.at(jnp.asarray(time)), view.contact, view.formation)


def _targets(state: PlannerState, config: PlannerConfig) -> reference.Targets:
    times = config.horizon.dt * jnp.arange(config.horizon.steps + 1.0)
    return reference.targets(state.progress, state.path, times, config.reference)


def _assemble(state: PlannerState, targets: reference.Targets, task: Task, config: PlannerConfig) -> PushProblem:
    body = state.parameters.body
    return problem.assemble(targets, state.solver.plan, body, task.shapes, state.obstacles, config)


def _second_start(ocp: PushProblem, x0: Array) -> Plan:
    return problem.pushing_start(ocp, x0)


def _line_search(ocp: PushProblem, plan: Plan, direction: Direction, lengths: Array) -> tuple[Array, Array]:
    def tried(a: Array) -> tuple[Array, Array]:
        return sqp.evaluate(ocp, Plan(plan.xs + a * direction.dxs, plan.us + a * direction.dus))

    return jax.vmap(tried)(lengths)


def _filter(
    force: Array, rate: Array, observed: Any, measured: Measurement, task: Task, config: PlannerConfig
) -> safety.Filtered:
    estimate, parameters, obstacles, acting, watched = observed
    body = parameters.body
    proven = safety.least_friction(body, config)
    shapes, offset, none = task.shapes, measured.offset, jnp.zeros(())
    gaps = keeping.gaps_of(estimate, offset, obstacles, shapes, config)
    room = standing_room(gaps, bodies_of(shapes, config))
    now = watched.waiting, none, none > 0.0
    seen = Situation(estimate, body, obstacles, offset, room, gaps, acting, proven, *now)
    return safety.safety_filter(force, rate, shapes.team.force_max, seen, shapes, config)


def _world_step(world: PlanarState, scenario: Scenario, push: Push, config: PlannerConfig) -> PlanarState:
    return WORLD.step(world, scenario, push, jnp.zeros(()), config.horizon.tick)


def _nothing(state: PlannerState, measured: Measurement, task: Task, config: PlannerConfig) -> Array:
    return measured.pose
