"""Room around true shapes, and how fast robots may slide along their faces without using it up."""

from __future__ import annotations

import jax
import jax.numpy as jnp
from jax import Array

from jaxlocomanip.numerics import Floats
from jaxlocomanip.planar.geometry import perpendicular, polygon_distance, rectangle, rotate, transform
from jaxlocomanip.planner.config import PlannerConfig
from jaxlocomanip.planner.estimation import ObstacleEstimate
from jaxlocomanip.planner.shapes import Shapes
from jaxlocomanip.scenario import Team

ROOM_RATE = 4.0
"""1/s, of the barrier conditions on room"""
AHEAD = 0.02
"""m, at which a robot's room is looked at beside where it is"""
FAR = 1e3
"""m, room where there is nothing to hit"""


def rooms_at(pose: Array, offset: Array, obstacles: Array, shapes: Shapes, config: PlannerConfig) -> Array:
    """[3] m, room of the true shapes: object and robots to obstacles at [N_o, 2], and robots to each other."""
    team = shapes.team
    offset = jnp.clip(offset, -team.offset_limit, team.offset_limit)
    outline = transform(pose, shapes.object_vertices)
    object_gap = jnp.where(config.protection.object > 0.5, _room(outline, obstacles, shapes), FAR)
    robot_gap = jnp.where(config.protection.robots > 0.5, jnp.min(robot_rooms(pose, offset, obstacles, shapes)), FAR)
    # Robots whose faces move aside faster than they can walk come into each other's way.
    team_gap = jnp.min(team.pair_bounds - team.pair_rows @ offset, initial=FAR)
    return jnp.stack([object_gap, robot_gap, team_gap])


def robot_rooms(pose: Array, offset: Array, obstacles: Array, shapes: Shapes) -> Array:
    """[N_r] m, room of each robot's true shape to obstacles at [N_o, 2]."""
    team = shapes.team
    robots = jax.vmap(rectangle)(team.robot_poses(pose, offset), team.half_length, team.half_width)
    return jax.vmap(lambda body: _room(body, obstacles, shapes))(robots)


def _room(body: Array, obstacles: Array, shapes: Shapes) -> Array:
    """[] m, signed distance of a polygon [V, 2] to the nearest obstacle."""
    each = jax.vmap(lambda at, v, r: polygon_distance(body, 0.0, at + v, r))(
        obstacles, shapes.obstacle_vertices, shapes.obstacle_radius
    )
    return jnp.min(jnp.where(shapes.obstacle_mask, each, FAR))


def keep_room(offset: Array, rate: Array, team: Team, margin: Floats) -> Array:
    """Offset rates [N_r] nearest to `rate` under which the room between robots closes no faster than it vanishes.

    The barrier condition row @ rate <= ROOM_RATE (bound - margin - row @ offset) of each pair in turn; the margin in m.
    """
    for i in range(team.pair_bounds.shape[0]):
        row = team.pair_rows[i]
        excess = row @ rate - ROOM_RATE * (team.pair_bounds[i] - margin - row @ offset)
        rate = rate - row * jnp.maximum(excess, 0.0) / jnp.maximum(row @ row, 1.0)
    return rate


def keep_clear(
    pose: Array, offset: Array, rate: Array, obstacles: ObstacleEstimate, shapes: Shapes, config: PlannerConfig
) -> Array:
    """Offset rates [N_r] nearest to `rate` with which no robot walks into an obstacle, each for itself.

    The same barrier condition as `keep_room`, on the room of each robot. It is asked of single robots because
    candidates move all at once: of two robots between obstacles one would give way at the other's cost, to and fro.
    """
    ahead = jnp.clip(offset + AHEAD * jnp.sign(rate), -shapes.team.offset_limit, shapes.team.offset_limit)
    now, then = (robot_rooms(pose, d, obstacles.position, shapes) for d in (offset, ahead))
    closing = jnp.maximum(now - then, 0.0) / AHEAD
    fastest = ROOM_RATE * jnp.maximum(now - config.safety.margin, 0.0) / jnp.maximum(closing, 1e-3)
    fastest = jnp.where((config.safety.enabled > 0.5) & (config.protection.robots > 0.5), fastest, jnp.inf)
    return jnp.clip(rate, -fastest, fastest)


def slip(pose: Array, twist: Array, offset: Array, rate: Array, team: Team) -> Array:
    """[N_r] m/s, offset rates beyond the commanded ones: faces that move aside faster than a robot walks slip away."""
    points = team.contact_points(offset)
    velocity_B = rotate(-pose[2], twist[:2]) + twist[2] * perpendicular(points)
    walk = rate + jnp.sum(velocity_B * team.tangent, axis=-1)
    return jnp.clip(walk, -team.slide_speed_max, team.slide_speed_max) - walk
