"""The relaxed logarithmic barrier of an inequality h >= 0 (paper, "Relaxed barrier penalty")."""

from __future__ import annotations

import jax.numpy as jnp
from jax import Array

from jaxlocomanip.solver.ocp import Penalty


def relaxed_barrier(h: Array, weight: Array, switch: Array) -> Penalty:
    """-weight ln h where h >= switch, and its quadratic C2 continuation below; finite for every h.

    Args:
      h: [...] constraint values.
      weight: [...] rho >= 0; 0 switches an inequality off.
      switch: [...] eps > 0, in the units of h.

    Returns:
      Value, slope and curvature [...], the last > 0 where weight > 0.
    """
    inside = jnp.maximum(h, switch)
    beyond = (h - 2.0 * switch) / switch
    log = h >= switch
    value = jnp.where(log, -jnp.log(inside), 0.5 * (beyond**2 - 1.0) - jnp.log(switch))
    slope = jnp.where(log, -1.0 / inside, beyond / switch)
    curvature = 1.0 / inside**2
    return Penalty(weight * value, weight * slope, weight * curvature)
