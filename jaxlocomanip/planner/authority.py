"""What wrenches a team of push-only robots can exert, and how it best shares one.

A robot that may choose its contact offset pushes like two at the ends of its range, so the team's wrenches form a
convex cone and "can the object be slid along this twist" is a small non-negative least-squares problem.
"""

from __future__ import annotations

from collections.abc import Callable

import jax
import jax.numpy as jnp
from jax import Array

from jaxlocomanip.numerics import Floats, projected_least_squares, tiny
from jaxlocomanip.planar.dynamics import Body, friction_wrench
from jaxlocomanip.planar.geometry import cross
from jaxlocomanip.scenario import Team

USABLE_RANGE = 0.8
"""Fraction of a robot's own offset range that feed-forward uses; the rest is left to feedback."""


CAPACITY = 0.95
"""fraction of a robot's largest push that paths count on"""


def sliding_wrench(body: Body, twist_B: Array, smoothing: Floats) -> Array:
    """Wrench [3] about p in body axes that slides the object steadily along a twist [3] in body axes."""
    zero = jnp.zeros((), twist_B.dtype)
    return friction_wrench(body, zero, twist_B, smoothing)


def usable_offsets(team: Team) -> Array:
    """[N_r] m, largest contact offsets that feed-forward uses where the robots keep out of each other's way."""
    return USABLE_RANGE * team.offset_limit


def offset_ends(team: Team) -> Array:
    """[2, N_r] m, ends of the contact offsets that feed-forward uses."""
    middle, half = 0.5 * (team.free_low + team.free_high), 0.5 * (team.free_high - team.free_low)
    return middle + USABLE_RANGE * jnp.stack([-half, half])


def within_limits(limit: Array) -> Callable[[Array], Array]:
    """Projection of pushes [2 N_r] at the ends of the ranges, ends first: nobody pulls, or pushes beyond its limit."""

    def project(pushes: Array) -> Array:
        two = jnp.maximum(pushes.reshape(2, -1), 0.0)
        excess = jnp.maximum(jnp.sum(two, axis=0) - limit, 0.0)
        return jnp.minimum(jnp.maximum(two - 0.5 * excess, 0.0), limit).reshape(-1)

    return project


def share(team: Team, wrench_B: Array, radius: Floats, limit: Array) -> tuple[Array, Array, Array]:
    """Split a wrench among the team.

    Args:
      team: the robots.
      wrench_B: [3] wanted, about p, body axes.
      radius: m, length that makes moments comparable to forces.
      limit: [N_r] N, largest push of each robot.

    Returns:
      forces [N_r] >= 0, moment arms as offsets [N_r] (0 where a force is 0), and the relative residual [] (0: exact).
    """
    ends = offset_ends(team)
    points = team.origin + ends[..., None] * team.tangent
    arms = cross(points, jnp.broadcast_to(team.normal, points.shape)) / radius
    normals = jnp.broadcast_to(team.normal, points.shape)
    matrix = jnp.concatenate([normals, arms[..., None]], axis=-1).reshape(-1, 3).T
    target = jnp.concatenate([wrench_B[:2], wrench_B[2:] / radius])
    scale = jnp.sqrt(jnp.sum(target**2)) + tiny(target.dtype)
    split = projected_least_squares(matrix, target / scale, within_limits(limit / scale)).reshape(2, -1)
    residual = jnp.sqrt(jnp.sum((matrix @ split.reshape(-1) - target / scale) ** 2))
    total = jnp.sum(split, axis=0)
    offsets = jnp.sum(split * ends, axis=0) / (total + 1e-3)
    return total * scale, offsets, residual


def pushability(team: Team, body: Body, twists_B: Array, radius: Floats) -> Array:
    """[n] relative residual of the friction wrench of each twist [n, 3] (body axes): 0 where the team can push so."""

    def one(twist: Array) -> Array:
        return share(team, sliding_wrench(body, twist, 0.0), radius, CAPACITY * team.force_max)[2]

    return jax.vmap(one)(twists_B)
