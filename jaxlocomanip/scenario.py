"""A scenario as arrays: what the planner believes, what the world is, and where to go.

Everything here is a pytree of arrays without batch axis. Obstacles are padded to a fixed count with a mask and
shapes to a fixed number of vertices, so that different layouts stack into one batch (`padding`) and share one
compilation. Scenarios are usually made by `jaxlocomanip.specification`, which checks every value.
"""

from __future__ import annotations

import jax
import jax.numpy as jnp
from jax import Array

from jaxlocomanip.numerics import pytree
from jaxlocomanip.planar.dynamics import Body, body_wrench
from jaxlocomanip.planar.geometry import perpendicular, transform


@pytree
class ObjectModel:
    """The pushed object: its shape, known to everybody, and what the planner believes of its mechanics."""

    vertices: Array
    """[V, 2] m, convex counter-clockwise footprint in the body frame; the last vertex repeats as padding"""
    height: Array
    """[] m"""
    body: Body
    """believed mechanics; friction 0 where unknown"""
    friction_known: Array
    """[] bool: the belief about friction is meant"""
    torsion_radius: Array
    """[] m, M_c / F_c of the footprint under uniform pressure"""
    disc_centers: Array
    """[K, 2] m, discs that cover the footprint, body frame"""
    disc_radii: Array
    """[K] m"""


UNPAIRED = 1e3
"""m, of `Team.pair_bounds` of robots that never come near each other"""


@pytree
class Team:
    """N_r robots, each in contact with one face of the object, heading along its push direction."""

    kind: Array
    """[N_r] int, index into `robots.model.ROBOT_TYPES`"""
    origin: Array
    """[N_r, 2] m, contact point at zero offset (middle of the face), body frame of the object"""
    normal: Array
    """[N_r, 2] unit push direction, into the object"""
    offset: Array
    """[N_r] m, contact offset at the start, along the tangent (normal turned by +90 degrees)"""
    offset_limit: Array
    """[N_r] m, largest |offset|"""
    free_low: Array
    """[N_r] m, offsets in [free_low, free_high] are in nobody's way, whatever the others' offsets in theirs"""
    free_high: Array
    """[N_r] m"""
    force_max: Array
    """[N_r] N, largest push (what the robot's own feet can carry)"""
    push_speed_max: Array
    """[N_r] m/s, largest forward speed while pushing"""
    slide_speed_max: Array
    """[N_r] m/s, largest sideways walking speed"""
    reach: Array
    """[N_r] m, from the contact point back to the centre of the body rectangle"""
    half_length: Array
    """[N_r] m, half the length of the body rectangle"""
    half_width: Array
    """[N_r] m, half its width"""
    pair_rows: Array
    """[P, N_r] robots keep out of each other's way where pair_rows @ offset <= pair_bounds"""
    pair_bounds: Array
    """[P] m"""

    @property
    def tangent(self) -> Array:
        """[N_r, 2] direction of positive offset."""
        return perpendicular(self.normal)

    def contact_points(self, offset: Array) -> Array:
        """[N_r, 2] contact points in the object's frame at the offsets [N_r]."""
        return self.origin + offset[:, None] * self.tangent

    def wrench(self, offset: Array, force: Array) -> Array:
        """[3] N, N, N m, of pushes [N_r] N at the offsets [N_r] m, about p, in the object's frame."""
        return body_wrench(self.contact_points(offset), self.normal, force)

    def robot_poses(self, pose: Array, offset: Array) -> Array:
        """[N_r, 3] poses of the robots' rectangles in the world, for an object pose [3]."""
        centers_B = self.contact_points(offset) - self.reach[:, None] * self.normal
        heading = pose[2] + jnp.arctan2(self.normal[:, 1], self.normal[:, 0])
        return jnp.concatenate([transform(pose, centers_B), heading[:, None]], axis=1)


@pytree
class Formations:
    """F other formations: the team moved on around the object by 1, 2, ... faces, counter-clockwise.

    None (F = 0) where the robots keep their faces.
    """

    team: Team
    """[F, ...]"""
    usable: Array
    """[F] bool: robots fit beside each other there"""


@pytree
class Obstacles:
    """N_o padded obstacles: rounded convex polygons on prescribed paths."""

    vertices: Array
    """[N_o, V, 2] m, in world axes relative to the obstacle's position; a circle repeats the origin"""
    radius: Array
    """[N_o] m, rounding radius (circles: their radius; polygons: 0)"""
    position: Array
    """[N_o, 2] m at t = 0"""
    velocity: Array
    """[N_o, 2] m/s"""
    amplitude: Array
    """[N_o, 2] m, of a sine motion about the position"""
    period: Array
    """[N_o] s, > 0"""
    times: Array
    """[N_o, M] s, increasing; waypoint times (constant where unused)"""
    waypoints: Array
    """[N_o, M, 2] m, displacement from the position, interpolated linearly and held at the ends"""
    dynamic: Array
    """[N_o] bool: may move, and is tracked as such"""
    mask: Array
    """[N_o] bool: exists"""

    def at(self, time: Array) -> Array:
        """[N_o, 2] positions at a time in s."""

        def along(times: Array, points: Array) -> Array:
            return jnp.stack([jnp.interp(time, times, points[:, i]) for i in range(2)])

        sine = self.amplitude * jnp.sin(2.0 * jnp.pi * time / self.period)[:, None]
        return self.position + self.velocity * time + sine + jax.vmap(along)(self.times, self.waypoints)


@pytree
class Goal:
    """Where the object shall come to rest."""

    pose: Array
    """[3] m, m, rad"""
    position_tolerance: Array
    """[] m"""
    heading_tolerance: Array
    """[] rad"""


@pytree
class Sensing:
    """Imperfections of measurement and actuation in the world."""

    position_std: Array
    """[] m, white noise on the object's measured position, per axis and tick"""
    heading_std: Array
    """[] rad"""
    obstacle_std: Array
    """[] m, on each obstacle's measured position"""
    command_delay: Array
    """[] s, between the planner's command and the robots' reaction"""


@pytree
class Scenario:
    """One planning problem and the world it is tried in."""

    object: ObjectModel
    truth: Body
    """the object's true mechanics"""
    start: Array
    """[3] object pose at t = 0"""
    goal: Goal
    team: Team
    """as it begins"""
    formations: Formations
    """which others it may take"""
    obstacles: Obstacles
    sensing: Sensing
    duration: Array
    """[] s"""
    index: Array
    """[] int, the lane's own number: random draws fold it in, so a lane is the same in any batch"""
