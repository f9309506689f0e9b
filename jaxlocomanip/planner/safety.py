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
from jaxlocomanip.planar.geometry import perpendicular, polygon_distance, rectangle, rotate, transform
from jaxlocomanip.planner.config import PlannerConfig
from jaxlocomanip.planner.estimation import ObjectEstimate, ObstacleEstimate
from jaxlocomanip.planner.shapes import Shapes
from jaxlocomanip.scenario import Team

SAMPLES = 6
"""steps of the braking motion, each checked at its end"""
WAITS = 3
"""instants after the stop at which moving obstacles are looked at"""
ROOM_RATE = 4.0
"""1/s, of the barrier condition on the room between two robots"""
FAR = 1e3
"""m, room where there is nothing to hit"""


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
    """[] m, least room of the chosen candidate beyond the margin"""


def candidates(force: Array, rate: Array) -> tuple[Array, Array]:
    """[n, N_r] forces and rates around an input, in the order of preference."""
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
    return pushes * force, slides[:, None] * rate


def safety_filter(
    force: Array,
    rate: Array,
    estimate: ObjectEstimate,
    offset: Array,
    obstacles: ObstacleEstimate,
    body: Body,
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
      body: the object as estimated; friction is replaced by the pessimistic one.
      shapes: geometry.
      config: settings.
    """
    forces, rates = candidates(force, rate)
    rates = jax.vmap(lambda r: keep_room(offset, r, shapes.team))(rates)

    situation = (estimate, offset, obstacles, body, shapes, config)

    def least(situation: Any, push: Array, slide: Array) -> Array:
        # A push may help to brake as well as drive: neither more nor less of it than expected may do harm.
        given = jnp.stack([push, jnp.zeros_like(push)])
        return jnp.min(jax.vmap(lambda f: braking_room(f, slide, *situation))(given))

    own = least(situation, forces[0], rates[0])
    keep = (own >= 0.0) | (config.safety.enabled < 0.5)

    def rooms(given: tuple[Any, Array, Array]) -> Array:
        situation, pushes, slides = given
        return jax.vmap(lambda f, r: least(situation, f, r))(pushes, slides)

    # Most inputs are safe as they are: the others are looked at only where this one is not.
    given = jax.lax.stop_gradient((situation, forces[1:], rates[1:]))
    others = where_needed(~keep, rooms, given, jnp.full(forces.shape[0] - 1, -FAR, forces.dtype))
    room = jnp.concatenate([own[None], others])
    # Without a safe candidate, ties in room go to the earlier one: a standing team does not fidget.
    order = jnp.arange(room.shape[0], dtype=room.dtype)
    score = jnp.where(room >= 0.0, 1e3 - order, jnp.minimum(room, 0.0) - 1e-4 * order)
    best = jax.lax.stop_gradient(jnp.where(keep, 0, jnp.argmax(score)))
    return Filtered(forces[best], rates[best], best.astype(jnp.int32), room[best])


def keep_room(offset: Array, rate: Array, team: Team) -> Array:
    """Offset rates [N_r] nearest to `rate` under which the room between robots closes no faster than it vanishes.

    The barrier condition row @ rate <= ROOM_RATE (bound - row @ offset) of each pair in turn.
    """
    for i in range(team.pair_bounds.shape[0]):
        row = team.pair_rows[i]
        excess = row @ rate - ROOM_RATE * (team.pair_bounds[i] - row @ offset)
        rate = rate - row * jnp.maximum(excess, 0.0) / jnp.maximum(row @ row, 1.0)
    return rate


def slip(pose: Array, twist: Array, offset: Array, rate: Array, team: Team) -> Array:
    """[N_r] m/s, offset rates beyond the commanded ones: faces that move aside faster than a robot walks slip away."""
    points = team.contact_points(offset)
    velocity_B = rotate(-pose[2], twist[:2]) + twist[2] * perpendicular(points)
    walk = rate + jnp.sum(velocity_B * team.tangent, axis=-1)
    return jnp.clip(walk, -team.slide_speed_max, team.slide_speed_max) - walk


def braking_room(
    force: Array,
    rate: Array,
    estimate: ObjectEstimate,
    offset: Array,
    obstacles: ObstacleEstimate,
    body: Body,
    shapes: Shapes,
    config: PlannerConfig,
) -> Array:
    """[] m, least room beyond the margin on the way to rest after one tick of an input."""
    poses, offsets, times = braking_motion(force, rate, estimate, offset, body, shapes, config)

    def room(q: Array, d: Array, t: Array) -> Array:
        return room_at(q, d, obstacles.position + t * obstacles.velocity, shapes, config)

    return jnp.min(jax.vmap(room)(poses, offsets, times)) - config.safety.margin


def braking_motion(
    force: Array,
    rate: Array,
    estimate: ObjectEstimate,
    offset: Array,
    body: Body,
    shapes: Shapes,
    config: PlannerConfig,
) -> tuple[Array, Array, Array]:
    """Poses [n, 3], contact offsets [n, N_r] and times [n] s of the way to rest and of a wait there."""
    settings, team = config.safety, shapes.team
    after = config.horizon.tick + settings.lag
    wrench = dynamics.body_wrench(team.contact_points(offset), team.normal, force)
    # A push may move more than expected (a lighter object), and braking may take longer (a smoother floor).
    resisting = jnp.minimum(settings.friction * body.mass * GRAVITY, body.friction_force)
    moment = resisting * shapes.torsion_radius
    light = Body(body.mass / 1.3, body.inertia / 1.3, body.com, resisting, moment)
    smooth = Body(body.mass, body.inertia, body.com, resisting, moment)
    pose, twist = dynamics.step(light, estimate.pose, estimate.twist, wrench, after, 0.0)
    h = jnp.minimum(stopping_time(twist, body, shapes, config), 2.5) / SAMPLES

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


def stopping_time(twist: Array, body: Body, shapes: Shapes, config: PlannerConfig) -> Array:
    """[] s, at most, until friction alone has stopped the object."""
    slowing = config.safety.friction * GRAVITY
    turning = slowing * shapes.torsion_radius * body.mass / body.inertia
    # Translation and rotation share one friction budget: braking both takes at most the sum of the times for either.
    return safe_norm(twist[:2]) / slowing + jnp.abs(twist[2]) / jnp.maximum(turning, 1e-3)


def room_at(pose: Array, offset: Array, obstacles: Array, shapes: Shapes, config: PlannerConfig) -> Array:
    """[] m, distance between the true shapes of object and robots and the obstacles at [N_o, 2]."""
    team = shapes.team
    offset = jnp.clip(offset, -team.offset_limit, team.offset_limit)
    robots = jax.vmap(rectangle)(team.robot_poses(pose, offset), team.half_length, team.half_width)

    def gap(body: Array) -> Array:
        each = jax.vmap(lambda at, v, r: polygon_distance(body, 0.0, at + v, r))(
            obstacles, shapes.obstacle_vertices, shapes.obstacle_radius
        )
        return jnp.min(jnp.where(shapes.obstacle_mask, each, FAR))

    object_gap = jnp.where(config.protection.object > 0.5, gap(transform(pose, shapes.object_vertices)), FAR)
    robot_gap = jnp.where(config.protection.robots > 0.5, jnp.min(jax.vmap(gap)(robots)), FAR)
    return jnp.minimum(object_gap, robot_gap)
