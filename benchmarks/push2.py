"""The reference problem `push2`: two robots push a box past two obstacles, written out on its own.

It shares nothing with the planner, so that other solvers can be given the same problem. Variables are z = [p, theta,
v, omega, d, f, ddot]; functions take tuples of components, each an array [...] of stages or of stages and lanes.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import jax.numpy as jnp
import numpy as np
from jax import Array

from jaxlocomanip.numerics import pytree, sine_and_cosine
from jaxlocomanip.solver.ocp import Penalty, Plan, Stage, StageModel, forward_model

MASS, INERTIA, HORIZON, DT = 6.0, 1.0, 50, 0.1
HELD = (15.0, 15.0, 0.0)
"""N, N, Nm: wrench that is held against the pushes"""
PLACES = np.array([[3.0, 2.0], [2.0, 3.0]])
NX, NZ = 8, 12
STAGE = np.array([2.0, 2.2, 0.2, 0.3, 0.3, 0.1, 0.1, 0.1, 0.01, 0.01, 0.01, 0.01])
FINAL = np.array([150.0, 150.0, 3.0, 3.0, 3.0, 8.0])
"""quadratic weights"""
BOUNDS = (0.1, 0.01)
BARRIERS = (0.8, 0.5)
"""weight and switch of the relaxed logarithms"""
Components = Array | Sequence[Array]
"""components [...] one by one, or as an array [n, ...]"""


def barrier(h: Array, weight: Any, switch: Any) -> Penalty:
    """Relaxed logarithm: -weight ln h, quadratic below the switch."""
    inside, beyond = jnp.maximum(h, switch), (h - 2.0 * switch) / switch
    value = jnp.where(h >= switch, -jnp.log(inside), 0.5 * (beyond**2 - 1.0) - np.log(switch))
    slope = jnp.where(h >= switch, -1.0 / inside, beyond / switch)
    return Penalty(weight * value, weight * slope, weight / inside**2)


def slope(z: Components) -> tuple[Array, ...]:
    """Time derivatives of z; inputs are held."""
    _, _, theta, vx, vy, omega, d1, d2, f1, f2, rate1, rate2 = z
    sine, cosine = sine_and_cosine(theta)
    ax = (cosine * f1 - sine * f2 - HELD[0]) / MASS
    ay = (sine * f1 + cosine * f2 - HELD[1]) / MASS
    return vx, vy, omega, ax, ay, (-d1 * f1 - d2 * f2 - HELD[2]) / INERTIA, rate1, rate2


def step(z: Components) -> tuple[Array, ...]:
    """Next states, by one step of the classical Runge-Kutta method."""

    def ahead(rates: tuple[Array, ...], time: float) -> list[Array]:
        return [*(x + time * rate for x, rate in zip(z, rates, strict=False)), *z[NX:]]

    k1 = slope(z)
    k2 = slope(ahead(k1, DT / 2))
    k3 = slope(ahead(k2, DT / 2))
    k4 = slope(ahead(k3, DT))
    return tuple(x + DT / 6 * (a + 2.0 * b + 2.0 * c + d) for x, a, b, c, d in zip(z, k1, k2, k3, k4, strict=False))


def conditions(z: Components, places: Array) -> tuple[Array, ...]:
    """Barrier conditions of the object and the two robots past obstacles at `places` [2, 2, ...], in that order."""
    px, py, theta, vx, vy, omega, d1, d2, _, _, rate1, rate2 = z
    _, _, _, ax, ay, *_ = slope(z)
    sine, cosine = sine_and_cosine(theta)
    rows = []
    for ox, oy in places:
        distance, nx, ny = _line(px - ox, py - oy)
        closing, passing = nx * vx + ny * vy, nx * vy - ny * vx
        second = nx * ax + ny * ay + passing * passing / distance
        rows.append(second + 4.0 * closing + 4.0 * (distance - 1.0))
    first = (-0.6 * cosine - sine * d1, -0.6 * sine + cosine * d1, -sine * rate1, cosine * rate1)
    other = (0.6 * sine - cosine * d2, -0.6 * cosine - sine * d2, -cosine * rate2, -sine * rate2)
    for ox, oy in places:
        for arm_x, arm_y, slide_x, slide_y in (first, other):
            distance, nx, ny = _line(px + arm_x - ox, py + arm_y - oy)
            closing = nx * (vx - omega * arm_y + slide_x) + ny * (vy + omega * arm_x + slide_y)
            rows.append(closing + 4.0 * (distance - 0.9))
    return tuple(rows)


def _line(x: Array, y: Array) -> tuple[Array, Array, Array]:
    distance = jnp.sqrt(x * x + y * y)
    return distance, x / distance, y / distance


def bounds(z: Array) -> Array:
    """[12, ...] room to the bounds of forces, offsets and rates, of z [12, ...]."""
    offset, force, rate = z[6:8], z[8:10], z[10:12]
    return jnp.concatenate([offset + 0.25, force, rate + 1.0, 0.25 - offset, 70.0 - force, 1.0 - rate])


def error(z: Array, reference: Array) -> Array:
    """[12, ...] what the quadratic weights act on."""
    return jnp.concatenate([z[:6] - reference, z[6:]])


@pytree
class Push2:
    """The problem; implements `solver.ocp.Problem` as plainly as it can be (but see `push2_model`)."""

    reference: Array
    """[N + 1, 6] poses and twists that the object shall have"""
    places: Array
    """[2, 2] m, of the obstacles"""

    @property
    def stages(self) -> Array:
        """Reference [N, 6] of each stage."""
        return self.reference[:-1]

    def stage(self, x: Array, u: Array, data: Array) -> Stage:
        """One stage."""
        z = jnp.concatenate([x, u])
        rows = jnp.concatenate([bounds(z), jnp.stack(conditions(z, self.places))])
        return Stage(jnp.stack(step(z)), jnp.sqrt(DT * STAGE) * error(z, data), rows)

    def penalty(self, h: Array, data: Array) -> Penalty:
        """Of the bounds and the conditions."""
        del data
        weight, switch = (np.repeat([a, b], [NZ, 6]) for a, b in zip(BOUNDS, BARRIERS, strict=True))
        return barrier(h, DT * weight, switch)

    def model(self, x: Array, u: Array, data: Array) -> StageModel:
        """Of one stage."""
        return forward_model(self, x, u, data)

    def terminal(self, x: Array) -> Array:
        """Weighted errors [6] at the end."""
        return jnp.sqrt(FINAL) * (x[:6] - self.reference[-1])


def push2() -> tuple[Push2, Plan]:
    """The problem, half a metre a second along the diagonal, and the plan that solvers start from."""
    line = np.array([1.0, 1.0]) / np.sqrt(2.0)
    along = 0.5 * DT * np.arange(HORIZON + 1)[:, None] * line
    still = np.zeros((HORIZON + 1, 1))
    reference = np.concatenate([along, still, np.tile(0.5 * line, (HORIZON + 1, 1)), still], axis=1)
    guess = Plan(jnp.zeros((HORIZON + 1, NX)), jnp.tile(jnp.array([10.0, 10.0, 0.0, 0.0]), (HORIZON, 1)))
    return Push2(jnp.asarray(reference), jnp.asarray(PLACES)), guess
