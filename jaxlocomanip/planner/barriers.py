"""Exponential control barrier functions of discs and obstacles.

Time derivatives of barrier values are taken along the adaptive model's motion *and* the obstacle's own predicted
motion at that stage's time. The object's barrier has relative degree 2 and takes the predicted acceleration, the
robots' barriers have relative degree 1. They are written out, because the distance to a corner or an edge has a
simple gradient and Hessian; the tests hold them against Lie derivatives by forward differentiation
(`planar.dynamics.lie_derivative`) and finite differences.

Components come first and stages last, as in `constraints`. Discs are taken one after the other, in a loop: what one
disc needs stays in the processor's fast memory, and the compiler, which would otherwise merge all of it into one
expression for each number that comes out, computes it once.
"""

from __future__ import annotations

import dataclasses

import jax
import jax.numpy as jnp
from jax import Array

from jaxlocomanip.numerics import pytree
from jaxlocomanip.planar.geometry import Feature, feature_distance, feature_of, nearest_code, outline
from jaxlocomanip.planar.vector import Vector, trailing, unit, vector, vectors
from jaxlocomanip.planner.config import Constraints
from jaxlocomanip.planner.constraints import Motion
from jaxlocomanip.planner.shapes import ROBOT_DISCS, Shapes


@pytree
class Discs:
    """Discs that cover the object, and after them those that cover the robots; every leaf has them first [D, ...]."""

    base: Vector
    """m, centres at zero contact offset, frame of the object"""
    slide: Vector
    """direction in which a disc moves with its robot's offset, frame of the object; zero for those of the object"""
    radius: Array
    """m"""
    second: Array
    """1 for a barrier of relative degree 2 (the object), 0 for one of relative degree 1 (robots)"""
    beta: Array
    """1/s, gain on B'; 1 where the relative degree is 1"""
    alpha: Array
    """1/s^2 or 1/s, gain on B"""


def discs(shapes: Shapes, settings: Constraints) -> Discs:
    """All discs of a team and its object, [D = K + N_r ROBOT_DISCS]."""
    team, centers = shapes.team, vectors(shapes.object_centers)
    robots = vectors(shapes.robot_centers(jnp.zeros_like(team.offset)).reshape(-1, 2))
    tangents = vectors(jnp.repeat(team.tangent, ROBOT_DISCS, axis=0))
    none, one = jnp.zeros_like(centers.x), jnp.ones_like(robots.x)

    def both(of_object: Array, of_robots: Array) -> Array:
        return jnp.concatenate([of_object, of_robots])

    return Discs(
        Vector(both(centers.x, robots.x), both(centers.y, robots.y)),
        Vector(both(none, tangents.x), both(none, tangents.y)),
        both(shapes.object_radii, jnp.repeat(shapes.robot_radii, ROBOT_DISCS)),
        both(none + 1.0, 0.0 * one),
        both(none + settings.object_beta, one),
        both(none + settings.object_alpha, one * settings.robot_alpha),
    )


def by_disc(values: Array, shapes: Shapes) -> Array:
    """[D, ...] what belongs to the robots [N_r, ...], given to their discs; zero for discs of the object."""
    none = jnp.zeros((shapes.object_radii.shape[0], *values.shape[1:]), values.dtype)
    return jnp.concatenate([none, jnp.repeat(values, ROBOT_DISCS, axis=0)])


@pytree
class Obstacles:
    """Obstacles as the discs see them."""

    feature: Feature
    """nearest corner or edge, relative to the obstacle's position; leaves [D, N_o, ...]"""
    place: Vector
    """[N_o, ...] m"""
    drift: Vector
    """[N_o, ...] m/s"""
    rounding: Array
    """[N_o, ...] m, radius of the obstacle and margin"""


def look(
    pose: Array, offset: Array, position: Array, velocity: Array, shapes: Shapes, settings: Constraints
) -> Obstacles:
    """Nearest features of all discs and obstacles.

    Args:
      pose: [3, ...] where the discs are looked at.
      offset: [N_r, ...] m.
      position: [N_o, 2, ...] m, of the obstacles.
      velocity: [N_o, 2, ...] m/s.
      shapes: geometry.
      settings: margin.
    """
    place, drift = (Vector(v[:, 0], v[:, 1]) for v in (position, velocity))
    corners = vectors(shapes.obstacle_vertices)
    # Edges first, then obstacles, then stages.
    shape = outline(Vector(*(trailing(c.T, place.x[None]) for c in (corners.x, corners.y))))
    heading, at = unit(pose[2]), vector(pose)

    def seen(given: tuple[Discs, Array]) -> Array:
        disc, slid = given
        center = at + (disc.base + disc.slide * slid).rotated(heading)
        return nearest_code(Vector(center.x - place.x, center.y - place.y), shape)

    # The loop makes the compiler keep the choices: else each part of a feature would be compiled into a search.
    codes = jax.lax.map(seen, (discs(shapes, settings), by_disc(offset, shapes)))
    rounding = trailing(shapes.obstacle_radius + settings.margin, place.x)
    return Obstacles(feature_of(codes, shape), place, drift, rounding)


@pytree
class Approach:
    """How a disc and the obstacles approach each other; leaves [N_o, ...]."""

    normal: Vector
    """n, gradient of the distance"""
    curvature: Array
    """1/m; the Hessian of the distance is curvature (I - n n')"""
    barrier: Array
    """B, m"""


def approach(disc: Discs, center: Vector, obstacles: Obstacles) -> Approach:
    """Geometry of one disc with its centre [...] in the world, and the obstacles with the features that it sees."""
    relative = Vector(center.x - obstacles.place.x, center.y - obstacles.place.y)
    distance, normal, curvature = feature_distance(relative, obstacles.feature)
    return Approach(normal, curvature, distance - obstacles.rounding - disc.radius)


@pytree
class DiscMotion:
    """A disc in motion, world frame; leaves [...]."""

    center: Vector
    """m"""
    arm: Vector
    """m, from the object's body point"""
    slide: Vector
    """direction in which it moves with its robot's offset"""
    speed: Vector
    """m/s"""
    pull: Vector
    """m/s^2, without what a robot's sliding adds"""


def disc_motion(disc: Discs, slid: Array, sliding: Array, motion: Motion, heading: Vector) -> DiscMotion:
    """Kinematics of one disc; `slid` and `sliding` are its robot's offset and offset rate [...]."""
    slide = disc.slide.rotated(heading)
    arm = (disc.base + disc.slide * slid).rotated(heading)
    omega, turn = motion.twist[2], motion.acceleration[2]
    speed = vector(motion.twist) + arm.turned * omega + slide * sliding
    pull = vector(motion.acceleration) + arm.turned * turn - arm * (omega * omega)
    return DiscMotion(vector(motion.pose) + arm, arm, slide, speed, pull)


def condition(disc: Discs, moving: DiscMotion, seen: Approach, obstacles: Obstacles, settings: Constraints) -> Array:
    """[N_o, ...] scaled conditions of a disc: B'' + beta B' + alpha B of the object's, B' + alpha B of a robot's."""
    speed = Vector(moving.speed.x - obstacles.drift.x, moving.speed.y - obstacles.drift.y)
    closing, passing = seen.normal.dot(speed), seen.normal.cross(speed)
    bend = seen.normal.dot(moving.pull) + seen.curvature * passing * passing
    return settings.cbf_scale * (disc.second * bend + disc.beta * closing + disc.alpha * seen.barrier)


def conditions(motion: Motion, shapes: Shapes, obstacles: Obstacles, settings: Constraints) -> Array:
    """[D, N_o, ...] scaled conditions of all discs, one disc after the other."""
    heading = unit(motion.pose[2])

    def one(given: tuple[Discs, Array, Array, Feature]) -> Array:
        disc, slid, sliding, feature = given
        near = dataclasses.replace(obstacles, feature=feature)
        moving = disc_motion(disc, slid, sliding, motion, heading)
        return condition(disc, moving, approach(disc, moving.center, near), near, settings)

    robots = by_disc(motion.offset, shapes), by_disc(motion.offset_rate, shapes)
    return jax.lax.map(one, (discs(shapes, settings), *robots, obstacles.feature))
