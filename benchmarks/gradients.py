"""Derivatives of a plan: the implicit function theorem beside the unrolled solver, in time and memory."""

from __future__ import annotations

import dataclasses
from collections.abc import Callable
from typing import Any

import jax
import jax.numpy as jnp
from jax import Array

from benchmarks.latency import instant
from benchmarks.timing import compiled, in_turn
from jaxlocomanip import PlannerConfig
from jaxlocomanip.planner import nmpc
from jaxlocomanip.planner.problem import PushProblem
from jaxlocomanip.solver import implicit, sqp
from jaxlocomanip.solver.ocp import Plan
from jaxlocomanip.solver.sqp import Options

UNROLLED = (1, 10, 50)
"""iterations of the solver that are differentiated in reverse mode, with everything they compute stored"""
LANES = 64
"""plans that are differentiated side by side"""
Program = Callable[..., Any]
Part = Callable[[PushProblem], Any]
BOUNDS = "force_max", "offset_limit", "slide_speed_max", "pair_bounds"
REFERENCE = "pose", "twist", "force", "offset"
GROUPS: dict[str, tuple[Part, Callable[[PushProblem, Any], PushProblem]]] = {
    "body": (lambda p: p.body, lambda p, part: _with(p, body=part)),
    "obstacles": (lambda p: p.horizon.obstacles, lambda p, part: _with(p, horizon=_with(p.horizon, obstacles=part))),
    "reference": (
        lambda p: ({name: getattr(p.horizon, name) for name in REFERENCE}, p.final_pose, p.final_twist),
        lambda p, part: _with(p, horizon=_with(p.horizon, **part[0]), final_pose=part[1], final_twist=part[2]),
    ),
    "weights": (lambda p: p.config.weights, lambda p, part: _with(p, config=_with(p.config, weights=part))),
    "barriers": (lambda p: p.barriers, lambda p, part: _with(p, barriers=part)),
    "gains": (lambda p: p.config.constraints, lambda p, part: _with(p, config=_with(p.config, constraints=part))),
    "bounds": (
        lambda p: {name: getattr(p.shapes.team, name) for name in BOUNDS},
        lambda p, part: _with(p, shapes=_with(p.shapes, team=_with(p.shapes.team, **part))),
    ),
}
"""parts of a problem by which its plan is differentiated: how to get them, and a problem with others"""
_with = dataclasses.replace


def measure(calls: int) -> dict[str, Any]:
    """Times in ms and temporary memory in kB, at the default horizon; `calls` of each short program."""
    s = instant(jax.device_put(PlannerConfig()), compiled(nmpc.tick))
    options = Options(tolerance=1e-4)
    found = jax.jit(lambda p, x, w: implicit.solve(p, x, sqp.start(w, options), options))(
        s.problem, s.x0, s.solver.plan
    )
    plan = found.plan
    by_plan = jax.tree.map(jnp.ones_like, plan)
    given = (s.problem, s.x0, plan)
    results = _timed(calls, {
        "sqp iteration": (_iteration, *given),
        "implicit jvp by x0": (_jvp, *given, s.x0),
        "implicit vjp by x0": (_vjp_state, *given, by_plan),
        **{f"implicit vjp by x0 and {name}": (_vjp_of(name), *given, by_plan) for name in GROUPS},
        "implicit vjp by x0 and the whole problem": (_vjp_all, *given, by_plan),
    })  # fmt: skip
    lanes, seeds = jax.tree.map(lambda leaf: jnp.broadcast_to(leaf, (LANES, *jnp.shape(leaf))), (given, by_plan))
    results |= _timed(max(calls // LANES, 20), {
        f"{LANES} lanes, sqp iteration": (jax.vmap(_iteration), *lanes),
        f"{LANES} lanes, implicit vjp by x0 and body": (jax.vmap(_vjp_of("body")), *lanes, seeds),
        f"{LANES} lanes, implicit vjp by x0 and the whole problem": (jax.vmap(_vjp_all), *lanes, seeds),
    })  # fmt: skip
    for count in UNROLLED:
        name = f"unrolled vjp by x0 and body, {count} iterations"
        pair = {"sqp iteration": (_iteration, *given), name: (_unrolled(count), *given, by_plan)}
        results[name] = _timed(max(calls // count, 20), pair)[name]
    return {"stages": plan.us.shape[0], "converged": int(found.status) == 0, "programs": results}


def _timed(calls: int, functions: dict[str, tuple[Any, ...]]) -> dict[str, dict[str, float | int]]:
    programs = {name: (compiled(function), *arguments) for name, (function, *arguments) in functions.items()}
    figures = in_turn(programs, calls)
    for name, (program, *arguments) in programs.items():
        memory = program.lower(*arguments).compile().memory_analysis()
        figures[name]["temporary_kb"] = memory.temp_size_in_bytes // 1000
    return figures


def _iteration(problem: PushProblem, x0: Array, plan: Plan) -> Plan:
    options = Options()
    return sqp.solve(problem, x0, sqp.start(plan, options), options).plan


def _jvp(problem: PushProblem, x0: Array, plan: Plan, by_x0: Array) -> Plan:
    return jax.jvp(lambda x: implicit.plan_of(problem, x, plan), (x0,), (by_x0,))[1]


def _vjp_state(problem: PushProblem, x0: Array, plan: Plan, by_plan: Plan) -> Any:
    return jax.vjp(lambda x: implicit.plan_of(problem, x, plan), x0)[1](by_plan)


def _vjp_of(group: str) -> Program:
    def vjp(problem: PushProblem, x0: Array, plan: Plan, by_plan: Plan) -> Any:
        return _pulled(group, lambda p, x: implicit.plan_of(p, x, plan), problem, x0, by_plan)

    return vjp


def _vjp_all(problem: PushProblem, x0: Array, plan: Plan, by_plan: Plan) -> Any:
    return _floating(jax.vjp(lambda p, x: implicit.plan_of(p, x, plan), problem, x0)[1](by_plan))


def _unrolled(count: int) -> Program:
    options = Options(iterations=count)

    def vjp(problem: PushProblem, x0: Array, plan: Plan, by_plan: Plan) -> Any:
        def solved(p: PushProblem, x: Array) -> Plan:
            return sqp.solve(p, x, sqp.start(plan, options), options).plan

        return _pulled("body", solved, problem, x0, by_plan)

    return vjp


def _pulled(
    group: str, plan_of: Callable[[PushProblem, Array], Plan], problem: PushProblem, x0: Array, by_plan: Plan
) -> Any:
    part_of, with_part = GROUPS[group]
    of = jax.vjp(lambda part, x: plan_of(with_part(problem, part), x), part_of(problem), x0)[1]
    return _floating(of(by_plan))


def _floating(slopes: Any) -> list[Array]:
    return [leaf for leaf in jax.tree.leaves(slopes) if leaf.dtype != jax.dtypes.float0]
