"""Curvature of the barriers: Hessians of the discs' conditions, weighted and summed (`curvature`).

Along the normal n and the tangent t of the distance, a condition

    h = second (n . a + kappa (t . v)^2) + beta n . v + alpha B

has a Hessian by the disc's centre, its velocity v and its acceleration a with few entries, all of them in proportion to
the curvature kappa of the distance: against an edge there is none. Arrays have stages last.
"""

from __future__ import annotations

import dataclasses
from collections.abc import Callable
from typing import TYPE_CHECKING, Any

import jax
import jax.numpy as jnp
from jax import Array

from jaxlocomanip.numerics import apart, pytree
from jaxlocomanip.planar.geometry import Feature
from jaxlocomanip.planar.vector import Vector, unit
from jaxlocomanip.planner import barriers
from jaxlocomanip.planner.barriers import Approach, DiscMotion, Discs, Obstacles
from jaxlocomanip.planner.constraints import Motion

if TYPE_CHECKING:
    from jaxlocomanip.planner.problem import PushProblem, StageData

_THETA, _OMEGA = 2, 5
Block = tuple[tuple[Array, Array], tuple[Array, Array]]
"""a matrix [2, 2] of arrays [D, N] or [N]"""


@pytree
class Weighted:
    """Derivatives of the conditions of discs, times their weights and summed over obstacles; leaves [D, N] or [N]."""

    center: Vector
    speed: Vector
    pull: Vector
    by_center: Block
    """second derivatives by the centre"""
    center_speed: Block
    """by centre and velocity"""
    by_speed: Block
    center_pull: Block
    """by centre and acceleration"""


def disc_part(
    problem: PushProblem,
    motion: Motion,
    by_acceleration: Array,
    data: StageData,
    weights: Callable[[Array], Array],
) -> tuple[Array, Array]:
    """Curvature [nz, nz, N] of the discs' conditions but for that of the acceleration, and the gradient [3, N] by it.

    Args:
      problem: the optimal control problem.
      motion: of the object and the team.
      by_acceleration: [3, nz, N] derivatives of the acceleration.
      data: of the stages.
      weights: P' [m, N] of the conditions [m, N].
    """
    settings, shapes, obstacles = problem.config.constraints, problem.shapes, data.obstacles
    n, heading = motion.force.shape[0], unit(motion.pose[2])

    def geometry(given: tuple[Discs, Array, Array, Feature]) -> tuple[Approach, DiscMotion, Array]:
        disc, slid, sliding, feature = given
        near = dataclasses.replace(obstacles, feature=feature)
        moving = barriers.disc_motion(disc, slid, sliding, motion, heading)
        seen = barriers.approach(disc, moving.center, near)
        return seen, moving, barriers.condition(disc, moving, seen, near, settings)

    every = barriers.discs(shapes, settings)
    sliding = barriers.by_disc(motion.offset_rate, shapes)
    given = every, barriers.by_disc(motion.offset, shapes), sliding, obstacles.feature
    seen, moving, h = apart(jax.vmap(geometry))(given)
    weight = weights(h.reshape(-1, h.shape[2])).reshape(h.shape) * settings.cbf_scale
    found = _weighted(every, moving, seen, obstacles, weight)
    owned = barriers.by_disc(jnp.eye(n, dtype=h.dtype), shapes)

    def one(total: tuple[Array, Array], disc: tuple[Weighted, DiscMotion, Array, Array]) -> tuple[Any, None]:
        bent, pulling = _of_disc(*disc, motion, by_acceleration)
        return (total[0] + bent, total[1] + pulling), None

    count = by_acceleration.shape[1]
    start = jnp.zeros((count, *by_acceleration.shape[1:]), h.dtype), jnp.zeros_like(motion.pose)
    (half, pulling), _ = jax.lax.scan(one, start, (found, moving, sliding, owned))
    return half + jnp.swapaxes(half, 0, 1), pulling


@apart
def _weighted(disc: Discs, moving: DiscMotion, seen: Approach, obstacles: Obstacles, weight: Array) -> Weighted:
    """Of all discs, weights [D, N_o, N]."""
    disc = jax.tree.map(lambda leaf: leaf[:, None, None], disc)
    speed, pull = (Vector(v.x[:, None], v.y[:, None]) for v in (moving.speed, moving.pull))
    speed = Vector(speed.x - obstacles.drift.x, speed.y - obstacles.drift.y)
    n, kappa, second, beta = seen.normal, seen.curvature, disc.second, disc.beta
    t = n.turned
    closing, passing, ahead, aside = n.dot(speed), t.dot(speed), n.dot(pull), t.dot(pull)
    bend = kappa * passing
    along = disc.alpha - second * bend * bend
    across = kappa * (beta * passing + second * (aside - 2.0 * closing * bend))
    # Second derivatives by motions of the centre along n (first letter n) or t, and of velocity or acceleration.
    turning = second * kappa * (2.0 * kappa * kappa * closing * closing - 2.0 * bend * bend - kappa * ahead)
    tt = kappa * (along - beta * kappa * closing) + turning
    nn, nt = 2.0 * second * kappa * bend * bend, 2.0 * second * kappa * kappa * bend * closing - kappa * across
    sheared, tt_speed = -2.0 * second * kappa * bend, kappa * (beta - 2.0 * second * kappa * closing)

    def total(terms: Array) -> Array:
        """Over obstacles."""
        return jnp.sum(weight * terms, axis=1)

    def vectors(by_n: Array, by_t: Array) -> Vector:
        return Vector(total(by_n * n.x + by_t * t.x), total(by_n * n.y + by_t * t.y))

    def block(nn: Array | float, nt: Array | float, tn: Array | float, tt: Array) -> Block:
        def entry(a: tuple[Array, Array], b: tuple[Array, Array]) -> Array:
            return total(nn * a[0] * b[0] + nt * a[0] * b[1] + tn * a[1] * b[0] + tt * a[1] * b[1])

        x, y = (n.x, t.x), (n.y, t.y)
        return (entry(x, x), entry(x, y)), (entry(y, x), entry(y, y))

    return Weighted(
        center=vectors(along, across),
        speed=vectors(beta, 2.0 * second * bend),
        pull=vectors(second, 0.0 * second),
        by_center=block(nn, nt, nt, tt),
        center_speed=block(0.0, sheared, sheared, tt_speed),
        by_speed=block(0.0, 0.0, 0.0, 2.0 * second * kappa),
        center_pull=block(0.0, 0.0, 0.0, second * kappa),
    )


@apart
def _of_disc(
    found: Weighted, moving: DiscMotion, sliding: Array, own: Array, motion: Motion, by_acceleration: Array
) -> tuple[Array, Array]:
    """A matrix [nz, nz, N] that with its transpose is one disc's curvature, and the gradient [3, N] by acceleration.

    Args:
      found: derivatives of its conditions.
      moving: its motion.
      sliding: [N] m/s, at which it moves with its robot.
      own: [N_r] 1 for its robot.
      motion: of the object and the team.
      by_acceleration: [3, nz, N].
    """
    count, n = by_acceleration.shape[1], own.shape[0]
    omega, alpha = motion.twist[2], motion.acceleration[2]
    arm, slide, swing = moving.arm, moving.slide, by_acceleration[2]
    basis = jnp.eye(count, dtype=swing.dtype)[..., None]
    offset, rate = (jnp.sum(own[:, None, None] * basis[k : k + n], axis=0) for k in (6, 6 + 2 * n))
    theta, spin = basis[_THETA], basis[_OMEGA]
    speed_theta = slide.turned * sliding - arm * omega
    pull_theta = arm * alpha + arm.turned * omega**2

    def rows(place: int, *terms: tuple[Vector, Array]) -> Vector:
        x, y = (basis[place], basis[place + 1]) if place >= 0 else (by_acceleration[0], by_acceleration[1])
        for direction, by in terms:
            x, y = x + direction.x * by, y + direction.y * by
        return Vector(x, y)

    center = rows(0, (arm.turned, theta), (slide, offset))
    speed = rows(3, (speed_theta, theta), (arm.turned, spin), (slide.turned * omega, offset), (slide, rate))
    pull = rows(-1, (pull_theta, -theta), (arm * omega, -2.0 * spin), (arm.turned, swing))

    def applied(block: Block, v: Vector) -> Vector:
        return Vector(block[0][0] * v.x + block[0][1] * v.y, block[1][0] * v.x + block[1][1] * v.y)

    own_half = applied(found.by_center, center) * 0.5
    at_center = own_half + applied(found.center_speed, speed) + applied(found.center_pull, pull)
    at_speed = applied(found.by_speed, speed) * 0.5
    out, around, lead = found.pull.dot(arm), found.pull.dot(arm.turned), found.speed.dot(slide.turned)
    bend = -found.center.dot(arm) - omega * found.speed.dot(arm.turned) - sliding * found.speed.dot(slide)
    bend = bend - alpha * around + omega**2 * out
    with_offset = found.center.dot(slide.turned) - omega * found.speed.dot(slide)
    by_theta = 0.5 * bend * theta - (found.speed.dot(arm) + 2.0 * omega * around) * spin
    by_theta = by_theta - out * swing + with_offset * offset + lead * rate
    by_spin = lead * offset - out * spin
    left = (center.x, center.y, speed.x, speed.y, theta, spin)
    right = (at_center.x, at_center.y, at_speed.x, at_speed.y, by_theta, by_spin)
    total = sum(
        (a[:, None] * b for a, b in zip(left, right, strict=True)), jnp.zeros_like(by_acceleration[0][:, None] * swing)
    )
    return total, jnp.stack([found.pull.x, found.pull.y, around])
