"""One tick of the hierarchical planner: (PlannerState, Measurement) -> (PlannerState, Command).

estimate -> adaptation -> progress on the path -> optimal control problem -> SQP -> safety filter. The path itself
is searched at its own slower rate by `replan`.
"""

from __future__ import annotations

import dataclasses

import jax
import jax.numpy as jnp
from jax import Array

from jaxlocomanip.numerics import pytree, safe_norm, select, wrap_angle
from jaxlocomanip.planar import dynamics
from jaxlocomanip.planner import adaptation, estimation, path, problem, reference, safety, search
from jaxlocomanip.planner.adaptation import ParameterEstimate
from jaxlocomanip.planner.config import PlannerConfig
from jaxlocomanip.planner.estimation import ObjectEstimate, ObstacleEstimate
from jaxlocomanip.planner.path import Path
from jaxlocomanip.planner.reference import Progress
from jaxlocomanip.planner.shapes import Shapes
from jaxlocomanip.scenario import Goal, ObjectModel
from jaxlocomanip.solver import sqp
from jaxlocomanip.solver.ocp import Plan
from jaxlocomanip.solver.sqp import Iterate, Options


@pytree
class Task:
    """What the planner is told once: geometry, belief and goal."""

    shapes: Shapes
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
    command: Command


def options(config: PlannerConfig) -> Options:
    """Solver settings of a planner configuration."""
    return Options(iterations=config.horizon.sqp_iterations)


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
        path=path.unsearched(measured.pose, n),
        origin=measured.pose,
        progress=reference.start(),
        solver=sqp.start(guess, options(config)),
        force=zero,
        offset=measured.offset,
        command=Command(zero, zero, measured.offset, jnp.zeros(3, first.dtype), jnp.ones((), bool)),
    )


def replan(state: PlannerState, task: Task, config: PlannerConfig) -> PlannerState:
    """Search the path anew from where the object is; a straight-line configuration keeps its line from the origin."""
    body, turn_radius = state.parameters.body, config.reference.speed / config.reference.turn_rate
    found = search.search_poses(state.object.pose, task.goal.pose, task.shapes, state.obstacles, body, config)
    line = path.straight_poses(state.origin, task.goal.pose, found.shape[0])
    planned = config.reference.plan_path > 0.5
    paced = path.pace(jnp.where(planned, found, line), task.shapes, body, turn_radius)
    renewed = reference.restart(state.progress, paced)
    return dataclasses.replace(state, path=paced, progress=select(planned, renewed, state.progress))


def tick(
    state: PlannerState, measured: Measurement, task: Task, config: PlannerConfig
) -> tuple[PlannerState, Command, Report]:
    """One tick of the planner."""
    horizon = config.horizon
    estimate, parameters, obstacles, force = observe(state, measured, task, config)
    tolerance = jnp.stack([task.goal.position_tolerance, task.goal.heading_tolerance])
    progress = reference.advance(
        state.progress, state.path, estimate.pose, task.goal.pose, tolerance, horizon.tick, config.reference
    )
    # The reference waits for the robots: a lead built up while nobody can push would be caught up with in a jerk.
    progress = select(jnp.any(measured.contact), progress, state.progress)
    times = horizon.dt * jnp.arange(horizon.steps + 1, dtype=measured.pose.dtype)
    targets = reference.targets(progress, state.path, times, config.reference)
    warm = shift(state.solver, horizon.tick / horizon.dt)
    ocp = problem.assemble(targets, warm.plan, parameters.body, task.shapes, obstacles, config)
    x0 = jnp.concatenate([estimate.pose, estimate.twist, measured.offset])
    trying = (config.reference.second_start > 0.5) & (safe_norm(estimate.twist[:2]) < SLOW)
    rival = problem.pushing_start(ocp, x0)
    # A rival that is not wanted is made worthless, so that the program is the same.
    rival = Plan(jnp.where(trying, rival.xs, jnp.nan), rival.us)
    solver = sqp.solve(ocp, x0, warm, options(config), rival)
    n = measured.offset.shape[0]
    first = solver.plan.us[0]
    limits = task.shapes.team
    awake = jnp.where(progress.resting, 0.0, 1.0)
    wanted = awake * jnp.clip(first[:n], 0.0, limits.force_max)
    slide = awake * jnp.clip(first[n:], -limits.slide_speed_max, limits.slide_speed_max)
    sent = safety.safety_filter(
        wanted, slide, estimate, measured.offset, obstacles, parameters.body, task.shapes, config
    )
    offset = jnp.clip(measured.offset + horizon.tick * sent.offset_rate, -limits.offset_limit, limits.offset_limit)
    command = Command(sent.force, sent.offset_rate, offset, solver.plan.xs[1, 3:6], progress.resting)
    new = PlannerState(
        estimate, obstacles, parameters, state.path, state.origin, progress, solver, force, measured.offset, command
    )
    return new, command, _report(ocp, solver, targets, sent, task)


def observe(
    state: PlannerState, measured: Measurement, task: Task, config: PlannerConfig
) -> tuple[ObjectEstimate, ParameterEstimate, ObstacleEstimate, Array]:
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
    return (
        estimate,
        adaptation.adapt(state.parameters, slope, horizon.tick, task.model, settings),
        obstacles,
        force,
    )


def shift(solver: Iterate, fraction: Array | float) -> Iterate:
    """The solver's plan moved forward in time by a fraction of a stage; the last stage is held."""
    plan = solver.plan
    xs = plan.xs.at[:-1].add(fraction * (plan.xs[1:] - plan.xs[:-1]))
    us = plan.us.at[:-1].add(fraction * (plan.us[1:] - plan.us[:-1]))
    return dataclasses.replace(solver, plan=Plan(xs, us))


SLOW = 0.1
"""m/s, below which the plan that pushes at once is tried beside the warm start"""

FORCE_LAG = 0.05
"""s, lag of the robots' push that the observer reckons with"""

PREDICTION_WEIGHT = 3.0
"""Innovation of a tick as a velocity error, in multiples of lambda"""


def _report(
    ocp: problem.PushProblem, solver: Iterate, targets: reference.Targets, sent: safety.Filtered, task: Task
) -> Report:
    team, shapes = task.shapes.team, task.shapes
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
    )
