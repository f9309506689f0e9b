"""Curvature of the barriers: Hessians of the discs' conditions, weighted and summed (`curvature`).

Along the normal n and the tangent t of the distance, a condition

    h = second (n . a + kappa (t . v)^2) + beta n . v + alpha B

has a Hessian by the disc's centre, its velocity v and its acceleration a with few entries, all of them in proportion to
the curvature kappa of the distance: against an edge there is none. A disc is moved by eleven variables: position,
heading and their velocities and accelerations, and offset and offset rate of its robot. What all discs contribute to
entries of the Hessian by those is summed before the accelerations are expressed by states and inputs. Arrays have
stages last.
"""

from __future__ import annotations

import dataclasses
from collections.abc import Callable
from typing import TYPE_CHECKING

import jax
import jax.numpy as jnp
from jax import Array

from jaxlocomanip.numerics import apart, pytree
from jaxlocomanip.planar.geometry import Feature
from jaxlocomanip.planar.vector import Vector, unit
from jaxlocomanip.planner import barriers
from jaxlocomanip.planner.barriers import Approach, DiscMotion, Discs, Obstacles
from jaxlocomanip.planner.constraints import Motion
from jaxlocomanip.planner.shapes import ROBOT_DISCS
from jaxlocomanip.solver.layout import added, transposed_times

if TYPE_CHECKING:
    from jaxlocomanip.planner.problem import PushProblem, StageData


@pytree
class Block:
    """Symmetric matrices [2, 2], an array an entry."""

    xx: Array
    xy: Array
    yy: Array

    def times(self, v: Vector) -> Vector:
        """Products with vectors."""
        return Vector(self.xx * v.x + self.xy * v.y, self.xy * v.x + self.yy * v.y)


@pytree
class Weighted:
    """Derivatives of the conditions of discs, times their weights and summed over obstacles; leaves [D, N]."""

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
    moved = _moved(found, moving, sliding, motion)
    whole, robots = _entries(found, moving, moved, sliding, motion)
    core, own = _summed(whole, robots, n)
    return _hessian(core, own, by_acceleration), core[:3]


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


@pytree
class Moved:
    """How the gradients by centre, velocity and acceleration change with each variable; leaves [D, N]."""

    center_theta: Vector
    speed_theta: Vector
    pull_theta: Vector
    """also that by the centre with the angular acceleration"""
    center_omega: Vector
    speed_omega: Vector
    center_offset: Vector
    speed_offset: Vector
    center_rate: Vector
    speed_rate: Vector


def _swings(moving: DiscMotion, sliding: Array, motion: Motion) -> tuple[Vector, Vector, Vector]:
    """Derivatives of the velocity by heading and by offset, and of the acceleration by heading."""
    omega, alpha = motion.twist[2], motion.acceleration[2]
    by_heading = moving.slide.turned * sliding - moving.arm * omega
    return by_heading, moving.slide.turned * omega, moving.arm * (-alpha) - moving.arm.turned * omega**2


@apart
def _moved(found: Weighted, moving: DiscMotion, sliding: Array, motion: Motion) -> Moved:
    omega, arm, slide, around = motion.twist[2], moving.arm, moving.slide, moving.arm.turned
    speed_theta, swept, pull_theta = _swings(moving, sliding, motion)
    center, mixed, speed, pull = found.by_center, found.center_speed, found.by_speed, found.center_pull
    return Moved(
        center_theta=center.times(around) + mixed.times(speed_theta) + pull.times(pull_theta),
        speed_theta=mixed.times(around) + speed.times(speed_theta),
        pull_theta=pull.times(around),
        center_omega=mixed.times(around) - pull.times(arm) * (2.0 * omega),
        speed_omega=speed.times(around),
        center_offset=center.times(slide) + mixed.times(swept),
        speed_offset=mixed.times(slide) + speed.times(swept),
        center_rate=mixed.times(slide),
        speed_rate=speed.times(slide),
    )


@apart
def _entries(
    found: Weighted, moving: DiscMotion, moved: Moved, sliding: Array, motion: Motion
) -> tuple[dict[str, Array], dict[str, Array]]:
    """Entries [D, N] of each disc's Hessian by name: those of the object's variables, and of its robot's."""
    omega, alpha = motion.twist[2], motion.acceleration[2]
    arm, slide, around = moving.arm, moving.slide, moving.arm.turned
    speed_theta, swept, pull_theta = _swings(moving, sliding, motion)
    out, turn, lead = found.pull.dot(arm), found.pull.dot(around), found.speed.dot(slide.turned)
    bend = -found.center.dot(arm) - omega * found.speed.dot(around) - sliding * found.speed.dot(slide)
    bend = bend - alpha * turn + omega**2 * out
    theta_theta = around.dot(moved.center_theta) + speed_theta.dot(moved.speed_theta) + pull_theta.dot(moved.pull_theta)
    theta_omega = around.dot(moved.center_omega) + speed_theta.dot(moved.speed_omega)
    theta_offset = around.dot(moved.center_offset) + speed_theta.dot(moved.speed_offset)
    whole = {
        "pull x": found.pull.x,
        "pull y": found.pull.y,
        "turn": turn,
        **_block("p p", found.by_center),
        **_block("p v", found.center_speed),
        **_block("v v", found.by_speed),
        **_block("p a", found.center_pull),
        **_pair("p theta", moved.center_theta),
        **_pair("p omega", moved.center_omega),
        **_pair("v theta", moved.speed_theta),
        **_pair("v omega", moved.speed_omega),
        **_pair("a theta", moved.pull_theta),
        "theta theta": theta_theta + bend,
        "theta omega": theta_omega - found.speed.dot(arm) - 2.0 * omega * turn,
        "theta alpha": around.dot(moved.pull_theta) - out,
        "omega omega": around.dot(moved.speed_omega) - 2.0 * out,
    }
    robots = {
        **_pair("p offset", moved.center_offset),
        **_pair("p rate", moved.center_rate),
        **_pair("v offset", moved.speed_offset),
        **_pair("v rate", moved.speed_rate),
        "theta offset": theta_offset + found.center.dot(slide.turned) - omega * found.speed.dot(slide),
        "theta rate": around.dot(moved.center_rate) + speed_theta.dot(moved.speed_rate) + lead,
        "omega offset": around.dot(moved.speed_offset) + lead,
        "omega rate": around.dot(moved.speed_rate),
        "offset offset": slide.dot(moved.center_offset) + swept.dot(moved.speed_offset),
        "offset rate": slide.dot(moved.center_rate) + swept.dot(moved.speed_rate),
        "rate rate": slide.dot(moved.speed_rate),
    }
    return whole, robots


def _summed(whole: dict[str, Array], robots: dict[str, Array], n: int) -> tuple[Array, Array]:
    """`_WHOLE` [., N] of all discs together, and `_ROBOTS` [., N_r, N] of each robot's, which come last."""
    # By elementwise additions, since reductions over a first axis would not run along the last.
    every = jnp.stack([whole[name] for name in _WHOLE])
    moving = jnp.stack([robots[name][-n * ROBOT_DISCS :] for name in _ROBOTS])
    moving = moving.reshape(len(_ROBOTS), n, ROBOT_DISCS, -1)
    core = added([every[:, d] for d in range(every.shape[1])])
    return core, added([moving[:, :, d] for d in range(ROBOT_DISCS)])


def _block(name: str, block: Block) -> dict[str, Array]:
    return {f"{name} xx": block.xx, f"{name} xy": block.xy, f"{name} yy": block.yy}


def _pair(name: str, pair: Vector) -> dict[str, Array]:
    return {f"{name} x": pair.x, f"{name} y": pair.y}


_BY_STATE = (
    ("p p xx", "p p xy", "p theta x", "p v xx", "p v xy", "p omega x"),
    ("p p xy", "p p yy", "p theta y", "p v xy", "p v yy", "p omega y"),
    ("p theta x", "p theta y", "theta theta", "v theta x", "v theta y", "theta omega"),
    ("p v xx", "p v xy", "v theta x", "v v xx", "v v xy", "v omega x"),
    ("p v xy", "p v yy", "v theta y", "v v xy", "v v yy", "v omega y"),
    ("p omega x", "p omega y", "theta omega", "v omega x", "v omega y", "omega omega"),
)
"""by pose and twist"""
_BY_ACCELERATION = (
    ("p a xx", "p a xy", "a theta x"),
    ("p a xy", "p a yy", "a theta y"),
    ("a theta x", "a theta y", "theta alpha"),
)
"""by acceleration and pose; the twist has no part in it"""
_BY_OFFSET = ("p offset x", "p offset y", "theta offset", "v offset x", "v offset y", "omega offset")
_BY_RATE = ("p rate x", "p rate y", "theta rate", "v rate x", "v rate y", "omega rate")
_OWN = ("offset offset", "offset rate", "rate rate")
_WHOLE = ("pull x", "pull y", "turn", *sorted({name for row in (*_BY_STATE, *_BY_ACCELERATION) for name in row}))
_ROBOTS = (*_BY_OFFSET, *_BY_RATE, *_OWN)


@apart
def _hessian(core: Array, own: Array, by_acceleration: Array) -> Array:
    """[nz, nz, N] from the entries `_WHOLE` [., N] of all discs and `_ROBOTS` [., N_r, N] of each robot's.

    `by_acceleration` [3, nz, N] are the derivatives of the acceleration by states and inputs.
    """
    n, nz = own.shape[1], by_acceleration.shape[1]
    state, bent = (
        core[jnp.array([[_WHOLE.index(name) for name in row] for row in t])] for t in (_BY_STATE, _BY_ACCELERATION)
    )
    basis = jnp.eye(n, dtype=own.dtype)[..., None]
    offset, rate = own[:6], own[6:12]
    both, mixed, rates = (basis * one for one in own[12:])
    none, no_force = jnp.zeros_like(both), jnp.zeros_like(offset)

    def row(*blocks: Array) -> Array:
        return jnp.concatenate(blocks, axis=1)

    fixed = jnp.concatenate(
        [
            row(state, offset, no_force, rate),
            row(jnp.swapaxes(offset, 0, 1), both, none, mixed),
            row(jnp.zeros((n, nz, core.shape[-1]), core.dtype)),
            row(jnp.swapaxes(rate, 0, 1), mixed, none, rates),
        ]
    )
    half = jnp.pad(transposed_times(by_acceleration, bent), ((0, 0), (0, nz - 3), (0, 0)))
    return fixed + half + jnp.swapaxes(half, 0, 1)
