"""What the planner decides in one tick: reference, optimal control problem, solver, safety filter.

Lanes whose team has arrived have nothing to decide and skip all of it.
"""

from __future__ import annotations

import jax
import jax.numpy as jnp
from jax import Array

from jaxlocomanip.lanes import where_needed
from jaxlocomanip.numerics import pytree, safe_norm
from jaxlocomanip.planner import problem, reference, safety
from jaxlocomanip.planner.breakaway import limit_push
from jaxlocomanip.planner.config import PlannerConfig
from jaxlocomanip.planner.path import Path
from jaxlocomanip.planner.reference import Progress
from jaxlocomanip.planner.room import FAR
from jaxlocomanip.planner.shapes import Shapes
from jaxlocomanip.planner.situation import Situation
from jaxlocomanip.solver import sqp
from jaxlocomanip.solver.ocp import Plan
from jaxlocomanip.solver.sqp import Iterate, Options

SLOW = 0.1
"""m/s, below which the plan that pushes at once is tried beside the warm start"""

SURGE = 2.0, 0.05
"""N and share, by which a push may exceed what acts before the object breaks away: 30 N/s with the robots' lag"""
AMPLE, GENTLEST = 0.15, 0.2
"""m, room from which on it may be as much, and the least share of it: an object of which the friction was overestimated
moves by 12 cm before it has been seen to, and braked, where pushes rise that fast, and by 4 to 6 at the least share.
Up to the friction that the floor has shown to have nothing moves."""


@pytree
class Report:
    """What is worth recording of a tick."""

    target: Array
    """[3] reference pose now"""
    object_cbf: Array
    """[] least object barrier condition at the plan's first stage, unscaled"""
    robot_cbf: Array
    """[] least robot barrier condition at the plan's first stage, unscaled"""
    clf: Array
    """[] Lyapunov condition at the plan's first stage"""
    filter_choice: Array
    """[] int, 0: the planner's own input was sent"""
    filter_room: Array
    """[] m"""
    waits: Array
    """[] bool, for an obstacle to pass"""


@pytree
class Decision:
    """What came of it."""

    solver: Iterate
    sent: safety.Filtered
    report: Report


def options(config: PlannerConfig) -> Options:
    """Solver settings of a planner configuration."""
    return Options(iterations=config.horizon.sqp_iterations)


def decide(
    situation: Situation, path: Path, progress: Progress, warm: Iterate, shapes: Shapes, config: PlannerConfig
) -> Decision:
    """Reference, optimal control problem, solver and filter."""
    horizon, estimate, offset = config.horizon, situation.estimate, situation.offset
    times = horizon.dt * jnp.arange(horizon.steps + 1, dtype=estimate.pose.dtype)
    targets = reference.targets(progress, path, times, config.reference)
    ocp = problem.assemble(targets, warm.plan, situation.body, shapes, situation.obstacles, config)
    x0 = jnp.concatenate([estimate.pose, estimate.twist, offset])
    trying = (config.reference.second_start > 0.5) & (safe_norm(estimate.twist[:2]) < SLOW)
    # A rival that is not wanted is worthless, so that the program is the same.
    worthless = jax.tree.map(lambda leaf: jnp.full_like(leaf, jnp.nan), warm.plan)
    rival = where_needed(trying, lambda at: problem.pushing_start(*at), (ocp, x0), worthless, horizon.rest_skips)
    solver = sqp.solve(ocp, x0, warm, options(config), rival)
    n, limits = offset.shape[0], shapes.team
    first = solver.plan.us[0]
    push = limit_push(limits.wrench(offset, situation.force), situation.body.com, shapes)
    gentle = jnp.clip((jnp.maximum(situation.room, 0.0) / AMPLE) ** 2, GENTLEST, 1.0)
    gentle = jnp.where(push < situation.proven, 1.0, gentle)
    surge, share = (gentle * usual for usual in SURGE)
    # What will be left of a push once the object breaks away is not known before: it must not be much.
    gently = jnp.where(situation.waiting, situation.force * (1.0 + share) + surge, jnp.inf)
    most = jnp.minimum(limits.force_max, jnp.where(config.safety.enabled > 0.5, gently, jnp.inf))
    wanted = jnp.clip(first[:n], 0.0, most)
    slide = jnp.clip(first[n:], -limits.slide_speed_max, limits.slide_speed_max)
    sent = safety.safety_filter(wanted, slide, most, situation, shapes, config)
    return Decision(solver, sent, _report(ocp, solver, targets, sent, shapes, situation.held))


def at_rest(situation: Situation, warm: Iterate) -> Decision:
    """A team that has arrived asks for nothing, and its plan is to stay."""
    here = jnp.concatenate([situation.estimate.pose, jnp.zeros_like(situation.estimate.twist), situation.offset])
    stay = Plan(jnp.broadcast_to(here, warm.plan.xs.shape), jnp.zeros_like(warm.plan.us))
    zero = jnp.zeros_like(warm.cost)
    none, free = jnp.zeros_like(situation.offset), zero + FAR
    converged = jnp.zeros_like(warm.status)
    solver = Iterate(stay, warm.damping, zero, zero, zero, zero, converged)
    sent = safety.Filtered(none, none, jnp.zeros((), jnp.int32), free)
    report = Report(situation.estimate.pose, free, free, zero, sent.choice, free, situation.held)
    return Decision(solver, sent, report)


def _report(
    ocp: problem.PushProblem,
    solver: Iterate,
    targets: reference.Targets,
    sent: safety.Filtered,
    shapes: Shapes,
    waits: Array,
) -> Report:
    team = shapes.team
    clf = 6 * team.offset.shape[0] + team.pair_bounds.shape[0]
    objects = shapes.object_radii.shape[0] * shapes.obstacle_mask.shape[0]
    first = ocp.stage(solver.plan.xs[0], solver.plan.us[0], jax.tree.map(lambda leaf: leaf[0], ocp.stages))
    h = jnp.where(ocp.barriers.weight > 0.0, first.inequality, jnp.inf)
    scale = ocp.config.constraints.cbf_scale
    return Report(
        target=targets.pose[0],
        object_cbf=jnp.min(h[clf + 1 : clf + 1 + objects]) / scale,
        robot_cbf=jnp.min(h[clf + 1 + objects :]) / scale,
        clf=first.inequality[clf],
        filter_choice=sent.choice,
        filter_room=sent.room,
        waits=waits,
    )
