"""Inequalities of one stage: bounds, control Lyapunov function and exponential control barrier functions.

Time derivatives of barrier values are taken by forward differentiation along the adaptive model's motion *and* the obstacle's
own predicted motion at that stage's time. The object's barrier has relative degree 2 and is differentiated along
q + qd t + 1/2 qdd t^2 with the predicted acceleration, the robots' barriers have relative degree 1.
"""

from __future__ import annotations

import jax
import jax.numpy as jnp
from jax import Array

from jaxlocomanip.numerics import Floats, pytree, safe_norm, second_order_along
from jaxlocomanip.planar.dynamics import Body, coriolis_matrix, friction_wrench, mass_matrix
from jaxlocomanip.planar.geometry import point_distance, rotate
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

    def one(center: Array, radius: Array, place: Array, speed: Array, vertices: Array, rounding: Array) -> Array:
        def value(t: Array) -> Array:
            q = motion.pose + t * motion.twist + 0.5 * t * t * motion.acceleration
            point = q[:2] + rotate(q[2], center) - place - t * speed
            return point_distance(point, vertices, rounding) - radius - settings.margin

        b, slope, curvature = second_order_along(value, jnp.zeros((), motion.pose.dtype))
        return curvature + settings.object_beta * slope + settings.object_alpha * b

    over_obstacles = jax.vmap(one, in_axes=(None, None, 0, 0, 0, 0))
    over_discs = jax.vmap(over_obstacles, in_axes=(0, 0, None, None, None, None))
    h = over_discs(
        shapes.object_centers, shapes.object_radii, position, velocity, shapes.obstacle_vertices, shapes.obstacle_radius
    )
    return h.reshape(-1)


def robot_barrier(motion: Motion, shapes: Shapes, position: Array, velocity: Array, config: PlannerConfig) -> Array:
    """[N_r ROBOT_DISCS N_o] B' + alpha B of the robots' discs and the obstacles."""
    settings = config.constraints
    centers = shapes.robot_centers(motion.offset).reshape(-1, 2)
    slides = jnp.repeat(motion.offset_rate[:, None] * shapes.team.tangent, ROBOT_DISCS, axis=0)
    radii = jnp.repeat(shapes.robot_radii, ROBOT_DISCS)

    def one(
        center: Array, slide: Array, radius: Array, place: Array, speed: Array, vertices: Array, rounding: Array
    ) -> Array:
        def value(t: Array) -> Array:
            q = motion.pose + t * motion.twist
            point = q[:2] + rotate(q[2], center + t * slide) - place - t * speed
            return point_distance(point, vertices, rounding) - radius - settings.margin

        zero = jnp.zeros((), motion.pose.dtype)
        b, slope = jax.jvp(value, (zero,), (jnp.ones_like(zero),))
        return slope + settings.robot_alpha * b

    over_obstacles = jax.vmap(one, in_axes=(None, None, None, 0, 0, 0, 0))
    over_discs = jax.vmap(over_obstacles, in_axes=(0, 0, 0, None, None, None, None))
    h = over_discs(centers, slides, radii, position, velocity, shapes.obstacle_vertices, shapes.obstacle_radius)
    return h.reshape(-1)


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
