"""Last-line filter on the first input: brake-safe or it is not sent.

With ground friction the object stops within centimetres once nobody pushes, so an input is safe if, after one tick
of it, letting go brings everything to rest clear of every obstacle, true shape against true shape. Friction is
taken pessimistically, because overestimating it would be the one way to be wrong. A fixed set of candidates around
the planner's input is checked; the nearest safe one is sent, or, where none is safe, the one that keeps the most
room. Before an obstacle that moves the team is at rest in time (passive safety); one that waits for it to pass also
keeps clear of it for a while after the stop.

The choice is piecewise constant and is held fixed when gradients are taken.
"""

from __future__ import annotations

import dataclasses

import jax
import jax.numpy as jnp
from jax import Array

from jaxlocomanip.lanes import where_needed
from jaxlocomanip.numerics import pytree, safe_norm
from jaxlocomanip.planar.dynamics import GRAVITY, Body
from jaxlocomanip.planner.braking import STIRRING, BrakeRooms, braking_rooms
from jaxlocomanip.planner.breakaway import limit_push
from jaxlocomanip.planner.config import PlannerConfig
from jaxlocomanip.planner.estimation import ObjectEstimate
from jaxlocomanip.planner.room import FAR, keep_room, slide_limits
from jaxlocomanip.planner.shapes import Shapes
from jaxlocomanip.planner.situation import Situation

FEW = 2
"""lanes of which other inputs are looked at together: they are rare, and the inputs of one are many already"""
HOLD = 0.98
"""share of a push that moved nothing, that goes on while no other is safe"""
STOP = -2
"""place of the candidate that neither pushes nor slides"""


@pytree
class Filtered:
    """Outcome of the filter."""

    force: Array
    """[N_r] N"""
    offset_rate: Array
    """[N_r] m/s"""
    choice: Array
    """[] int, 0: the planner's own input"""
    room: Array
    """[] m, least room of the chosen candidate to obstacles, beyond the margin"""


@pytree
class Candidates:
    """Inputs around the planner's own, in the order of preference."""

    forces: Array
    """[n, N_r] N"""
    rates: Array
    """[n, N_r] m/s"""
    holds: Array
    """[n] bool, the one that goes on with the push that acts on an object at rest"""


def candidates(
    force: Array, rate: Array, most: Array, situation: Situation, shapes: Shapes, config: PlannerConfig
) -> Candidates:
    """All inputs that are looked at; arguments as in `safety_filter`."""
    offset, waiting = situation.offset, situation.waiting
    fastest, away = slide_limits(situation.estimate.pose, offset, situation.obstacles.position, shapes, config)
    rate, back, away = (
        keep_room(offset, jnp.clip(wanted, -fastest[0], fastest[1]), shapes.team, config.safety.team_margin)
        for wanted in (rate, -rate, away)
    )
    # What acts on an object that lies still does not move it. From there single robots may push harder.
    held, each = HOLD * situation.force, jnp.eye(force.shape[0], dtype=force.dtype)
    others = jnp.where(waiting, held + each * jnp.maximum(most - held, 0.0), force * (1.0 - each))
    less = jnp.where(waiting, held, 0.5 * force)
    none, stay = jnp.zeros_like(force), jnp.zeros_like(rate)
    forces = [force, force, *others, less, less, none, none, none, none]
    rates = [rate, stay, *[stay] * others.shape[0], away, rate, rate, away, stay, back]
    holds = waiting & (jnp.arange(len(forces)) == 2 + others.shape[0])
    return Candidates(jnp.stack(forces), jnp.stack(rates), holds)


def safety_filter(
    force: Array, rate: Array, most: Array, situation: Situation, shapes: Shapes, config: PlannerConfig
) -> Filtered:
    """The nearest safe input (see the module's text).

    Args:
      force: [N_r] N, the planner's first force.
      rate: [N_r] m/s, its first offset rate.
      most: [N_r] N, that may be pushed.
      situation: what is known; of its friction the proven one is used.
      shapes: geometry.
      config: settings.
    """
    tried = candidates(force, rate, most, situation, shapes, config)
    forces, rates = tried.forces, tried.rates
    own = _rooms(forces[:1], rates[:1], jnp.array(CERTAIN, force.dtype), situation, shapes, config)
    # Which way a push turns the object is not known before it moves, and matters where there is no room for mistakes.
    unknown = situation.waiting & (situation.room < config.safety.margin)
    keep = (own.safe[0] & ~unknown) | (config.safety.enabled < 0.5)

    # Most inputs are safe as they are: others, and which way the object may turn, are looked at only where they matter.
    given, known = jax.lax.stop_gradient(((forces, rates, unknown, situation, shapes, config), own))
    alone = jax.tree.map(lambda room: jnp.full(forces.shape[:1], -FAR, room.dtype).at[0].set(room[0]), known)
    room = where_needed(~keep, _all_rooms, given, alone, group=FEW)
    still = tried.holds & (situation.stirring < STIRRING[0]) & (jnp.minimum(room.moving, room.later) >= 0.0)
    chosen = preferred(room, room.safe | still, forces, situation.waiting)
    best = jax.lax.stop_gradient(jnp.where(keep, 0, chosen))
    left = jnp.where(keep, own.to_obstacles[0], room.to_obstacles[best])
    return Filtered(forces[best], rates[best], best.astype(jnp.int32), left)


LEVER = 0.04
"""m, by which the centre of mass may be beside where it is believed to be"""
CERTAIN: tuple[tuple[float, float], ...] = ((1.0, 0.0), (0.0, 0.0))
"""Cases, as share of the push, and m by which it passes the centre of mass: a push may help to brake as well as drive,
so that neither more nor less of it than expected may do harm."""
DOUBTFUL = (*CERTAIN, (1.0, LEVER), (1.0, -LEVER))
"""Nor may the way in which it turns the object."""


def _all_rooms(given: tuple[Array, Array, Array, Situation, Shapes, PlannerConfig]) -> BrakeRooms:
    forces, rates, unknown, situation, shapes, config = given
    cases = jnp.array(DOUBTFUL, forces.dtype) * jnp.stack([jnp.ones((), forces.dtype), unknown.astype(forces.dtype)])
    return _rooms(forces, rates, cases, situation, shapes, config)


def _rooms(
    forces: Array,
    rates: Array,
    cases: Array,
    situation: Situation,
    shapes: Shapes,
    config: PlannerConfig,
) -> BrakeRooms:
    """Rooms of inputs [C, N_r], in the worst of the cases [m, 2]."""
    share, lever = jnp.repeat(cases.T, forces.shape[0], axis=1)
    forces, rates = (jnp.concatenate([v] * len(cases)) for v in (forces, rates))
    each = braking_rooms(share[:, None] * forces, rates, lever, situation, shapes, config)
    least = jax.tree.map(lambda room: jnp.min(room.reshape(len(cases), -1), axis=0), each)
    # A team that is on its way past an obstacle may do what it could not survive if it stopped for good.
    return dataclasses.replace(least, later=jnp.where(situation.held, least.later, FAR))


def preferred(room: BrakeRooms, safe: Array, forces: Array, waiting: Array) -> Array:
    """[] int, the candidate to send.

    The first that is safe; else, of those that come to rest in time, the one with the most room to what comes its way
    then; else, if an obstacle that moves can no longer be avoided, none of push and slide; else the one with the most
    room on the way to rest.

    Args:
      room: of the candidates.
      safe: [n] bool, which of them are.
      forces: [n, N_r] N, theirs.
      waiting: [] bool, the team is at rest.
    """
    # Ties go to the earlier one, and without a safe one a team at rest stays at rest, lest it fidget.
    order = jnp.arange(forces.shape[0], dtype=forces.dtype)
    last = 1e-4 * order + FAR * (waiting & (jnp.max(forces, axis=1) > 0.0))
    stops = room.on_the_way >= 0.0
    in_time = jnp.argmax(jnp.where(stops, room.later - last, -jnp.inf))
    too_late = jnp.where(jnp.any(room.moving >= 0.0), jnp.argmax(room.on_the_way - last), order.shape[0] + STOP)
    return jnp.where(jnp.any(safe), jnp.argmax(safe), jnp.where(jnp.any(stops), in_time, too_late))


def least_friction(body: Body, config: PlannerConfig) -> Array:
    """[] N, friction that is reckoned with before the floor has shown any."""
    return config.safety.friction * body.mass * GRAVITY


def prove_friction(
    proven: Array,
    estimate: ObjectEstimate,
    force: Array,
    offset: Array,
    body: Body,
    shapes: Shapes,
    config: PlannerConfig,
) -> Array:
    """Friction [] N to brake with, from what was seen.

    Where the object slides, the adapted friction is what the floor has; where it stays at rest under a push, the floor
    has that much at least. Only a share of either is believed. (That it is the same everywhere is assumed.)

    Args:
      proven: [] N, so far.
      estimate: the object's state.
      force: [N_r] N, push that acts.
      offset: [N_r] m.
      body: the object as estimated.
      shapes: geometry.
      config: settings.
    """
    push = limit_push(shapes.team.wrench(offset, force), body.com, shapes)
    settings, tick = config.safety, config.horizon.tick
    speed = safe_norm(estimate.twist[:2])
    sliding = settings.belief * body.friction_force
    learnt = proven + tick / (tick + SLIDING) * (sliding - proven)
    holding = jnp.maximum(proven, proven + tick / (tick + HOLDING) * (settings.belief * push - proven))
    new = jnp.where(speed > MOVING, learnt, jnp.where(speed < STILL, holding, proven))
    return jnp.maximum(new, least_friction(body, config))


MOVING, STILL = 0.15, 0.02
"""m/s, above and below which friction is learnt from sliding and from rest"""
SLIDING, HOLDING = 0.5, 0.3
"""s, over which it is learnt"""
