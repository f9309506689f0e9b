"""Inequalities of one stage: bounds, control Lyapunov function and exponential control barrier functions.

Time derivatives of barrier values are taken along the adaptive model's motion *and* the obstacle's own predicted
motion at that stage's time. The object's barrier has relative degree 2 and takes the predicted acceleration, the
robots' barriers have relative degree 1. They are written out, because the distance to a corner or an edge has a
simple gradient and Hessian; the tests hold them against Lie derivatives by forward differentiation
(`planar.dynamics.lie_derivative`) and finite differences.
"""

from __future__ import annotations

import jax
import jax.numpy as jnp
from jax import Array

from jaxlocomanip.numerics import Floats, pytree, safe_norm, wrap_angle
from jaxlocomanip.planar.dynamics import Body, coriolis_matrix, friction_wrench, mass_matrix
from jaxlocomanip.planar.geometry import Feature, feature_distance, nearest_feature, perpendicular, rotate
from jaxlocomanip.planner.config import Barrier, Constraints, PlannerConfig
from jaxlocomanip.planner.shapes import ROBOT_DISCS, Shapes


@pytree
class Motion:
    """Object and contacts at one stage."""

    pose: Array
    """[3]"""
    twist: Array
    """[3]"""
    acceleration: Array
    """[3] predicted qdd"""
    force: Array
    """[N_r] N"""
    offset: Array
    """[N_r] m"""
    offset_rate: Array
    """[N_r] m/s"""


def bounds(motion: Motion, shapes: Shapes) -> tuple[Array, Array, Array, Array]:
    """Bounds, each wanted >= 0: on force [2 N_r], offset [2 N_r], offset rate [2 N_r] and room in the team [P]."""
    team = shapes.team
    force = jnp.concatenate([motion.force, team.force_max - motion.force])
    offset = jnp.concatenate([team.offset_limit + motion.offset, team.offset_limit - motion.offset])
    rate = jnp.concatenate([team.slide_speed_max + motion.offset_rate, team.slide_speed_max - motion.offset_rate])
    return force, offset, rate, team.pair_bounds - team.pair_rows @ motion.offset


@pytree
class Obstacle:
    """What the barrier of one disc sees of one obstacle at one stage."""

    feature: Feature
    """nearest corner or edge, relative to the obstacle's position"""
    position: Array
    """[2] m"""
    velocity: Array
    """[2] m/s"""
    clearance: Array
    """[] m, sum of the radii and the margin"""


def barrier(center: Array, speed: Array, pull: Array, obstacle: Obstacle) -> tuple[Array, Array, Array]:
    """B, B' and B'' [] of a disc with centre, velocity and acceleration [2] against one obstacle."""
    distance, normal, curvature = feature_distance(center - obstacle.position, obstacle.feature)
    closing = speed - obstacle.velocity
    slope = jnp.sum(normal * closing)
    bend = curvature * (jnp.sum(closing * closing) - slope * slope)
    return distance - obstacle.clearance, slope, jnp.sum(normal * pull) + bend


def object_condition(center: Array, speed: Array, pull: Array, obstacle: Obstacle, settings: Constraints) -> Array:
    """[] scaled ECBF condition B'' + beta B' + alpha B of one disc of the object and one obstacle."""
    b, slope, curvature = barrier(center, speed, pull, obstacle)
    return settings.cbf_scale * (curvature + settings.object_beta * slope + settings.object_alpha * b)


def robot_condition(center: Array, speed: Array, obstacle: Obstacle, settings: Constraints) -> Array:
    """[] scaled CBF condition B' + alpha B of one disc of a robot and one obstacle."""
    b, slope, _ = barrier(center, speed, jnp.zeros_like(speed), obstacle)
    return settings.cbf_scale * (slope + settings.robot_alpha * b)


@pytree
class Obstacles:
    """Obstacles of one stage as every disc sees them."""

    objects: Obstacle
    """leaves [K, N_o, ...]"""
    robots: Obstacle
    """leaves [N_r ROBOT_DISCS, N_o, ...]"""


def look(pose: Array, offset: Array, position: Array, velocity: Array, shapes: Shapes, margin: Floats) -> Obstacles:
    """Nearest features and clearances of all discs and obstacles, the discs placed at a pose [3] and offsets [N_r]."""
    robots = shapes.robot_centers(offset).reshape(-1, 2)
    radii = jnp.repeat(shapes.robot_radii, ROBOT_DISCS)

    def seen(center: Array, radius: Array, place: Array, drift: Array, vertices: Array, rounding: Array) -> Obstacle:
        relative = pose[:2] + rotate(pose[2], center) - place
        return Obstacle(nearest_feature(relative, vertices), place, drift, radius + rounding + margin)

    over = jax.vmap(jax.vmap(seen, (None, None, 0, 0, 0, 0)), (0, 0, None, None, None, None))
    place = (position, velocity, shapes.obstacle_vertices, shapes.obstacle_radius)
    return Obstacles(over(shapes.object_centers, shapes.object_radii, *place), over(robots, radii, *place))


@pytree
class Discs:
    """Discs in motion, world frame."""

    centers: Array
    """[n, 2] m"""
    speeds: Array
    """[n, 2] m/s"""
    pulls: Array
    """[n, 2] m/s^2"""


def object_discs(motion: Motion, shapes: Shapes) -> Discs:
    """The object's covering discs."""
    arms = rotate(motion.pose[2], shapes.object_centers)
    omega = motion.twist[2]
    return Discs(
        motion.pose[:2] + arms,
        motion.twist[:2] + omega * perpendicular(arms),
        motion.acceleration[:2] + motion.acceleration[2] * perpendicular(arms) - omega**2 * arms,
    )


def robot_discs(motion: Motion, shapes: Shapes) -> Discs:
    """The robots' discs; their accelerations are not needed and zero."""
    arms = rotate(motion.pose[2], shapes.robot_centers(motion.offset).reshape(-1, 2))
    slides = jnp.repeat(motion.offset_rate[:, None] * shapes.team.tangent, ROBOT_DISCS, axis=0)
    speeds = motion.twist[:2] + motion.twist[2] * perpendicular(arms) + rotate(motion.pose[2], slides)
    return Discs(motion.pose[:2] + arms, speeds, jnp.zeros_like(arms))


def object_conditions(motion: Motion, shapes: Shapes, obstacles: Obstacles, settings: Constraints) -> Array:
    """[K N_o] scaled ECBF conditions of the object."""
    discs = object_discs(motion, shapes)
    one = jax.vmap(object_condition, in_axes=(None, None, None, 0, None))
    every = jax.vmap(one, in_axes=(0, 0, 0, 0, None))
    return every(discs.centers, discs.speeds, discs.pulls, obstacles.objects, settings).reshape(-1)


def robot_conditions(motion: Motion, shapes: Shapes, obstacles: Obstacles, settings: Constraints) -> Array:
    """[N_r ROBOT_DISCS N_o] scaled CBF conditions of the robots."""
    discs = robot_discs(motion, shapes)
    one = jax.vmap(robot_condition, in_axes=(None, None, 0, None))
    every = jax.vmap(one, in_axes=(0, 0, 0, None))
    return every(discs.centers, discs.speeds, obstacles.robots, settings).reshape(-1)


def lyapunov_condition(
    pose: Array,
    twist: Array,
    wrench: Array,
    body: Body,
    target: Array,
    target_twist: Array,
    settings: Constraints,
    smoothing: Floats,
) -> Array:
    """[] CLF: s'(-tau + H qdd_r + C qd_r + f_k) - 1/2 s' K_D s, with s = qd_e + lambda q_e.

    Args:
      pose: [3] of the object.
      twist: [3] of the object.
      wrench: tau [3] about p, world axes.
      body: the object as estimated.
      target: [3] reference pose.
      target_twist: [3] reference velocity.
      settings: gains; optionally divides by 1 + |s| lest a far reference outweigh every barrier.
      smoothing: m/s, of friction at rest.
    """
    off = pose - target
    error_rate = twist - target_twist
    s = error_rate + settings.clf_rate * jnp.concatenate([off[:2], wrap_angle(off[2:])])
    reference, acceleration = twist - s, -settings.clf_rate * error_rate
    needed = mass_matrix(body, pose[2]) @ acceleration
    needed = needed + coriolis_matrix(body, pose[2], twist[2]) @ reference
    needed = needed + friction_wrench(body, pose[2], twist, smoothing)
    h = jnp.sum(s * (needed - wrench)) - 0.5 * settings.clf_gain * jnp.sum(s * s)
    return h / (1.0 + settings.clf_normalised * safe_norm(s))


@pytree
class BarrierRows:
    """Settings of every inequality of a stage, in the order bounds, CLF, object, robots; leaves [nh]."""

    weight: Array
    switch: Array
    reach: Array


def barrier_rows(shapes: Shapes, config: PlannerConfig) -> BarrierRows:
    """Barrier settings of all inequalities; absent obstacles and unprotected bodies have weight 0."""
    settings, team = config.constraints, shapes.team
    n = team.offset.shape[0]
    dtype = team.offset.dtype
    exists = shapes.obstacle_mask.astype(dtype)
    groups: list[tuple[Barrier, Array]] = [
        (settings.force, jnp.ones(2 * n, dtype)),
        (settings.offset, jnp.ones(2 * n, dtype)),
        (settings.offset_rate, jnp.ones(2 * n, dtype)),
        (settings.team, (team.pair_bounds < 100.0).astype(dtype)),
        (settings.clf, jnp.ones(1, dtype)),
        (settings.object_cbf, jnp.tile(exists, shapes.object_radii.shape[0]) * config.protection.object),
        (settings.robot_cbf, jnp.tile(exists, n * ROBOT_DISCS) * config.protection.robots),
    ]

    def rows(values: list[Array]) -> Array:
        return jnp.concatenate(values).astype(dtype)

    return BarrierRows(
        rows([barrier.weight * mask for barrier, mask in groups]),
        rows([barrier.switch * jnp.ones_like(mask) for barrier, mask in groups]),
        rows([barrier.reach * jnp.ones_like(mask) for barrier, mask in groups]),
    )
