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
STILL = 0.02
"""m/s, a body of which no corner moves faster than this stands still"""


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
    run_over: Array
    """[] bool, collided, but only with moving obstacles that ran into bodies standing still: in each tick in which some
    overlap began or grew, the obstacle moved and no corner of that body moved faster than 2 cm/s. So the body has stood
    since before the first contact. False where robots overlapped each other, and where a body moved in any of these
    ticks, even if it moved away."""
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


def gaps(scenario: Scenario, view: View, positions: Array) -> Array:
    """[1 + N_r, N_o] m, signed distances of the object and each robot to obstacles at `positions` [N_o, 2]."""
    obstacles = scenario.obstacles
    shapes = positions[:, None, :] + obstacles.vertices

    def to_obstacles(vertices: Array) -> Array:
        each = jax.vmap(lambda s, r: polygon_distance(vertices, 0.0, s, r))(shapes, obstacles.radius)
        return jnp.where(obstacles.mask, each, CLEAR)

    body, rectangles = _bodies(scenario, view)
    return jnp.concatenate([to_obstacles(body)[None], jax.vmap(to_obstacles)(rectangles)])


def _bodies(scenario: Scenario, view: View) -> tuple[Array, Array]:
    """Corners of the object [V, 2] and of the robots [N_r, 4, 2] in the world, m."""
    team = scenario.team
    rectangles = jax.vmap(rectangle)(view.robots, team.half_length, team.half_width)
    return transform(view.pose, scenario.object.vertices), rectangles


def nearest(scenario: Scenario, view: View, apart: Array) -> Clearances:
    """Least distances, given those to the obstacles [1 + N_r, N_o]."""
    _, rectangles = _bodies(scenario, view)
    count = rectangles.shape[0]
    pairs = [(i, j) for i in range(count) for j in range(i + 1, count)]
    between = [polygon_distance(rectangles[i], 0.0, rectangles[j], 0.0) for i, j in pairs]
    return Clearances(
        jnp.min(apart[0]),
        jnp.min(apart[1:]),
        jnp.min(jnp.stack(between)) if between else jnp.full((), CLEAR, apart.dtype),
    )


def clearances(scenario: Scenario, view: View, positions: Array) -> Clearances:
    """Signed distances between true shapes, with the obstacles at `positions` [N_o, 2]."""
    return nearest(scenario, view, gaps(scenario, view, positions))


def _moved_into(scenario: Scenario, before: View, view: View, time: Array, tick: float) -> Array:
    """[1 + N_r, N_o] bool: the body moved during the tick that ended at `time`, or crept while the obstacle stood."""
    old, new = _bodies(scenario, before), _bodies(scenario, view)
    squared = [jnp.max(jnp.sum((b - a) ** 2, axis=-1), axis=-1) for a, b in zip(old, new, strict=True)]
    body = jnp.concatenate([squared[0][None], squared[1]])[:, None]
    way = scenario.obstacles.at(time) - scenario.obstacles.at(time - tick)
    obstacle = jnp.sum(way * way, axis=-1)
    # Positions far away are rounded; what moves covers a micrometre a tick and more, but where it turns.
    crept = (obstacle <= 1e-12) & (body > obstacle)
    return (body > (STILL * tick) ** 2) | crept


@pytree
class Tally:
    """Running figures of an episode."""

    least: Clearances
    apart: Array
    """[1 + N_r, N_o] m, distances of object and robots to the obstacles now"""
    to_blame: Array
    """[] bool, some overlap began or grew while the body itself moved"""
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
        apart=jnp.full((1 + none.shape[0], scenario.obstacles.mask.shape[0]), CLEAR, zero.dtype),
        to_blame=jnp.zeros((), bool),
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
    apart: Array,
    least: Clearances,
    status: Array,
    time: Array,
    tick: float,
) -> Tally:
    """Figures after one tick that ended at `time` in the state `view`, `apart` [1 + N_r, N_o] m from the obstacles."""
    distance, turn = goal_errors(scenario, view.pose)
    within = (distance <= scenario.goal.position_tolerance) & (turn <= scenario.goal.heading_tolerance)
    since = jnp.where(jnp.isnan(tally.within_since), time, tally.within_since)
    deeper = (apart < 0.0) & (apart < tally.apart)
    return Tally(
        least=jax.tree.map(jnp.minimum, tally.least, least),
        apart=apart,
        to_blame=tally.to_blame | jnp.any(deeper & _moved_into(scenario, before, view, time, tick)),
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
    collided = jnp.minimum(jnp.minimum(least.object, least.robots), least.team) < 0.0
    return Outcome(
        reached=reached,
        reach_time_s=jnp.where(reached, tally.within_since, jnp.nan),
        final_position_error_m=distance,
        final_heading_error_rad=turn,
        min_object_clearance_m=least.object,
        min_robot_clearance_m=least.robots,
        min_team_clearance_m=least.team,
        collided=collided,
        run_over=collided & ~tally.to_blame & (least.team >= 0.0),
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
