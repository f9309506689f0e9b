"""One tick of the hierarchical planner: (PlannerState, Measurement) -> (PlannerState, Command).

estimate -> adaptation -> progress on the path -> optimal control problem -> SQP -> safety filter. The path itself
is searched at its own slower rate by `replan`.
"""

from __future__ import annotations

import dataclasses
from collections.abc import Callable
from typing import Any

import jax.numpy as jnp
from jax import Array

from jaxlocomanip.formation import count, team_in
from jaxlocomanip.lanes import GROUP, where_needed
from jaxlocomanip.numerics import T, pytree, safe_norm, select, wrap_angle
from jaxlocomanip.planar import dynamics
from jaxlocomanip.planner import adaptation, breakaway, estimation, path, reference, regrasp, route, safety, schedule
from jaxlocomanip.planner.adaptation import ParameterEstimate
from jaxlocomanip.planner.breakaway import Breakaway
from jaxlocomanip.planner.config import PlannerConfig
from jaxlocomanip.planner.decision import Report, at_rest, decide, options
from jaxlocomanip.planner.estimation import ObjectEstimate, ObstacleEstimate
from jaxlocomanip.planner.path import Path
from jaxlocomanip.planner.reference import Progress
from jaxlocomanip.planner.shapes import Shapes
from jaxlocomanip.planner.situation import Situation
from jaxlocomanip.scenario import Formations, Goal, ObjectModel
from jaxlocomanip.solver import sqp
from jaxlocomanip.solver.ocp import Plan
from jaxlocomanip.solver.sqp import Iterate


@pytree
class Task:
    """What the planner is told once: geometry, belief and goal."""

    shapes: Shapes
    """with the team in its first formation"""
    formations: Formations
    model: ObjectModel
    goal: Goal


@pytree
class Measurement:
    """What a world reports each tick."""

    pose: Array
    """[3] object, m and rad"""
    offset: Array
    """[N_r] m, contact offsets"""
    obstacles: Array
    """[N_o, 2] m"""
    contact: Array
    """[N_r] bool: robots that are at their face; of the others no push is believed to act"""
    formation: Array
    """[] int, that the team has, or is walking to; the offsets are those in it"""


@pytree
class Command:
    """What the planner asks of the robots until the next tick."""

    force: Array
    """[N_r] N, push along the contact normal"""
    offset_rate: Array
    """[N_r] m/s"""
    offset: Array
    """[N_r] m, contact offset at the end of the tick"""
    twist: Array
    """[3] m/s, rad/s: the object's planned velocity"""
    resting: Array
    """[] bool: the object has arrived"""
    formation: Array
    """[] int, that the team shall take"""


@pytree
class PlannerState:
    """Everything the planner remembers from tick to tick."""

    object: ObjectEstimate
    obstacles: ObstacleEstimate
    parameters: ParameterEstimate
    path: Path
    origin: Array
    """[3] pose from which a straight path starts"""
    progress: Progress
    solver: Iterate
    force: Array
    """[N_r] N, push believed to act now (the command after the robots' lag)"""
    offset: Array
    """[N_r] m, contact offsets at the last tick"""
    proven: Array
    """[] N, friction that the floor has shown"""
    breakaway: Breakaway
    formation: Array
    """[] int, of the team at the last tick"""
    berth: Array
    """[] m, room that walks around the object keep beyond the usual: grows where there was too little"""
    walks: Array
    """[] int, walks around the object so far"""
    command: Command


def start(task: Task, measured: Measurement, config: PlannerConfig) -> PlannerState:
    """State before the first tick, at rest at the first measurement."""
    n = measured.offset.shape[0]
    first = jnp.concatenate([measured.pose, jnp.zeros(3, measured.pose.dtype), measured.offset])
    steps = config.horizon.steps
    guess = Plan(jnp.tile(first, (steps + 1, 1)), jnp.zeros((steps, 2 * n), first.dtype))
    zero = jnp.zeros(n, first.dtype)
    parameters = adaptation.start(task.model, config.adaptation)
    return PlannerState(
        object=estimation.start_object(measured.pose),
        obstacles=estimation.start_obstacles(measured.obstacles, config.estimation),
        parameters=parameters,
        path=path.unsearched(measured.pose, n, path.at_goal(task.goal, measured.formation)),
        origin=measured.pose,
        progress=reference.start(),
        solver=sqp.start(guess, options(config)),
        force=zero,
        offset=measured.offset,
        proven=safety.least_friction(parameters.body, config),
        breakaway=breakaway.start(measured.pose),
        formation=measured.formation,
        berth=jnp.zeros((), first.dtype),
        walks=jnp.zeros((), jnp.int32),
        command=Command(zero, zero, measured.offset, jnp.zeros(3, first.dtype), jnp.ones((), bool), measured.formation),
    )


def replan(state: PlannerState, task: Task, config: PlannerConfig) -> PlannerState:
    """Search the path anew from where the object is; a straight-line configuration keeps its line from the origin.

    A team that has arrived keeps its path.
    """
    kept = (state.path, state.progress)
    path, progress = _if_awake(state.progress, _search, (state, task, config), kept, config, group=1)
    return dataclasses.replace(state, path=path, progress=progress)


def _if_awake(
    progress: Progress,
    function: Callable[..., T],
    arguments: tuple[Any, ...],
    otherwise: T,
    config: PlannerConfig,
    group: int = GROUP,
) -> T:
    """`function(*arguments)` for a team that has not arrived, else `otherwise`."""
    skips = config.horizon.rest_skips
    return where_needed(~progress.resting, lambda given: function(*given), arguments, otherwise, skips, group)


def _search(state: PlannerState, task: Task, config: PlannerConfig) -> tuple[Path, Progress]:
    body, turn_radius = state.parameters.body, config.reference.turn_radius
    chosen = route.plan(
        state.object.pose,
        state.offset,
        task.goal,
        state.path,
        state.progress,
        task.shapes,
        task.formations,
        state.formation,
        state.berth,
        state.walks,
        state.obstacles,
        body,
        config,
    )
    shapes, found, aim = _in_formation(task, state.formation), chosen.refined, chosen.aim
    line = path.straight_poses(state.origin, task.goal.pose, found.poses.shape[0])
    planned = config.reference.plan_path > 0.5
    paced = path.pace(jnp.where(planned, found.poses, line), shapes, body, turn_radius, found.cost, aim)
    paced = select(planned, path.with_pushes(paced, found.force, found.offset, found.room, shapes.team), paced)
    renewed = reference.restart(state.progress, paced, config.reference)
    return paced, select(planned, renewed, state.progress)


def tick(
    state: PlannerState, measured: Measurement, task: Task, config: PlannerConfig
) -> tuple[PlannerState, Command, Report]:
    """One tick of the planner."""
    horizon, changed = config.horizon, measured.formation != state.formation
    if count(task.formations) > 1:
        state = select(changed, _regrouped(state, measured, task, config), state)
    shapes = _in_formation(task, measured.formation)
    present = dataclasses.replace(task, shapes=shapes)
    estimate, parameters, obstacles, force, watched = observe(state, measured, present, config)
    aim = state.path.aim
    progress = reference.advance(
        state.progress,
        state.path,
        estimate.pose,
        estimate.twist,
        aim.goal.pose,
        jnp.stack([aim.goal.position_tolerance, aim.goal.heading_tolerance]),
        horizon.tick,
        config.reference,
    )
    # The reference waits for the robots: a lead built up while nobody can push would be caught up with in a jerk.
    progress = select(jnp.any(measured.contact), progress, state.progress)
    warm = shift(state.solver, horizon.tick / horizon.dt)
    body = parameters.body
    proven = safety.prove_friction(state.proven, estimate, force, measured.offset, body, shapes, config)
    situation = Situation(estimate, body, obstacles, measured.offset, force, proven, watched.waiting, progress.held)
    progress = _scheduled(progress, state.path, situation, shapes, config)
    situation = dataclasses.replace(situation, held=progress.held)
    given = (situation, state.path, progress, warm, shapes, config)
    decided = _if_awake(progress, decide, given, at_rest(situation, warm), config)
    limit = shapes.team.offset_limit
    sent = decided.sent
    offset = jnp.clip(measured.offset + horizon.tick * sent.offset_rate, -limit, limit)
    twist = decided.solver.plan.xs[1, 3:6]
    command = Command(sent.force, sent.offset_rate, offset, twist, progress.resting, measured.formation)
    new = PlannerState(
        estimate,
        obstacles,
        parameters,
        state.path,
        state.origin,
        progress,
        decided.solver,
        force,
        measured.offset,
        proven,
        watched,
        measured.formation,
        state.berth,
        state.walks,
        command,
    )
    if count(task.formations) > 1:
        new = regrouping(new, measured, task, config)
    return new, new.command, decided.report


def _scheduled(progress: Progress, path: Path, situation: Situation, shapes: Shapes, config: PlannerConfig) -> Progress:
    """The progress, held where the team has to wait for an obstacle to pass."""
    moving = jnp.any(shapes.obstacle_dynamic & shapes.obstacle_mask)
    given = (path, progress, situation, shapes, config)
    held = where_needed(
        moving & ~progress.resting,
        lambda given: schedule.has_to_wait(*given),
        given,
        jnp.zeros((), bool),
        config.horizon.rest_skips,
    )
    return dataclasses.replace(progress, held=held)


def _in_formation(task: Task, formation: Array) -> Shapes:
    """The geometry with the team in a formation [] int."""
    return dataclasses.replace(task.shapes, team=team_in(task.shapes.team, task.formations, formation))


def _regrouped(state: PlannerState, measured: Measurement, task: Task, config: PlannerConfig) -> PlannerState:
    """The state of a team that has begun to walk to another formation: no path yet, nobody pushes."""
    fresh = start(task, measured, config)
    here = dataclasses.replace(fresh.path, poses=jnp.broadcast_to(state.object.pose, fresh.path.poses.shape))
    plan = Plan(
        jnp.broadcast_to(
            jnp.concatenate([state.object.pose, jnp.zeros(3, here.poses.dtype), measured.offset]),
            state.solver.plan.xs.shape,
        ),
        jnp.zeros_like(state.solver.plan.us),
    )
    return dataclasses.replace(
        state,
        path=here,
        progress=fresh.progress,
        solver=sqp.start(plan, options(config)),
        force=fresh.force,
        offset=measured.offset,
        formation=measured.formation,
        berth=fresh.berth,
        walks=state.walks + 1,
        command=dataclasses.replace(state.command, force=fresh.force, formation=measured.formation),
    )


def regrouping(state: PlannerState, measured: Measurement, task: Task, config: PlannerConfig) -> PlannerState:
    """The state in which a team that has come to rest at such a place is asked to walk to other faces.

    Where it turns out to have too little room, it plans another way, for which it wants more.
    """
    aim, rate, now = state.path.aim, state.object.twist, measured.formation
    still = (safe_norm(rate[:2]) < reference.STILL[0]) & (jnp.abs(rate[2]) < reference.STILL[1])
    there = state.progress.resting & (aim.formation != now) & jnp.all(measured.contact) & still
    given = (state.object.pose, measured.offset, now, aim.formation, task, state.obstacles, config)

    def room(given: tuple[Any, ...]) -> Array:
        pose, offset, now, wanted, task, obstacles, config = given
        return regrasp.room_to_walk(pose, offset, now, wanted, task.shapes, task.formations, obstacles, config)

    free = where_needed(there, room, given, jnp.full((), -1.0, aim.beyond.dtype), config.horizon.rest_skips)
    goes, refused = there & (free > 0.0), there & (free <= 0.0)
    formation = jnp.where(goes, aim.formation, now)
    lost = dataclasses.replace(state.path, cost=jnp.full_like(state.path.cost, path.UNPLANNED))
    return dataclasses.replace(
        state,
        path=select(refused, lost, state.path),
        progress=dataclasses.replace(state.progress, resting=state.progress.resting & ~refused),
        berth=state.berth + jnp.where(refused, SHY, 0.0),
        command=dataclasses.replace(state.command, formation=formation),
    )


def observe(
    state: PlannerState, measured: Measurement, task: Task, config: PlannerConfig
) -> tuple[ObjectEstimate, ParameterEstimate, ObstacleEstimate, Array, Breakaway]:
    """State estimation and adaptation over the tick that just ended; also the push [N_r] believed to act now."""
    horizon, settings = config.horizon, config.adaptation
    before, psi = state.object, state.parameters.filtered
    asked = jnp.where(measured.contact, state.command.force, 0.0)
    force = state.force + (asked - state.force) * horizon.tick / (horizon.tick + FORCE_LAG)
    offset = 0.5 * (state.offset + measured.offset)
    team = task.shapes.team
    wrench_B = dynamics.body_wrench(team.contact_points(offset), team.normal, force)
    pose, twist, slope_of = adaptation.predict(
        psi, before.pose, before.twist, wrench_B, horizon.tick, horizon.smoothing
    )
    estimate = estimation.correct_object(pose, twist, measured.pose, horizon.tick, config.estimation)
    obstacles = estimation.track_obstacles(
        state.obstacles, measured.obstacles, task.shapes.obstacle_dynamic, horizon.tick, config.estimation
    )
    error = settings.rate * estimate.innovation * PREDICTION_WEIGHT
    by_prediction = slope_of(error)
    now = reference.targets(state.progress, state.path, jnp.zeros(1, error.dtype), config.reference)
    aim = estimate.pose - jnp.concatenate(
        [estimate.pose[:2] - now.pose[0, :2], wrap_angle(estimate.pose[2:] - now.pose[0, 2:])]
    )
    by_reference = adaptation.reference_slope(
        estimate.pose, estimate.twist, aim, now.twist[0], psi, settings.rate, horizon.smoothing
    )
    slope = jnp.where(settings.on_prediction > 0.5, by_prediction, by_reference)
    slope = jnp.where(state.progress.resting, 0.0, slope)
    parameters = adaptation.adapt(state.parameters, slope, horizon.tick, task.model, settings)
    push = breakaway.limit_push(wrench_B, state.parameters.body.com, task.shapes)
    watched, slips = breakaway.watch(state.breakaway, measured.pose, push, task.shapes, horizon.tick)
    estimate, parameters = breakaway.corrected(estimate, parameters, watched, slips, config)
    return estimate, parameters, obstacles, force, watched


def shift(solver: Iterate, fraction: Array | float) -> Iterate:
    """The solver's plan moved forward in time by a fraction of a stage; the last stage is held."""
    plan = solver.plan
    xs = plan.xs.at[:-1].add(fraction * (plan.xs[1:] - plan.xs[:-1]))
    us = plan.us.at[:-1].add(fraction * (plan.us[1:] - plan.us[:-1]))
    return dataclasses.replace(solver, plan=Plan(xs, us))


SHY = 0.05
"""m, more room that is wanted for walks around the object after there was too little for one"""
FORCE_LAG = 0.05
"""s, lag of the robots' push that the observer reckons with"""

PREDICTION_WEIGHT = 3.0
"""Innovation of a tick as a velocity error, in multiples of lambda"""
