"""The implicit step of friction on an ellipsoidal limit surface, component by component.

In the norm s = |[v_x, v_y, (M_c/F_c) omega]| the minimiser of kinetic distance plus dissipation (see `dynamics`) is
V_i = V_free,i s / (s + d_i) with d_i = h F_c a_i / M_i, a = [1, 1, (M_c/F_c)^2], where s is the root of

    sum_i a_i V_free,i^2 / (s + d_i)^2 = 1,

or zero (sticking) if there is none. The inverse square root of that sum is concave and nearly linear in s, so three
Newton steps from zero reach the root from below.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence

import jax
import jax.numpy as jnp
from jax import Array

from jaxlocomanip.numerics import Floats, pytree, quotient, smooth_positive, tiny

Components = tuple[Array, Array, Array]
"""v_x, v_y and omega at the centre of mass, [...] each"""
NEWTON_STEPS = 3


@pytree
class Drops:
    """What friction takes off a velocity."""

    drop: Components
    """d_i, m/s"""
    ratio: Array
    """(M_c / F_c)^2, m^2"""

    @property
    def shape(self) -> tuple[float, float, Array]:
        """The factors a_i."""
        return 1.0, 1.0, self.ratio


def drops(inertia: Sequence[Array] | Array, force: Array, moment: Array, h: Floats) -> Drops:
    """For inertia [3] at the centre of mass, limits F_c in N and M_c in N m, and a time step in s."""
    # The floors keep 1 / drop^3 within float32 for a frictionless floor.
    force = jnp.maximum(force, 1e-3)
    ratio = (moment / force) ** 2
    floor = 1e-3 * tiny(ratio.dtype)
    x, y, turn = (h * force * a / inertia[i] + floor for i, a in enumerate((1.0, 1.0, ratio)))
    return Drops((x, y, turn), ratio)


def slowed(free: Components, drops: Drops, smoothing: Floats) -> Components:
    """Velocity after friction acted on the free velocity; `smoothing` in m/s widens the transition to rest in s."""
    speed = smooth_positive(_root(_weights(free, drops), drops.drop), smoothing)
    vx, vy, omega = (quotient(v * speed, speed + d) for v, d in zip(free, drops.drop, strict=True))
    return vx, vy, omega


def slowing(
    free: Components, drops: Drops, smoothing: Floats
) -> tuple[Components, Callable[[Array, Array, Array], Components]]:
    """`slowed`, and its derivative: from changes of the free velocity to changes of what is left of it."""
    weights = _weights(free, drops)
    root = _root(weights, drops.drop)
    _, inverses, by_value, by_slope = _step(root, weights, drops.drop)
    slopes = [i * i * (by_value - by_slope * i) for i in inverses]
    speed = smooth_positive(root, smoothing)
    steep = speed / jnp.maximum(jnp.sqrt(root * root + 4.0 * smoothing * smoothing), tiny(root.dtype))
    by_free = [2.0 * a * v * s * steep for a, v, s in zip(drops.shape, free, slopes, strict=True)]
    kept = [speed / (speed + d) for d in drops.drop]
    vx, vy, omega = (v * k for v, k in zip(free, kept, strict=True))

    def derivative(dx: Array, dy: Array, dz: Array) -> Components:
        faster = by_free[0] * dx + by_free[1] * dy + by_free[2] * dz
        x, y, z = (
            k * change + v * d / (speed + d) ** 2 * faster
            for k, change, v, d in zip(kept, (dx, dy, dz), free, drops.drop, strict=True)
        )
        return x, y, z

    return (vx, vy, omega), derivative


def _weights(free: Components, drops: Drops) -> Components:
    floor = tiny(free[0].dtype) ** 2
    a, b, c = (a * v * v + floor for a, v in zip(drops.shape, free, strict=True))
    return a, b, c


@jax.custom_jvp
def _root(weights: Components, drop: Components) -> Array:
    """s of weights w_i and d_i; where the object sticks, a negative number that goes on without a kink."""
    root = jnp.zeros_like(weights[0])
    for _ in range(NEWTON_STEPS):
        root = _step(root, weights, drop)[0]
    return root


@_root.defjvp
def _root_jvp(primals: tuple[Components, Components], tangents: tuple[Components, Components]) -> tuple[Array, Array]:
    """By the implicit function theorem: at the root, a step's derivative by where it begins vanishes.

    Where the object sticks every step begins at zero, and the derivative is that of such a step.
    """
    (weights, drop), (more, further) = primals, tangents
    root = _root(weights, drop)
    _, inverses, by_value, by_slope = _step(root, weights, drop)
    change = jnp.zeros_like(root)
    for w, i, dw, dd in zip(weights, inverses, more, further, strict=True):
        shift = w * i * dd
        change = change + i * i * (by_value * (dw - 2.0 * shift) - by_slope * i * (dw - 3.0 * shift))
    return root, change


def _step(root: Array, weights: Components, drop: Components) -> tuple[Array, list[Array], Array, Array]:
    """A Newton step, the inverses 1 / (s + d_i) where it begins, and its derivatives.

    Those are by the sums over w_i / (s + d_i)^2 and, with the other sign, over w_i / (s + d_i)^3.
    """
    start = jnp.maximum(root, 0.0)
    one = jnp.ones_like(start)
    inverses = [quotient(one, start + d) for d in drop]
    terms = [w * i * i for w, i in zip(weights, inverses, strict=True)]
    thirds = [t * i for t, i in zip(terms, inverses, strict=True)]
    value, flat = terms[0] + terms[1] + terms[2], quotient(one, thirds[0] + thirds[1] + thirds[2])
    size = jnp.sqrt(value)
    move = (size - 1.0) * value * flat
    return start + move, inverses, (1.5 * size - 1.0) * flat, move * flat
