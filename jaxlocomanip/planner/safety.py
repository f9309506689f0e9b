"""Last-line filter on the first input: brake-safe or it is not sent.

With ground friction the object stops within centimetres once nobody pushes, so an input is safe if, after one tick
of it, letting go brings everything to rest clear of every obstacle, true shape against true shape. Friction is
taken pessimistically, because overestimating it would be the one way to be wrong. A fixed set of candidates around
the planner's input is checked; the nearest safe one is sent, or, where none is safe, the one that keeps the most
room. Against obstacles that move, the room is also kept for a while after the stop.

The choice is piecewise constant and is held fixed when gradients are taken.
"""

from __future__ import annotations

from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
from jax import Array

from jaxlocomanip.lanes import where_needed
from jaxlocomanip.numerics import pytree, safe_norm
from jaxlocomanip.planar import dynamics
from jaxlocomanip.planar.dynamics import GRAVITY, Body
from jaxlocomanip.planner.breakaway import limit_push
from jaxlocomanip.planner.config import PlannerConfig
from jaxlocomanip.planner.estimation import ObjectEstimate, ObstacleEstimate
from jaxlocomanip.planner.room import FAR, keep_clear, keep_room, rooms_at, slip
from jaxlocomanip.planner.shapes import Shapes

SAMPLES = 6
"""steps of the braking motion, each checked at its end"""
WAITS = 3
"""instants after the stop at which moving obstacles are looked at"""
LIGHTER = 1.3
"""an object may be so many times lighter than estimated: a push then moves it further"""


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


def candidates(force: Array, rate: Array, back: Array) -> tuple[Array, Array]:
    """[n, N_r] forces and rates around an input, in the order of preference; `back` are rates the other way."""
    count = force.shape[0]
    scales = [
        (np.ones(count), 1.0),
        (np.ones(count), 0.0),
        (0.5 * np.ones(count), 1.0),
        (0.5 * np.ones(count), 0.0),
    ]
    scales += [(1.0 - np.eye(count)[i], 0.0) for i in range(count)]
    scales += [(np.zeros(count), 1.0), (np.zeros(count), 0.0), (np.zeros(count), -1.0)]
    pushes = jnp.asarray(np.array([s for s, _ in scales]), force.dtype)
    slides = jnp.asarray(np.array([r for _, r in scales]), force.dtype)
    return pushes * force, jnp.where(slides[:, None] < 0.0, back, slides[:, None] * rate)


def safety_filter(
    force: Array,
    rate: Array,
    estimate: ObjectEstimate,
    offset: Array,
    obstacles: ObstacleEstimate,
    body: Body,
    proven: Array,
    shapes: Shapes,
    config: PlannerConfig,
) -> Filtered:
    """The nearest safe input (see the module's text).

    Args:
      force: [N_r] N, the planner's first force.
      rate: [N_r] m/s, its first offset rate.
      estimate: the object's state.
      offset: [N_r] m.
      obstacles: estimated obstacles.
      body: the object as estimated; friction is replaced by the proven one.
      proven: [] N, friction that the floor has shown to have (`prove_friction`).
      shapes: geometry.
      config: settings.
    """

    def kept(rate: Array) -> Array:
        clear = keep_clear(estimate.pose, offset, rate, obstacles, shapes, config)
        return keep_room(offset, clear, shapes.team, config.safety.margin)

    forces, rates = candidates(force, kept(rate), kept(-rate))
    situation = (estimate, offset, obstacles, body, proven, shapes, config)

    def least(situation: Any, push: Array, slide: Array) -> Array:
        # A push may help to brake as well as drive: neither more nor less of it than expected may do harm.
        given = jnp.stack([push, jnp.zeros_like(push)])
        return jnp.min(jax.vmap(lambda f: braking_rooms(f, slide, *situation))(given), axis=0)

    own = least(situation, forces[0], rates[0])
    keep = jnp.all(own >= 0.0) | (config.safety.enabled < 0.5)

    def rooms(given: tuple[Any, Array, Array]) -> Array:
        situation, pushes, slides = given
        return jax.vmap(lambda f, r: least(situation, f, r))(pushes, slides)

    # Most inputs are safe as they are: the others are looked at only where this one is not.
    given = jax.lax.stop_gradient((situation, forces[1:], rates[1:]))
    others = where_needed(~keep, rooms, given, jnp.full((forces.shape[0] - 1, own.shape[0]), -FAR, forces.dtype))
    room = jnp.concatenate([own[None], others])
    spare = jnp.min(room, axis=1)
    # Without a safe candidate a team at rest stays at rest, and ties go to the earlier one, lest it fidget.
    still = (safe_norm(estimate.twist[:2]) < STILL) & (jnp.max(forces, axis=1) > 0.0)
    spare = jnp.where(still & (spare < 0.0), spare - FAR, spare)
    order = jnp.arange(room.shape[0], dtype=room.dtype)
    score = jnp.where(spare >= 0.0, 1e3 - order, spare - 1e-4 * order)
    best = jax.lax.stop_gradient(jnp.where(keep, 0, jnp.argmax(score)))
    return Filtered(forces[best], rates[best], best.astype(jnp.int32), jnp.min(room[best, :2]))


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
    team = shapes.team
    wrench_B = dynamics.body_wrench(team.contact_points(offset), team.normal, force)
    push = limit_push(wrench_B, body.com, shapes)
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


def braking_rooms(
    force: Array,
    rate: Array,
    estimate: ObjectEstimate,
    offset: Array,
    obstacles: ObstacleEstimate,
    body: Body,
    proven: Array,
    shapes: Shapes,
    config: PlannerConfig,
) -> Array:
    """[3] m, least rooms (`rooms_at`) beyond the margin on the way to rest after one tick of an input."""
    poses, offsets, times = braking_motion(force, rate, estimate, offset, body, proven, shapes, config)

    def room(q: Array, d: Array, t: Array) -> Array:
        return rooms_at(q, d, obstacles.position + t * obstacles.velocity, shapes, config)

    return jnp.min(jax.vmap(room)(poses, offsets, times), axis=0) - config.safety.margin


def braking_motion(
    force: Array,
    rate: Array,
    estimate: ObjectEstimate,
    offset: Array,
    body: Body,
    proven: Array,
    shapes: Shapes,
    config: PlannerConfig,
) -> tuple[Array, Array, Array]:
    """Poses [n, 3], contact offsets [n, N_r] and times [n] s of the way to rest and of a wait there."""
    settings, team = config.safety, shapes.team
    after = config.horizon.tick + settings.lag
    wrench = dynamics.body_wrench(team.contact_points(offset), team.normal, force)
    # A push may move more than expected (a lighter object), and braking may take longer (a smoother floor).
    resisting = jnp.minimum(proven, body.friction_force)
    moment = resisting * shapes.torsion_radius
    light = Body(body.mass / LIGHTER, body.inertia / LIGHTER, body.com, resisting, moment)
    smooth = Body(body.mass, body.inertia, body.com, resisting, moment)
    pose, twist = dynamics.step(light, estimate.pose, estimate.twist, wrench, after, 0.0)
    h = jnp.minimum(stopping_time(twist, body, resisting, shapes), 2.5) / SAMPLES

    def brake(carry: tuple[Array, Array, Array], _: None) -> tuple[tuple[Array, Array, Array], tuple[Array, Array]]:
        q, velocity, d = carry
        d = d + h * slip(q, velocity, d, jnp.zeros_like(d), team)
        q, velocity = dynamics.step(smooth, q, velocity, jnp.zeros_like(velocity), h, 0.0)
        return (q, velocity, d), (q, d)

    first = offset + rate * config.horizon.tick + after * slip(estimate.pose, estimate.twist, offset, rate, team)
    _, (braking, sliding) = jax.lax.scan(brake, (pose, twist, first), None, length=SAMPLES)
    waits = jnp.linspace(0.0, 1.0, WAITS + 1, dtype=force.dtype)[1:] * settings.look_ahead
    times = after + h * jnp.arange(SAMPLES + 1.0, dtype=force.dtype)
    return (
        jnp.concatenate([pose[None], braking, jnp.repeat(braking[-1:], WAITS, axis=0)]),
        jnp.concatenate([first[None], sliding, jnp.repeat(sliding[-1:], WAITS, axis=0)]),
        jnp.concatenate([times, times[-1] + waits]),
    )


def stopping_time(twist: Array, body: Body, friction: Array, shapes: Shapes) -> Array:
    """[] s, at most, until friction [] N alone has stopped the object."""
    slowing = jnp.maximum(friction / body.mass, 0.3)
    turning = slowing * shapes.torsion_radius * body.mass / body.inertia
    # Translation and rotation share one friction budget: braking both takes at most the sum of the times for either.
    return safe_norm(twist[:2]) / slowing + jnp.abs(twist[2]) / jnp.maximum(turning, 1e-3)
