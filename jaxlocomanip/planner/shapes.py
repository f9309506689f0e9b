"""The planner's view of the geometry: discs that cover the object and the robots, and the obstacles' shapes."""

from __future__ import annotations

import jax.numpy as jnp
from jax import Array

from jaxlocomanip.numerics import pytree
from jaxlocomanip.scenario import Scenario, Team

ROBOT_DISCS = 3
"""Discs along a robot's body rectangle."""


@pytree
class Shapes:
    """Everything of a scenario's geometry that the planner knows."""

    team: Team
    object_vertices: Array
    """[V, 2] m, footprint in the body frame"""
    object_centers: Array
    """[K, 2] m, discs covering the object, body frame"""
    object_radii: Array
    """[K] m"""
    torsion_radius: Array
    """[] m, M_c / F_c of the footprint"""
    obstacle_vertices: Array
    """[N_o, V, 2] m, relative to the obstacle's position"""
    obstacle_radius: Array
    """[N_o] m"""
    obstacle_mask: Array
    """[N_o] bool"""
    obstacle_dynamic: Array
    """[N_o] bool"""

    @property
    def robot_radii(self) -> Array:
        """[N_r] m, radius of each of a robot's discs."""
        return rectangle_discs(self.team)[1]

    def robot_centers(self, offset: Array) -> Array:
        """[N_r, ROBOT_DISCS, 2] m, disc centres in the object's frame at contact offsets [N_r]."""
        team = self.team
        back = team.reach[:, None] + rectangle_discs(team)[0]
        return team.contact_points(offset)[:, None, :] - back[..., None] * team.normal[:, None, :]


def rectangle_discs(team: Team) -> tuple[Array, Array]:
    """Discs that cover the robots' body rectangles: places [N_r, ROBOT_DISCS] m behind their centres, radii [N_r] m."""
    fractions = (2.0 * jnp.arange(ROBOT_DISCS) + 1.0) / ROBOT_DISCS - 1.0
    radii = jnp.sqrt((team.half_length / ROBOT_DISCS) ** 2 + team.half_width**2)
    return fractions * team.half_length[:, None], radii


def shapes_of(scenario: Scenario) -> Shapes:
    """The geometry that the planner is told."""
    return Shapes(
        team=scenario.team,
        object_vertices=scenario.object.vertices,
        object_centers=scenario.object.disc_centers,
        object_radii=scenario.object.disc_radii,
        torsion_radius=scenario.object.torsion_radius,
        obstacle_vertices=scenario.obstacles.vertices,
        obstacle_radius=scenario.obstacles.radius,
        obstacle_mask=scenario.obstacles.mask,
        obstacle_dynamic=scenario.obstacles.dynamic,
    )
