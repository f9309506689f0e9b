"""Last-line filter on the first input: brake-safe or it is not sent.

With ground friction the object stops within centimetres once nobody pushes, so an input is safe if, after one tick of it, letting go
brings everything to rest clear of every obstacle. Friction is taken pessimistically, because overestimating it would be the
one way to be wrong. A fixed set of candidates around the planner's input is checked; the nearest safe one is sent, or, where
none is safe, the one that keeps the most room. Against obstacles that move, the room is also kept for a while after the stop.

The choice is piecewise constant and is held fixed when gradients are taken.
"""

from __future__ import annotations

import jax
import jax.numpy as jnp
import numpy as np
from jax import Array

from jaxlocomanip.numerics import pytree, safe_norm
from jaxlocomanip.planar import dynamics
from jaxlocomanip.planar.dynamics import GRAVITY, Body
from jaxlocomanip.planar.geometry import point_distance, rotate
from jaxlocomanip.planner.config import PlannerConfig
from jaxlocomanip.planner.estimation import ObjectEstimate, ObstacleEstimate
from jaxlocomanip.planner.shapes import ROBOT_DISCS, Shapes
from jaxlocomanip.scenario import Team

SAMPLES = 5
"""poses checked along a braking motion"""
ROOM_TIME = 0.1
"""s, a robot stops sliding this long before it would be in another's way"""


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
    scales = [(np.ones(count), 1.0), (np.ones(count), 0.0), (0.5 * np.ones(count), 1.0), (0.5 * np.ones(count), 0.0)]
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
    settings = config.safety
    forces, rates = candidates(force, keep_room(offset, rate, shapes.team))
    room = jax.vmap(lambda f, r: braking_room(f, r, estimate, offset, obstacles, body, shapes, config))(forces, rates)
    safe = room >= 0.0
    # Without a safe candidate, ties in room go to the earlier one: a standing team does not fidget.
    order = jnp.arange(room.shape[0], dtype=room.dtype)
    score = jnp.where(safe, 1e3 - order, jnp.minimum(room, 0.0) - 1e-4 * order)
    best = jnp.where(settings.enabled > 0.5, jnp.argmax(score), 0)
    best = jax.lax.stop_gradient(best)
    return Filtered(forces[best], rates[best], best.astype(jnp.int32), room[best])


def keep_room(offset: Array, rate: Array, team: Team) -> Array:
    """Offset rates [N_r] without those that would bring robots into each other's way within `ROOM_TIME`."""
    ahead = team.pair_rows @ (offset + ROOM_TIME * rate)
    crowded = (ahead > team.pair_bounds)[:, None] & (team.pair_rows * rate > 0.0)
    return jnp.where(jnp.any(crowded, axis=0), 0.0, rate)


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
    settings, tick = config.safety, config.horizon.tick
    wrench = dynamics.body_wrench(shapes.team.contact_points(offset), shapes.team.normal, force)
    resisting = jnp.minimum(settings.friction * body.mass * GRAVITY, body.friction_force)
    careful = Body(body.mass / 1.3, body.inertia / 1.3, body.com, resisting, resisting * shapes.torsion_radius)
    pose, twist = dynamics.step(careful, estimate.pose, estimate.twist, wrench, tick + settings.lag, 0.0)
    slowing = settings.friction * GRAVITY
    speed, spin = safe_norm(twist[:2]), jnp.abs(twist[2])
    turning = slowing * shapes.torsion_radius * body.mass / body.inertia
    stop = jnp.minimum(jnp.maximum(speed / slowing, spin / jnp.maximum(turning, 1e-3)), 1.5)
    parts = jnp.linspace(0.0, 1.0, SAMPLES, dtype=force.dtype)
    # Uniform deceleration to rest at `stop`: fraction of the braking way covered at fraction t of the time.
    covered = parts * (2.0 - parts)
    poses = jnp.concatenate([estimate.pose[None], pose + 0.5 * stop * covered[:, None] * twist])
    times = jnp.concatenate([jnp.zeros(1, force.dtype), tick + settings.lag + stop * parts])
    waits = jnp.linspace(0.0, 1.0, 4, dtype=force.dtype)[1:] * settings.look_ahead
    poses = jnp.concatenate([poses[1:], jnp.repeat(poses[-1:], 3, axis=0)])
    times = jnp.concatenate([times[1:], times[-1] + waits])
    later = offset + rate * tick

    def room(q: Array, t: Array) -> Array:
        robots = shapes.robot_centers(later).reshape(-1, 2)
        centers = jnp.concatenate([shapes.object_centers, robots])
        radii = jnp.concatenate([shapes.object_radii, jnp.repeat(shapes.robot_radii, ROBOT_DISCS)])
        used = jnp.concatenate(
            [
                jnp.full(shapes.object_radii.shape, config.protection.object, q.dtype),
                jnp.full(robots.shape[:1], config.protection.robots, q.dtype),
            ]
        )
        points = q[:2] + rotate(q[2], centers)

        def one(point: Array, radius: Array, place: Array, speed: Array, vertices: Array, rounding: Array) -> Array:
            return point_distance(point - place - t * speed, vertices, rounding) - radius - settings.margin

        over = jax.vmap(jax.vmap(one, in_axes=(None, None, 0, 0, 0, 0)), in_axes=(0, 0, None, None, None, None))
        gaps = over(
            points, radii, obstacles.position, obstacles.velocity, shapes.obstacle_vertices, shapes.obstacle_radius
        )
        relevant = shapes.obstacle_mask[None, :] & (used[:, None] > 0.5)
        return jnp.min(jnp.where(relevant, gaps, 1e3))

    return jnp.min(jax.vmap(room)(poses, times))
