"""Curvature of the barriers: Hessians of the discs' conditions, weighted and summed (`curvature`).

Along the normal n and the tangent t of the distance, a condition

    h = second (n . a + kappa (t . v)^2) + beta n . v + alpha B

has a Hessian by the disc's centre, its velocity v and its acceleration a with few entries, all of them in proportion to
the curvature kappa of the distance: against an edge there is none. `disc_hessian` takes it from there to states and
inputs. Arrays have stages last.
"""

from __future__ import annotations

import dataclasses
from collections.abc import Callable
from typing import TYPE_CHECKING

import jax
import jax.numpy as jnp
from jax import Array

from jaxlocomanip.numerics import apart
from jaxlocomanip.planar.geometry import Feature
from jaxlocomanip.planar.vector import Vector, unit
from jaxlocomanip.planner import barriers
from jaxlocomanip.planner.barriers import Approach, DiscMotion, Discs, Obstacles
from jaxlocomanip.planner.constraints import Motion
from jaxlocomanip.planner.disc_hessian import Block, Weighted, by_states_and_inputs

if TYPE_CHECKING:
    from jaxlocomanip.planner.problem import PushProblem, StageData


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
    heading = unit(motion.pose[2])

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
    return by_states_and_inputs(found, moving, sliding, motion, by_acceleration)


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

    def block(nn: Array | float, nt: Array | float, tt: Array) -> Block:
        def entry(a: tuple[Array, Array], b: tuple[Array, Array]) -> Array:
            return total(nn * a[0] * b[0] + nt * (a[0] * b[1] + a[1] * b[0]) + tt * a[1] * b[1])

        x, y = (n.x, t.x), (n.y, t.y)
        return Block(entry(x, x), entry(x, y), entry(y, y))

    return Weighted(
        center=vectors(along, across),
        speed=vectors(beta, 2.0 * second * bend),
        pull=vectors(second, 0.0 * second),
        by_center=block(nn, nt, tt),
        center_speed=block(0.0, sheared, tt_speed),
        by_speed=block(0.0, 0.0, 2.0 * second * kappa),
        center_pull=block(0.0, 0.0, second * kappa),
    )
