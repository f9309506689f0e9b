"""What came of a scenario: reached, clearances between true shapes, effort, solver statistics.

Accumulated tick by tick inside the closed loop, so that thousands of episodes need no trajectories.
"""

from __future__ import annotations

import jax
import jax.numpy as jnp
from jax import Array

from jaxlocomanip.numerics import pytree, wrap_angle
from jaxlocomanip.planar.geometry import polygon_distance, rectangle, transform
from jaxlocomanip.scenario import Scenario
from jaxlocomanip.solver.sqp import Status
from jaxlocomanip.worlds.interface import View

HOLD = 2.0
"""s, how long the object must have been within the tolerances at the end to count as reached"""
CLEAR = 1e3
"""m, clearance reported where there is nothing to hit"""


@pytree
class Clearances:
    """Least signed distances between true shapes at one instant, m."""

    object: Array
    """[] object footprint to obstacles"""
    robots: Array
    """[] robot bodies to obstacles"""
    team: Array
    """[] robot bodies to each other"""


@pytree
class Outcome:
    """Results of one episode."""

    reached: Array
    """[] bool, within both tolerances continuously for the last 2 s, and nobody fell"""
    reach_time_s: Array
    """[] s, since when; NaN if not reached"""
    final_position_error_m: Array
    final_heading_error_rad: Array
    min_object_clearance_m: Array
    min_robot_clearance_m: Array
    min_team_clearance_m: Array
    collided: Array
    """[] bool, some clearance was below zero"""
    fell: Array
    """[] bool, some robot fell; the episode ends there"""
    contact_lost: Array
    """[] fraction of the time since first contact during which a robot was not at its face"""
    max_force_n: Array
    """[] N, largest contact force that acted"""
    path_length_m: Array
    """[] m, way of the object's body point"""
    push_impulse_ns: Array
    """[] N s, sum of all pushes over time"""
    estimates: Array
    """[6] Psi at the end"""
    ticks: Array
    """[] int, ticks simulated"""
    nonfinite: Array
    """[] int, ticks at which the solver or the world met non-finite numbers"""
    converged: Array
    """[] int, ticks whose last step was below the tolerance or reduced the merit"""


def clearances(scenario: Scenario, view: View, positions: Array) -> Clearances:
    """Signed distances between true shapes, with the obstacles at `positions` [N_o, 2]."""
    team, obstacles = scenario.team, scenario.obstacles
    body = transform(view.pose, scenario.object.vertices)
    rectangles = jax.vmap(rectangle)(view.robots, team.half_length, team.half_width)
    shapes = positions[:, None, :] + obstacles.vertices

    def to_obstacles(vertices: Array) -> Array:
        each = jax.vmap(lambda s, r: polygon_distance(vertices, 0.0, s, r))(shapes, obstacles.radius)
        return jnp.min(jnp.where(obstacles.mask, each, CLEAR))

    count = rectangles.shape[0]
    pairs = [(i, j) for i in range(count) for j in range(i + 1, count)]
    between = [polygon_distance(rectangles[i], 0.0, rectangles[j], 0.0) for i, j in pairs]
    return Clearances(
        to_obstacles(body),
        jnp.min(jax.vmap(to_obstacles)(rectangles)),
        jnp.min(jnp.stack(between)) if between else jnp.full((), CLEAR, body.dtype),
    )


@pytree
class Tally:
    """Running figures of an episode."""

    least: Clearances
    within_since: Array
    """[] s, since when the object is within the tolerances (NaN: it is not)"""
    max_force: Array
    way: Array
    impulse: Array
    ticks: Array
    nonfinite: Array
    converged: Array
    fell: Array
    touched: Array
    """[N_r] s, since first contact"""
    lost: Array
    """[N_r] s, of it without contact"""


def start_tally(scenario: Scenario) -> Tally:
    """Figures before the first tick."""
    zero = jnp.zeros((), scenario.start.dtype)
    count = jnp.zeros((), jnp.int32)
    far = zero + CLEAR
    none = jnp.zeros_like(scenario.team.offset)
    return Tally(
        least=Clearances(far, far, far),
        within_since=zero + jnp.nan,
        max_force=zero,
        way=zero,
        impulse=zero,
        ticks=count,
        nonfinite=count,
        converged=count,
        fell=jnp.zeros((), bool),
        touched=none,
        lost=none,
    )


def goal_errors(scenario: Scenario, pose: Array) -> tuple[Array, Array]:
    """Distance, m, and absolute heading error, rad, to the goal."""
    off = pose - scenario.goal.pose
    return jnp.sqrt(jnp.sum(off[:2] ** 2)), jnp.abs(wrap_angle(off[2]))


def count(
    tally: Tally,
    scenario: Scenario,
    before: View,
    view: View,
    least: Clearances,
    status: Array,
    time: Array,
    tick: float,
) -> Tally:
    """Figures after one tick that ended at `time` in the state `view`."""
    distance, turn = goal_errors(scenario, view.pose)
    within = (distance <= scenario.goal.position_tolerance) & (turn <= scenario.goal.heading_tolerance)
    since = jnp.where(jnp.isnan(tally.within_since), time, tally.within_since)
    return Tally(
        least=jax.tree.map(jnp.minimum, tally.least, least),
        within_since=jnp.where(within, since, jnp.nan),
        max_force=jnp.maximum(tally.max_force, jnp.max(view.force)),
        way=tally.way + jnp.sqrt(jnp.sum((view.pose[:2] - before.pose[:2]) ** 2)),
        impulse=tally.impulse + tick * jnp.sum(view.force),
        ticks=tally.ticks + 1,
        nonfinite=tally.nonfinite + (status == Status.NONFINITE),
        converged=tally.converged + (status <= Status.ITERATION_LIMIT),
        fell=tally.fell | jnp.any(view.fallen),
        touched=tally.touched + tick * (view.contact | (tally.touched > 0.0)),
        lost=tally.lost + tick * (~view.contact & (tally.touched > 0.0)),
    )


def summarise(tally: Tally, scenario: Scenario, view: View, psi: Array) -> Outcome:
    """The outcome of an episode that ended in the state `view` with the estimates `psi` [6]."""
    distance, turn = goal_errors(scenario, view.pose)
    reached = (scenario.duration - tally.within_since >= HOLD - 1e-3) & ~tally.fell
    least = tally.least
    return Outcome(
        reached=reached,
        reach_time_s=jnp.where(reached, tally.within_since, jnp.nan),
        final_position_error_m=distance,
        final_heading_error_rad=turn,
        min_object_clearance_m=least.object,
        min_robot_clearance_m=least.robots,
        min_team_clearance_m=least.team,
        collided=jnp.minimum(jnp.minimum(least.object, least.robots), least.team) < 0.0,
        fell=tally.fell,
        contact_lost=jnp.max(tally.lost / jnp.maximum(tally.touched, 1e-6)),
        max_force_n=tally.max_force,
        path_length_m=tally.way,
        push_impulse_ns=tally.impulse,
        estimates=psi,
        ticks=tally.ticks,
        nonfinite=tally.nonfinite,
        converged=tally.converged,
    )
