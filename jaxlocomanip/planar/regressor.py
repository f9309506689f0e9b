"""The linear parametrisation Y(q, qd, w, a) Psi of the object's dynamics (paper, "Adaptive controller").

Psi = [m, I, m c_x, m c_y] are the paper's four parameters; two more columns, [F_c, M_c], carry ground friction, which
four inertial parameters cannot represent at constant speed or at rest. H(q) a + C(q, qd) w + f_k = Y Psi.
"""

from __future__ import annotations

import jax.numpy as jnp
from jax import Array

from jaxlocomanip.numerics import Floats, tiny
from jaxlocomanip.planar.dynamics import Body
from jaxlocomanip.planar.geometry import cross, perpendicular, rotate

MASS, INERTIA, MOMENT_X, MOMENT_Y, FRICTION, TORSION = range(6)
"""Positions in the parameter vector Psi [6]: kg, kg m^2, kg m, kg m, N, N m."""


def to_body(psi: Array) -> Body:
    """The rigid body that a parameter vector Psi [6] describes."""
    return Body(psi[MASS], psi[INERTIA], psi[MOMENT_X : MOMENT_Y + 1] / psi[MASS], psi[FRICTION], psi[TORSION])


def from_body(body: Body) -> Array:
    """Psi [6] of a rigid body."""
    return jnp.stack([body.mass, body.inertia, *(body.mass * body.com), body.friction_force, body.friction_moment])


def inertial_regressor(theta: Array, omega: Array, w: Array, a: Array) -> Array:
    """[3, 4] columns of the paper's four parameters.

    Args:
      theta: [] heading, rad.
      omega: [] turning rate, rad/s.
      w: [3] reference velocity qd_r.
      a: [3] reference acceleration qdd_r.
    """
    s, k, zero = jnp.sin(theta), jnp.cos(theta), jnp.zeros_like(theta)
    return jnp.array(
        [
            [a[0], zero, -s * a[2] - k * omega * w[2], -k * a[2] + s * omega * w[2]],
            [a[1], zero, k * a[2] - s * omega * w[2], -s * a[2] - k * omega * w[2]],
            [zero, a[2], -s * a[0] + k * a[1], -k * a[0] - s * a[1]],
        ]
    )


def friction_regressor(theta: Array, com: Array, direction: Array, smoothing: Floats) -> Array:
    """[3, 2] columns of F_c and M_c: friction opposes the twist `direction`, acting at the centre of mass.

    The two limits enter separately here (smoothed directions of translation and of rotation), which keeps the
    parametrisation linear; the coupled limit surface is in `dynamics`.

    Args:
      theta: [] rad.
      com: [2] m, current estimate of the centre of mass, body frame.
      direction: [3] twist at p that friction opposes, m/s and rad/s.
      smoothing: m/s (and rad/s), speed at which friction has about 70 % of its limit.
    """
    arm = rotate(theta, com)
    v = direction[:2] + direction[2] * perpendicular(arm)
    floor = smoothing * smoothing + tiny(v.dtype)
    unit = v / jnp.sqrt(jnp.sum(v * v) + floor)
    spin = direction[2] / jnp.sqrt(direction[2] ** 2 + floor)
    zero = jnp.zeros_like(spin)
    return jnp.stack([jnp.stack([unit[0], unit[1], cross(arm, unit)]), jnp.stack([zero, zero, spin])], axis=1)
