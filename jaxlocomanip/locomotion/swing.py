"""Path of a swinging foot from where it lifted off to where it shall land."""

from __future__ import annotations

import jax.numpy as jnp
from jax import Array

from jaxlocomanip.numerics import Floats


def swing(
    lift_off: Array, target: Array, progress: Array, height: Floats, duration: Floats
) -> tuple[Array, Array, Array]:
    """Position, velocity and acceleration of swinging feet.

    Horizontally a cycloid, vertically a raised cosine on top of a cycloid: at rest at both ends, and at the target's
    height at the end. The target may be moved at any time; the derivatives are those for a target at rest.

    Args:
      lift_off: [4, 3] m.
      target: [4, 3] m.
      progress: [4] in [0, 1].
      height: m, of the apex above the line from lift-off to target.
      duration: s, of the swing.

    Returns:
      Positions [4, 3] m, velocities [4, 3] m/s and accelerations [4, 3] m/s^2.
    """
    speed = 2.0 * jnp.pi / duration
    angle = 2.0 * jnp.pi * progress[:, None]
    sine, cosine = jnp.sin(angle), jnp.cos(angle)
    up = height * jnp.asarray([0.0, 0.0, 1.0], lift_off.dtype)
    way = target - lift_off
    place = lift_off + way * (angle - sine) / (2.0 * jnp.pi) + up * 0.5 * (1.0 - cosine)
    velocity = way * (1.0 - cosine) / duration + up * 0.5 * speed * sine
    acceleration = way * speed * sine / duration + up * 0.5 * speed**2 * cosine
    return place, velocity, acceleration
