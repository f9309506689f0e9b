"""From the motion of single discs to states and inputs: Hessian of their weighted conditions (`disc_curvature`).

A disc is moved by eleven variables: position, heading and their velocities and accelerations, and offset and offset
rate of its robot. What all discs contribute to entries of the Hessian by those is summed before the accelerations are
expressed by states and inputs. Arrays have stages last.
"""

from __future__ import annotations

import jax.numpy as jnp
from jax import Array

from jaxlocomanip.numerics import apart, pytree
from jaxlocomanip.planar.vector import Vector
from jaxlocomanip.planner.barriers import DiscMotion
from jaxlocomanip.planner.constraints import Motion
from jaxlocomanip.planner.shapes import ROBOT_DISCS
from jaxlocomanip.solver.layout import added, transposed_times


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


def by_states_and_inputs(
    found: Weighted, moving: DiscMotion, sliding: Array, motion: Motion, by_acceleration: Array
) -> tuple[Array, Array]:
    """Hessian [nz, nz, N] of all discs' weighted conditions, and their gradient [3, N] by the acceleration.

    Args:
      found: derivatives by the motion of each disc.
      moving: that motion.
      sliding: [D, N] m/s, offset rates of the discs' robots.
      motion: of the object and the team.
      by_acceleration: [3, nz, N] derivatives of the acceleration by states and inputs.
    """
    moved = _moved(found, moving, sliding, motion)
    whole, robots = _entries(found, moving, moved, sliding, motion)
    core, own = _summed(whole, robots, motion.offset.shape[0])
    return _hessian(core, own, by_acceleration), core[:3]


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
