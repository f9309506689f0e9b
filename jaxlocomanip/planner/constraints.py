"""Inequalities of one stage: bounds, control Lyapunov function and exponential control barrier functions.

Time derivatives of barrier values are taken along the adaptive model's motion *and* the obstacle's own predicted motion at that
stage's time. The object's barrier has relative degree 2 and takes the predicted acceleration, the robots' barriers have
relative degree 1. They are written out, because the distance to a corner or an edge has a simple gradient and Hessian; the
tests hold them against Lie derivatives by forward differentiation (`planar.dynamics.lie_derivative`) and finite differences.
"""

from __future__ import annotations

from collections.abc import Callable

import jax
import jax.numpy as jnp
from jax import Array

from jaxlocomanip.numerics import Floats, pytree, safe_norm
from jaxlocomanip.planar.dynamics import Body, coriolis_matrix, friction_wrench, mass_matrix
from jaxlocomanip.planar.geometry import feature_distance, nearest_feature, perpendicular, rotate
from jaxlocomanip.planner.config import Barrier, PlannerConfig
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


def object_barrier(motion: Motion, shapes: Shapes, position: Array, velocity: Array, config: PlannerConfig) -> Array:
    """[K N_o] B'' + beta B' + alpha B of the object's discs and the obstacles at `position`, `velocity` [N_o, 2]."""
    settings = config.constraints
    theta, omega = motion.pose[2], motion.twist[2]
    arms = rotate(theta, shapes.object_centers)
    centers = motion.pose[:2] + arms
    speeds = motion.twist[:2] + omega * perpendicular(arms)
    pulls = motion.acceleration[:2] + motion.acceleration[2] * perpendicular(arms) - omega**2 * arms

    def condition(center: Array, speed: Array, pull: Array, radius: Array, obstacle: _Obstacle) -> Array:
        b, slope, curvature = _barrier(center, speed, pull, radius, obstacle, settings.margin)
        return curvature + settings.object_beta * slope + settings.object_alpha * b

    return _all_pairs(condition, (centers, speeds, pulls, shapes.object_radii), shapes, position, velocity)


def robot_barrier(motion: Motion, shapes: Shapes, position: Array, velocity: Array, config: PlannerConfig) -> Array:
    """[N_r ROBOT_DISCS N_o] B' + alpha B of the robots' discs and the obstacles."""
    settings = config.constraints
    theta, omega = motion.pose[2], motion.twist[2]
    arms = rotate(theta, shapes.robot_centers(motion.offset).reshape(-1, 2))
    slides = jnp.repeat(motion.offset_rate[:, None] * shapes.team.tangent, ROBOT_DISCS, axis=0)
    speeds = motion.twist[:2] + omega * perpendicular(arms) + rotate(theta, slides)
    radii = jnp.repeat(shapes.robot_radii, ROBOT_DISCS)

    def condition(center: Array, speed: Array, radius: Array, obstacle: _Obstacle) -> Array:
        b, slope, _ = _barrier(center, speed, jnp.zeros_like(speed), radius, obstacle, settings.margin)
        return slope + settings.robot_alpha * b

    return _all_pairs(condition, (motion.pose[:2] + arms, speeds, radii), shapes, position, velocity)


_Obstacle = tuple[Array, Array, Array, Array]


def _barrier(
    center: Array, speed: Array, pull: Array, radius: Array, obstacle: _Obstacle, margin: Floats
) -> tuple[Array, Array, Array]:
    """B, B' and B'' of a disc with centre, velocity and acceleration [2] against one obstacle at constant velocity."""
    place, drift, vertices, rounding = obstacle
    relative = center - place
    distance, normal, curvature = feature_distance(relative, nearest_feature(relative, vertices))
    closing = speed - drift
    slope = jnp.sum(normal * closing)
    bend = curvature * (jnp.sum(closing * closing) - slope * slope)
    return distance - rounding - radius - margin, slope, jnp.sum(normal * pull) + bend


def _all_pairs(
    condition: Callable[..., Array], discs: tuple[Array, ...], shapes: Shapes, position: Array, velocity: Array
) -> Array:
    obstacles = (position, velocity, shapes.obstacle_vertices, shapes.obstacle_radius)
    over_obstacles = jax.vmap(condition, in_axes=(*([None] * len(discs)), 0))
    over_discs = jax.vmap(over_obstacles, in_axes=(*([0] * len(discs)), None))
    return over_discs(*discs, obstacles).reshape(-1)


def lyapunov_condition(
    motion: Motion, wrench: Array, body: Body, target: Array, target_twist: Array, config: PlannerConfig, smoothing: Floats
) -> Array:
    """[1] CLF: s'(-tau + H qdd_r + C qd_r + f_k) - 1/2 s' K_D s, with s = qd_e + lambda q_e.

    Args:
      motion: state of the stage.
      wrench: tau [3] about p, world axes.
      body: the object as estimated.
      target: [3] reference pose, target_twist: [3] reference velocity.
      config: gains; optionally divides by 1 + |s| lest a far reference outweigh every barrier.
      smoothing: m/s, of friction at rest.
    """
    settings = config.constraints
    error_rate = motion.twist - target_twist
    s = error_rate + settings.clf_rate * (motion.pose - target)
    reference, acceleration = motion.twist - s, -settings.clf_rate * error_rate
    needed = mass_matrix(body, motion.pose[2]) @ acceleration
    needed = needed + coriolis_matrix(body, motion.pose[2], motion.twist[2]) @ reference
    needed = needed + friction_wrench(body, motion.pose[2], motion.twist, smoothing)
    h = s @ (needed - wrench) - 0.5 * settings.clf_gain * jnp.sum(s * s)
    return (h / (1.0 + settings.clf_normalised * safe_norm(s)))[None]


def barriers(shapes: Shapes, config: PlannerConfig) -> tuple[Array, Array]:
    """Weights rho [nh] and switches eps [nh] of all inequalities, in the order bounds, CLF, object, robots."""
    settings, team = config.constraints, shapes.team
    n = team.offset.shape[0]
    exists = shapes.obstacle_mask.astype(team.offset.dtype)
    discs = shapes.object_radii.shape[0]
    real_pairs = (team.pair_bounds < 100.0).astype(team.offset.dtype)
    groups: list[tuple[Barrier, Array]] = [
        (settings.force, jnp.ones(2 * n)),
        (settings.offset, jnp.ones(2 * n)),
        (settings.offset_rate, jnp.ones(2 * n)),
        (settings.team, real_pairs),
        (settings.clf, jnp.ones(1)),
        (settings.object_cbf, jnp.tile(exists, discs) * config.protection.object),
        (settings.robot_cbf, jnp.tile(exists, n * ROBOT_DISCS) * config.protection.robots),
    ]
    weights = jnp.concatenate([barrier.weight * mask for barrier, mask in groups])
    switches = jnp.concatenate([barrier.switch * jnp.ones_like(mask) for barrier, mask in groups])
    return weights.astype(team.offset.dtype), switches.astype(team.offset.dtype)
