"""Gradients of whole episodes: soft outcomes of the closed loop of planner and planar world.

    def risk(truth):                                           # any part of a scenario or of a configuration
        return soft_outcome(dataclasses.replace(scenario, truth=truth), config, ticks=500).clearance_m

    jax.jit(jax.grad(risk))(scenario.truth)

The derivative is that of the closed loop as it runs, one iteration of the solver a tick, in reverse or in forward
mode. Reverse mode keeps the loop's state of every tick of one block and of the start of every block, and computes the
rest again; so memory hardly grows with the number of ticks. Held fixed are choices among alternatives: the path
(found anew once a `reference.replan`, with all that is read from it), the reference's nearest point on it, step
lengths and second starts, nearest features and the safety filter's candidate. Gradients by the goal and the start
therefore lack what they change through the path.

The world's friction is smoothed as the planner's is, because exact sticking passes no gradient on.

Pushing is unstable, and iterations that do not settle are more so: each tick's plan begins with the last one, and where
one iteration a tick does not converge (the paper's settings) the derivative grows from tick to tick beyond all numbers.
Two things keep it finite, of which it is then no longer the exact derivative but a direction. With `plans = 0` the plan
that an iteration begins with counts as given: what is left is the derivative of one iteration, which for a plan that
has converged is that of the plan. With a finite `memory` the rest fades on its way back in time as well, as in
truncated backpropagation; but for what is believed of the object, which changes slowly and does not blow up.
"""

from __future__ import annotations

import dataclasses
import math

import jax
import jax.numpy as jnp
from jax import Array

from jaxlocomanip import checked, checked_arrays
from jaxlocomanip import loop as closing
from jaxlocomanip.fading import Kept, fade, shares_kept
from jaxlocomanip.loop import Loop
from jaxlocomanip.numerics import Floats, pytree, safe_norm, select, wrap_angle
from jaxlocomanip.outcome import gaps, nearest
from jaxlocomanip.planner.config import PlannerConfig
from jaxlocomanip.scenario import Scenario
from jaxlocomanip.worlds.interface import View
from jaxlocomanip.worlds.planar import PlanarState, PlanarWorld

WORLD = PlanarWorld(smoothing=0.02)
"""the planar world with friction that lets gradients pass where the object sticks"""
SHARPNESS = 0.02
"""m, width of the soft minimum of clearances"""
ARRIVAL_WIDTH = 0.2
"""fraction of the goal tolerances over which the soft time ends"""
FAR = 10.0
"""m, clearance reported where there is nothing to hit"""


@pytree
class SoftOutcome:
    """Differentiable results of one episode."""

    path_error_m2: Array
    """[] mean squared distance of the object to its reference on the path"""
    effort_n2s: Array
    """[] integral of the squared pushes"""
    clearance_m: Array
    """[] soft minimum, over bodies, obstacles and ticks, of the distances between true shapes: exact where it is held
    throughout, and larger, by up to `SHARPNESS` ln(ticks), where they are close for a moment"""
    team_clearance_m: Array
    """[] the same over pairs of robots"""
    time_s: Array
    """[] time outside the goal tolerances, which fade smoothly"""
    off_goal: Array
    """[] mean over the episode of how far from the goal the object is (`off_goal`)"""
    goal_error_m2: Array
    """[] squared distance to the goal at the end"""
    heading_error_rad2: Array
    """[] squared heading error at the end"""
    alive: Array
    """[] bool: all numbers were finite to the end; else the others are those of the ticks before"""


@pytree
class Sums:
    """Running sums of the soft outcome."""

    path_error: Array
    effort: Array
    nearness: Array
    """[2] sums of exp(-distance / SHARPNESS) over obstacles and over robots, as multiples of the largest one so far"""
    largest: Array
    """[2] the largest exponents"""
    time: Array
    off_goal: Array


@pytree
class Episode:
    """What is carried from tick to tick."""

    loop: Loop
    world: PlanarState
    view: View
    sums: Sums


def soft_outcome(
    scenario: Scenario,
    config: PlannerConfig,
    ticks: int,
    world: PlanarWorld = WORLD,
    key: Array | None = None,
    memory: Floats = math.inf,
    plans: Floats = 1.0,
) -> SoftOutcome:
    """Run one scenario in closed loop with the planar world; a pure function, to be differentiated, compiled, batched.

    Args:
      scenario: without batch axis (`jax.vmap` for batches); its duration ends the episode if it is shorter.
      config: planner settings; lanes at rest plan as well (`horizon.rest_skips` is ignored).
      ticks: planner ticks (static).
      world: the planar world and its smoothing.
      key: of measurement noise; seed 0 by default.
      memory: s, time constant with which derivatives fade back in time; by default they do not.
      plans: share, each tick, of the derivatives by the plan that an iteration begins with which is kept.

    Returns:
      The soft outcome.

    Raises:
      InputError: a batch, or a bad number.
    """
    check_episode(scenario, ticks, memory)
    checked_arrays.scalar("plans", plans, 0.0, 1.0)
    config, noise = planning(config), jax.random.key(0) if key is None else key
    kept = shares_kept(config, memory, plans)
    length = min(closing.ticks_per_search(config), ticks)

    def tick(carry: Episode, _: None) -> tuple[Episode, None]:
        return advance(faded(carry, kept), scenario, config, world, noise, ticks), None

    def block(carry: Episode, _: None) -> tuple[Episode, None]:
        return jax.lax.scan(jax.checkpoint(tick), searched(carry, scenario, config), None, length=length)

    start = begin(scenario, config, world, noise)
    end, _ = jax.lax.scan(jax.checkpoint(block), start, None, length=-(-ticks // length))
    return _summary(end, scenario)


def check_episode(scenario: Scenario, ticks: int, memory: Floats) -> None:
    """What an episode is run with, as far as it is known before it is compiled."""
    checked_arrays.single("scenario", scenario)
    checked.count("ticks", ticks)
    checked_arrays.scalar("memory", memory, 0.0, strictly=True, endless=True)


def planning(config: PlannerConfig) -> PlannerConfig:
    """Settings with which lanes at rest plan as well."""
    return dataclasses.replace(config, horizon=dataclasses.replace(config.horizon, rest_skips=False))


def begin(scenario: Scenario, config: PlannerConfig, world: PlanarWorld, key: Array) -> Episode:
    """An episode before its first tick."""
    state = world.start(scenario)
    view = world.view(state, scenario)
    return Episode(closing.begin(scenario, config, key, view), state, view, nothing(scenario))


def nothing(scenario: Scenario) -> Sums:
    """Sums over no ticks."""
    zero, none = jnp.zeros((), scenario.start.dtype), jnp.zeros(2, scenario.start.dtype)
    return Sums(zero, zero, none, none - FAR / SHARPNESS, zero, zero)


def searched(carry: Episode, scenario: Scenario, config: PlannerConfig) -> Episode:
    """The episode with its path searched anew, and held fixed."""
    loop = closing.replan(carry.loop, scenario, config)
    # Points of a path may coincide, where its length has no derivative.
    planner = dataclasses.replace(loop.planner, path=jax.lax.stop_gradient(loop.planner.path))
    return dataclasses.replace(carry, loop=dataclasses.replace(loop, planner=planner))


def advance(
    carry: Episode, scenario: Scenario, config: PlannerConfig, world: PlanarWorld, key: Array, ticks: int
) -> Episode:
    """One tick of the episode, whose derivative is finite."""
    loop, view, period = carry.loop, carry.view, config.horizon.tick
    decision = closing.decide(loop, view, scenario, config, key, record=True)
    new = world.step(carry.world, scenario, decision.push, loop.tick * period, period)
    after = world.view(new, scenario)
    settled, moves = closing.settle(loop, decision, view, after, scenario, config)
    assert decision.row is not None
    sums = _add(carry.sums, after, decision.row.report.target, scenario, (loop.tick + 1) * period, period)
    counts = loop.tick < ticks
    moved = Episode(_held(settled), *select(moves, (new, after, sums), (carry.world, view, carry.sums)))
    return select(counts, moved, carry)


def faded(carry: Episode, kept: Kept) -> Episode:
    """The state of the loop and of the world with derivatives that fade; sums, and what is believed, keep theirs."""
    loop, world, view = fade((carry.loop, carry.world, carry.view), kept.motion)
    solver = fade(carry.loop.planner.solver, kept.plan)
    planner = dataclasses.replace(loop.planner, solver=solver, parameters=carry.loop.planner.parameters)
    return Episode(dataclasses.replace(loop, planner=planner), world, view, carry.sums)


def _held(loop: Loop) -> Loop:
    """The loop with all that nothing later depends on held fixed.

    Some of it has no finite derivative (a way of length zero, the cost of a second start that was not tried), and in
    reverse mode zero times infinity would spoil the rest.
    """
    solver = loop.planner.solver
    fixed = dataclasses.replace(jax.lax.stop_gradient(solver), plan=solver.plan)
    planner = dataclasses.replace(loop.planner, solver=fixed)
    tally, least = jax.lax.stop_gradient((loop.tally, loop.least))
    return dataclasses.replace(loop, planner=planner, tally=tally, least=least)


def _add(sums: Sums, view: View, target: Array, scenario: Scenario, time: Array, period: float) -> Sums:
    off = view.pose[:2] - target[:2]
    apart = gaps(scenario, view, scenario.obstacles.at(time))
    team = nearest(scenario, view, apart).team
    near = [-jnp.minimum(distances, FAR) / SHARPNESS for distances in (apart, team)]
    largest = jnp.maximum(sums.largest, jnp.stack([jnp.max(some) for some in near]))
    largest = jax.lax.stop_gradient(largest)
    more = jnp.stack([jnp.sum(jnp.exp(some - most)) for some, most in zip(near, largest, strict=True)])
    nearness = sums.nearness * jnp.exp(sums.largest - largest) + more
    misfit = _misfit(scenario, view.pose)
    outside = jax.nn.sigmoid((safe_norm(misfit) - 1.0) / ARRIVAL_WIDTH)
    return Sums(
        sums.path_error + jnp.sum(off * off),
        sums.effort + period * jnp.sum(view.force**2),
        nearness,
        largest,
        sums.time + period * outside,
        sums.off_goal + off_goal(jnp.sum(misfit[:2] ** 2), misfit[2] ** 2),
    )


def off_goal(position: Array, heading: Array) -> Array:
    """How far from the goal squared errors are, given in squares of the tolerances: slopes are small far away."""
    return jnp.log1p(position) + jnp.log1p(heading)


def _misfit(scenario: Scenario, pose: Array) -> Array:
    """[3] error to the goal in multiples of its tolerances."""
    off, goal = pose - scenario.goal.pose, scenario.goal
    turn = wrap_angle(off[2:]) / goal.heading_tolerance
    return jnp.concatenate([off[:2] / goal.position_tolerance, turn])


def soft_clearances(sums: Sums, ticks: Floats) -> Array:
    """[2] m, soft minima of the clearances to obstacles and between robots over so many ticks."""
    # Per tick, so that a clearance held for the whole episode is reported as it is.
    return -SHARPNESS * (sums.largest + jnp.log(sums.nearness / ticks))


def _summary(end: Episode, scenario: Scenario) -> SoftOutcome:
    sums, off = end.sums, end.view.pose - scenario.goal.pose
    # A shorter episode than the others of its batch has fewer ticks.
    ticks = jnp.maximum(end.loop.tally.ticks, 1).astype(off.dtype)
    to_obstacles, between = soft_clearances(sums, ticks)
    return SoftOutcome(
        path_error_m2=sums.path_error / ticks,
        effort_n2s=sums.effort,
        clearance_m=to_obstacles,
        team_clearance_m=between,
        time_s=sums.time,
        off_goal=sums.off_goal / ticks,
        goal_error_m2=jnp.sum(off[:2] ** 2),
        heading_error_rad2=wrap_angle(off[2]) ** 2,
        alive=end.loop.alive,
    )
