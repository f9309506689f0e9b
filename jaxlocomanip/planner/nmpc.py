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

from jaxlocomanip.formation import count
from jaxlocomanip.lanes import where_needed
from jaxlocomanip.numerics import T, select, wrap_angle
from jaxlocomanip.planar import dynamics
from jaxlocomanip.planner import adaptation, breakaway, estimation, keeping, path, reference, route, safety, schedule
from jaxlocomanip.planner.adaptation import ParameterEstimate
from jaxlocomanip.planner.breakaway import Breakaway
from jaxlocomanip.planner.config import Horizon, PlannerConfig
from jaxlocomanip.planner.decision import AMPLE, Report, at_rest, decide
from jaxlocomanip.planner.estimation import ObjectEstimate, ObstacleEstimate
from jaxlocomanip.planner.path import Path
from jaxlocomanip.planner.reference import Progress
from jaxlocomanip.planner.regrouping import regrouped, regrouping
from jaxlocomanip.planner.room import bodies_of, standing_room
from jaxlocomanip.planner.shapes import Shapes
from jaxlocomanip.planner.situation import Situation
from jaxlocomanip.planner.state import Command, Measurement, PlannerState, Task
from jaxlocomanip.solver.ocp import Plan
from jaxlocomanip.solver.sqp import Iterate


def replan(state: PlannerState, task: Task, config: PlannerConfig) -> PlannerState:
    """Search the path anew from where the object is; a straight-line configuration keeps its line from the origin.

    A team that has arrived keeps its path.
    """
    kept = (state.path, state.progress)
    path, progress = select(state.progress.resting, kept, _search(state, task, config))
    return dataclasses.replace(state, path=path, progress=progress)


def _if_awake(
    progress: Progress,
    function: Callable[..., T],
    arguments: tuple[Any, ...],
    otherwise: T,
    config: PlannerConfig,
) -> T:
    """`function(*arguments)` for a team that has not arrived, else `otherwise`."""
    skips = config.horizon.rest_skips
    return where_needed(~progress.resting, lambda given: function(*given), arguments, otherwise, skips)


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
    shapes, found, aim = task.in_formation(state.formation).shapes, chosen.refined, chosen.aim
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
        state = select(changed, regrouped(state, measured, task, config), state)
    present = task.in_formation(measured.formation)
    shapes = present.shapes
    estimate, parameters, obstacles, force, watched = observe(state, measured, present, config)
    progress = _advanced(state, estimate, measured, config)
    warm = shift(state.solver, horizon.tick / horizon.dt)
    gaps = keeping.gaps_of(estimate, measured.offset, obstacles, shapes, config)
    kept = select(changed, keeping.regrouped(state.kept, gaps), keeping.watch(state.kept, gaps, horizon.tick))
    keep = keeping.room_to_keep(kept, gaps, shapes.obstacle_dynamic, config.safety.margin)
    body, offset = parameters.body, measured.offset
    room = standing_room(gaps, bodies_of(shapes, config))
    watched = dataclasses.replace(watched, tight=room < AMPLE)
    proven = safety.prove_friction(state.proven, estimate, force, offset, body, shapes, config)
    situation = Situation(
        estimate=estimate,
        body=body,
        obstacles=obstacles,
        offset=offset,
        room=room,
        kept=keep,
        force=force,
        proven=proven,
        waiting=watched.waiting,
        stirring=breakaway.speed(watched.mean, shapes),
        held=progress.held,
    )
    progress = _scheduled(progress, state.path, situation, shapes, config)
    situation = dataclasses.replace(situation, held=progress.held)
    given = (situation, state.path, progress, warm, shapes, config)
    decided = _if_awake(progress, decide, given, at_rest(situation, warm), config)
    command = _command(decided.sent, situation, progress, measured.formation, shapes, horizon)
    new = dataclasses.replace(
        state,
        object=estimate,
        obstacles=obstacles,
        parameters=parameters,
        progress=progress,
        solver=decided.solver,
        force=force,
        offset=measured.offset,
        proven=proven,
        breakaway=watched,
        kept=kept,
        formation=measured.formation,
        command=command,
    )
    if count(task.formations) > 1:
        new = regrouping(new, measured, task, config)
    return new, new.command, decided.report


def _advanced(state: PlannerState, estimate: ObjectEstimate, measured: Measurement, config: PlannerConfig) -> Progress:
    """The progress after this tick; a team out of touch does not get on."""
    aim = state.path.aim
    progress = reference.advance(
        state.progress,
        state.path,
        estimate.pose,
        estimate.twist,
        aim.goal.pose,
        jnp.stack([aim.goal.position_tolerance, aim.goal.heading_tolerance]),
        config.horizon.tick,
        config.reference,
    )
    return select(jnp.any(measured.contact), progress, reference.apart(state.progress))


def _command(
    sent: safety.Filtered, situation: Situation, progress: Progress, formation: Array, shapes: Shapes, horizon: Horizon
) -> Command:
    """What the robots are told, once the filter has had its say."""
    team, estimate, offset = shapes.team, situation.estimate, situation.offset
    wanted = jnp.clip(offset + horizon.tick * sent.offset_rate, -team.offset_limit, team.offset_limit)
    # Not the plan's, whose pushes may not be those that are sent: robots that walk on with it lean on the object.
    wrench_B = team.wrench(offset, sent.force)
    _, twist = dynamics.step(situation.body, estimate.pose, estimate.twist, wrench_B, horizon.dt, horizon.smoothing)
    return Command(sent.force, sent.offset_rate, wanted, twist, progress.resting, formation)


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


def observe(
    state: PlannerState, measured: Measurement, task: Task, config: PlannerConfig
) -> tuple[ObjectEstimate, ParameterEstimate, ObstacleEstimate, Array, Breakaway]:
    """State estimation and adaptation over the tick that just ended; also the push [N_r] believed to act now."""
    horizon, settings = config.horizon, config.adaptation
    before, psi = state.object, state.parameters.filtered
    asked = jnp.where(measured.contact, state.command.force, 0.0)
    force = state.force + (asked - state.force) * horizon.tick / (horizon.tick + FORCE_LAG)
    offset = 0.5 * (state.offset + measured.offset)
    wrench_B = task.shapes.team.wrench(offset, force)
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
    # An object that nobody touches shows nothing, but for noise, which would be taken for friction.
    slope = jnp.where(state.progress.resting | ~jnp.any(measured.contact), 0.0, slope)
    push = breakaway.limit_push(wrench_B, state.parameters.body.com, task.shapes)
    held = jnp.where(breakaway.speed(state.breakaway.mean, task.shapes) < breakaway.STILL, push, jnp.inf)
    parameters = adaptation.adapt(state.parameters, slope, held, horizon.tick, task.model, settings)
    watched, slips = breakaway.watch(state.breakaway, measured.pose, push, task.shapes, horizon.tick)
    estimate, parameters = breakaway.corrected(estimate, parameters, watched, slips, config)
    return estimate, parameters, obstacles, force, watched


def shift(solver: Iterate, fraction: Array | float) -> Iterate:
    """The solver's plan moved forward in time by a fraction of a stage; the last stage is held."""
    plan = solver.plan
    xs = plan.xs.at[:-1].add(fraction * (plan.xs[1:] - plan.xs[:-1]))
    us = plan.us.at[:-1].add(fraction * (plan.us[1:] - plan.us[:-1]))
    return dataclasses.replace(solver, plan=Plan(xs, us))


FORCE_LAG = 0.05
"""s, lag of the robots' push that the observer reckons with"""

PREDICTION_WEIGHT = 3.0
"""Innovation of a tick as a velocity error, in multiples of lambda"""
