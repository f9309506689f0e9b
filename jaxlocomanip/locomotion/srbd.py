"""The robot as a single rigid body that is pushed: 13 states with gravity, and the push as two more.

    angle'    = angular_velocity
    position' = velocity
    angular_velocity' = I^-1 (sum_i r_i x f_i + r_c x F)
    velocity'         = (sum_i f_i + F) / m + gravity
    gravity' = 0,  F' = 0   (F: the push's horizontal part)

Everything is relative to the present pose, in axes that are turned with the present heading: `angle` is the rotation
from level and from the present heading, a vector along those axes; `position` is that of the centre of mass. The arms
r_i of the planned footholds change from step to step, r_c is the arm of the contact point. Between two steps the
right-hand side is a polynomial of degree one in time, so that the zero-order hold is exact in closed form: the third
power of the system matrix is zero.
"""

from __future__ import annotations

import jax.numpy as jnp
from jax import Array

from jaxlocomanip.locomotion.algebra import inverse3, skew
from jaxlocomanip.numerics import Floats, pytree

GRAVITY = 9.81
"""m/s^2"""


@pytree
class PushedBody:
    """Mass, inertia and where forces act."""

    mass: Array
    """[] kg"""
    inertia: Array
    """[3, 3] kg m^2, about the centre of mass"""
    arms: Array
    """[N, 4, 3] m, feet from the centre of mass in each interval"""
    push_arm: Array
    """[3] m, contact point from the centre of mass"""


@pytree
class PushedState:
    """The augmented state, 15 numbers."""

    angle: Array
    """[3] rad"""
    position: Array
    """[3] m"""
    angular_velocity: Array
    """[3] rad/s"""
    velocity: Array
    """[3] m/s"""
    gravity: Array
    """[] m/s^2, along z"""
    push: Array
    """[2] N, horizontal force at the contact point"""


def responses(body: PushedBody) -> Array:
    """[N, 6, 12] angular and linear accelerations per foot force [4 x 3] in each interval."""
    steps = body.arms.shape[0]
    turning = jnp.einsum("ij,nljk->nilk", inverse3(body.inertia), skew(body.arms))
    moving = jnp.broadcast_to(jnp.eye(3, dtype=body.arms.dtype)[:, None, :] / body.mass, turning.shape)
    return jnp.concatenate([turning, moving], axis=1).reshape(steps, 6, 12)


def drift(body: PushedBody, state: PushedState) -> Array:
    """[6] angular and linear acceleration by gravity and the push alone."""
    force = jnp.concatenate([state.push, jnp.zeros_like(state.push[:1])])
    turning = inverse3(body.inertia) @ jnp.cross(body.push_arm, force)
    moving = force / body.mass + state.gravity * jnp.asarray([0.0, 0.0, 1.0], force.dtype)
    return jnp.concatenate([turning, moving])


def hold(steps: int, dt: Floats) -> tuple[Array, Array]:
    """Displacements and speeds [N, N] at the ends of the intervals per unit acceleration within each interval."""
    count = jnp.arange(steps)
    since = (count[:, None] - count[None, :]).astype(jnp.result_type(float))
    acted = since >= 0.0
    return jnp.where(acted, (since + 0.5) * dt**2, 0.0), jnp.where(acted, 1.0, 0.0) * dt


def predict(state: PushedState, acceleration: Array, dt: Floats) -> tuple[Array, Array]:
    """Motion under accelerations [N, 6] held over one interval each.

    Returns:
      [N, 6] angle and position, and [N, 6] their rates, at the ends of the intervals.
    """
    steps = acceleration.shape[0]
    displacement, speed = hold(steps, dt)
    ends = dt * (jnp.arange(steps, dtype=acceleration.dtype)[:, None] + 1.0)
    place = jnp.concatenate([state.angle, state.position])
    rate = jnp.concatenate([state.angular_velocity, state.velocity])
    return place + ends * rate + displacement @ acceleration, rate + speed @ acceleration
