"""The relaxed logarithmic barrier of an inequality h >= 0 (paper, "Relaxed barrier penalty"), and its local variant.

A logarithm repels at any distance: with many bodies and obstacles its sum bends every plan and weak tracking drifts
off the path. The local variant subtracts the logarithm's own second-order expansion at a reach h_0, so that it is
exactly zero, with two continuous derivatives, beyond the reach and the same logarithm near h = 0.
"""

from __future__ import annotations

import jax.numpy as jnp
from jax import Array

from jaxlocomanip.numerics import logarithm, quotient
from jaxlocomanip.solver.ocp import Penalty

UNBOUNDED = 1e6
"""A reach from which on the barrier is the plain logarithm."""


def relaxed_barrier(h: Array, weight: Array, switch: Array, reach: Array) -> Penalty:
    """-weight ln h, relaxed below `switch` and, if the reach is finite, zero beyond it; finite for every h.

    With t = h / reach the local barrier is -ln t + (t - 1) - (t - 1)^2 / 2 for t < 1. Below the switch a quadratic
    continues value, slope and curvature.

    Args:
      h: [...] constraint values.
      weight: [...] rho >= 0; 0 switches an inequality off.
      switch: [...] eps > 0, in the units of h.
      reach: [...] h_0 > eps, in the units of h; `UNBOUNDED` or more for the paper's plain logarithm.

    Returns:
      Value, slope and curvature [...], the last >= 0.
    """
    near = jnp.maximum(h, switch)
    # One logarithm and one division a number: both kinds in multiples of their unit, the reach or 1.
    local = reach < UNBOUNDED
    unit = jnp.where(local, reach, 1.0)
    t = jnp.where(local, jnp.minimum(quotient(near, unit), 1.0), near)
    inverse, short = quotient(jnp.ones_like(t), t), jnp.where(local, 1.0 - t, 0.0)
    value = -logarithm(t) - short - 0.5 * short * short
    slope = quotient(jnp.where(local, -short * short, -1.0) * inverse, unit)
    curvature = quotient(inverse * inverse - jnp.where(local, 1.0, 0.0), unit * unit)
    below = h - near
    return Penalty(
        weight * (value + slope * below + 0.5 * curvature * below * below),
        weight * (slope + curvature * below),
        weight * curvature,
    )
