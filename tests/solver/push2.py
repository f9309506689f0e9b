"""The reference problem of the solver: two robots push a box past two obstacles, written out on its own.

It shares nothing with the planner, so that other solvers can be given the same problem.
"""

from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
from jax import Array

from jaxlocomanip.numerics import pytree
from jaxlocomanip.solver.ocp import Penalty, Plan, Stage, forward_model

NORMALS = np.array([[1.0, 0.0], [0.0, 1.0]])
TANGENTS = np.array([[0.0, 1.0], [-1.0, 0.0]])
HELD = np.array([15.0, 15.0, 0.0])
PLACES = np.array([[3.0, 2.0], [2.0, 3.0]])
MASS, INERTIA, HORIZON = 6.0, 1.0, 50


def barrier(h, weight, switch):
    """Relaxed logarithm: -weight ln h, quadratic below the switch."""
    inside, beyond = jnp.maximum(h, switch), (h - 2.0 * switch) / switch
    value = jnp.where(h >= switch, -jnp.log(inside), 0.5 * (beyond**2 - 1.0) - jnp.log(switch))
    slope = jnp.where(h >= switch, -1.0 / inside, beyond / switch)
    return Penalty(weight * value, weight * slope, weight / inside**2)


def turn(theta):
    """Rotation matrix [2, 2]."""
    return jnp.array([[jnp.cos(theta), -jnp.sin(theta)], [jnp.sin(theta), jnp.cos(theta)]])


def slope(x, u):
    """Time derivative of [p, theta, v, omega, d]."""
    points = -0.25 * NORMALS + x[6:, None] * TANGENTS
    force = turn(x[2]) @ (u[:2] @ NORMALS) - HELD[:2]
    moment = jnp.sum(u[:2] * (points[:, 0] * NORMALS[:, 1] - points[:, 1] * NORMALS[:, 0])) - HELD[2]
    return jnp.concatenate([x[3:6], force / MASS, moment[None] / INERTIA, u[2:]])


def object_barriers(x):
    """[2] m, between the object's disc and the obstacles."""
    return jnp.linalg.norm(x[:2] - PLACES, axis=1) - 1.0


def robot_barriers(x):
    """[4] m, between the robots' discs and the obstacles."""
    centers = x[:2] + (turn(x[2]) @ (-0.6 * NORMALS + x[6:, None] * TANGENTS).T).T
    return (jnp.linalg.norm(centers[:, None] - PLACES, axis=2) - 0.9).reshape(-1)


@pytree
class Push2:
    """The reference problem: [51, 6] poses and twists that the object shall have."""

    reference: Array

    @property
    def stages(self) -> Array:
        return self.reference[:-1]

    def stage(self, x: Array, u: Array, data: Array) -> Stage:
        h = 0.1
        k1 = slope(x, u)
        k2 = slope(x + h / 2 * k1, u)
        k3 = slope(x + h / 2 * k2, u)
        following = x + h / 6 * (k1 + 2 * k2 + 2 * k3 + slope(x + h * k3, u))
        field = lambda y: slope(y, u)  # noqa: E731
        rate = lambda barriers: lambda y: jax.jvp(barriers, (y,), (field(y),))[1]  # noqa: E731
        first = rate(object_barriers)
        inequality = jnp.concatenate(
            [
                u[:2],
                70.0 - u[:2],
                0.25 + x[6:],
                0.25 - x[6:],
                1.0 + u[2:],
                1.0 - u[2:],
                rate(first)(x) + 4.0 * first(x) + 4.0 * object_barriers(x),
                rate(robot_barriers)(x) + 4.0 * robot_barriers(x),
            ]
        )
        weights = np.sqrt(0.1 * np.array([20.0, 22.0, 2.0, 3.0, 3.0, 1.0]))
        residual = jnp.concatenate([weights * (x[:6] - data), np.sqrt(0.1) * x[6:], 0.1 * u])
        return Stage(following, jnp.sqrt(h) * residual, inequality)

    def penalty(self, h: Array, data: Array) -> Penalty:
        weight = np.concatenate([np.full(12, 0.1), np.full(6, 0.8)])
        switch = np.concatenate([np.full(12, 0.01), np.full(6, 0.5)])
        return barrier(h, 0.1 * weight, switch)

    def model(self, x: Array, u: Array, data: Array) -> Any:
        return forward_model(self, x, u, data)

    def terminal(self, x: Array) -> Array:
        return np.sqrt(np.array([150.0, 150.0, 3.0, 3.0, 3.0, 8.0])) * (x[:6] - self.reference[-1])


def push2():
    """The problem, half a metre a second along the diagonal, and the plan that solvers start from."""
    line = np.array([1.0, 1.0]) / np.sqrt(2.0)
    along = 0.5 * 0.1 * np.arange(HORIZON + 1)[:, None] * line
    still = np.zeros((HORIZON + 1, 1))
    reference = np.concatenate([along, still, np.tile(0.5 * line, (HORIZON + 1, 1)), still], axis=1)
    guess = Plan(jnp.zeros((HORIZON + 1, 8)), jnp.tile(jnp.array([10.0, 10.0, 0.0, 0.0]), (HORIZON, 1)))
    return Push2(jnp.asarray(reference)), guess
