"""Formations: the faces of the object that a team pushes at, and its walk around the object to other ones.

A change of formation turns the team around the object: every robot moves on by the same number of faces, all at once,
in three phases. It steps back from its face until it can turn clear of the object's corners; it circles around the
object, facing it; it steps up to its new face. Robots keep their order and, at any time, at least the angle between
them that they have at one of the two ends, so that they stay out of each other's way. The object stands meanwhile.
"""

from __future__ import annotations

import jax
import jax.numpy as jnp
from jax import Array

from jaxlocomanip.numerics import pytree, safe_norm, select, wrap_angle
from jaxlocomanip.planar.geometry import cross, transform
from jaxlocomanip.scenario import Formations, Scenario, Team

PHASES = 3
"""stepping back, circling, stepping up"""
BACK = 0.05
"""m, between the object's corners and the pushers of circling robots"""
STEP_SPEED = 0.3
"""m/s, to and from a face"""
SETTLING = 0.1
"""s, that each phase takes on top"""
CIRCLING = 0.8
"""of a robot's sideways walking speed, at which it circles"""


@pytree
class Walk:
    """A walk of the whole team around the object, in the object's frame."""

    centre: Array
    """[2] m, of the circle"""
    radius: Array
    """[N_r] m, of the robots' centres while they circle"""
    leaves: Array
    """[N_r, 3] poses at the faces that they leave"""
    reaches: Array
    """[N_r, 3] poses at the faces that they walk to"""
    angle: Array
    """[N_r] rad, polar angle at which each begins to circle"""
    turn: Array
    """[N_r] rad, by which each circles"""
    durations: Array
    """[PHASES] s"""

    def poses(self, phase: Array) -> Array:
        """[N_r, 3] poses in the object's frame at a phase [] in [0, PHASES]."""
        out, around, up = (jnp.clip(phase - k, 0.0, 1.0) for k in range(PHASES))
        angle = self.angle + around * self.turn
        place = self.centre + self.radius[:, None] * jnp.stack([jnp.cos(angle), jnp.sin(angle)], axis=-1)
        # Steps to and from a face are straight; a robot beside its middle turns towards the centre while it circles.
        aside = [wrap_angle(pose[:, 2] - turned - jnp.pi) for pose, turned in self._ends()]
        heading = angle + jnp.pi + (1.0 - around) * aside[0] + around * aside[1]
        stands = jnp.where(around > 0.0, self.reaches[:, :2], self.leaves[:, :2])
        share = jnp.where(around > 0.0, up, 1.0 - out)
        return jnp.concatenate([place + share * (stands - place), heading[:, None]], axis=1)

    def _ends(self) -> tuple[tuple[Array, Array], tuple[Array, Array]]:
        """Pose at the face and polar angle on the circle, at both ends."""
        return (self.leaves, self.angle), (self.reaches, self.angle + self.turn)

    def poses_in_world(self, pose: Array, phase: Array) -> Array:
        """[N_r, 3] poses in the world around an object that stands at `pose` [3]."""
        here = self.poses(phase)
        return jnp.concatenate([transform(pose, here[:, :2]), here[:, 2:] + pose[2]], axis=1)

    def advance(self, phase: Array, period: Array | float) -> Array:
        """[] phase after a period, s."""
        pace = 1.0 / self.durations[jnp.clip(phase.astype(jnp.int32), 0, PHASES - 1)]
        return jnp.minimum(phase + pace * period, float(PHASES))


def count(formations: Formations) -> int:
    """Formations that a team can take, the one that it begins with included."""
    return 1 + formations.usable.shape[-1]


def team_in(team: Team, formations: Formations, formation: Array) -> Team:
    """The team in a formation [] int; 0 is the one that it begins with."""
    if count(formations) == 1:
        return team
    return jax.tree.map(lambda own, others: jnp.concatenate([own[None], others])[formation], team, formations.team)


def usable(formations: Formations) -> Array:
    """[F + 1] bool, formations that may be taken."""
    return jnp.concatenate([jnp.ones(1, bool), formations.usable])


def circle(vertices: Array, team: Team) -> tuple[Array, Array]:
    """Centre [2] m, in the object's frame, and radii [N_r] m of the circles on which a team walks around an object."""
    centre = jnp.mean(vertices, axis=0)
    corners = jnp.max(safe_norm(vertices - centre))
    return centre, corners + BACK + team.reach


def walk_around(
    vertices: Array, leaves: Team, offset: Array, reaches: Team, now: Array, wanted: Array, size: int
) -> Walk:
    """The walk from one formation to another, the shorter way around.

    Args:
      vertices: [V, 2] m, the object's footprint.
      leaves: the team as it stands.
      offset: [N_r] m, its contact offsets.
      reaches: the team as it shall stand, at its first contact offsets.
      now: [] int, formation in which it stands.
      wanted: [] int, formation that it shall take.
      size: number of formations.
    """
    forwards = (wanted - now) % size <= size // 2
    centre, radius = circle(vertices, leaves)
    still = jnp.zeros(3, offset.dtype)
    begin, end = leaves.robot_poses(still, offset), reaches.robot_poses(still, reaches.offset)
    first, out = _straight_back(begin, leaves.normal, centre, radius)
    last, up = _straight_back(end, reaches.normal, centre, radius)
    turn = jnp.where(forwards, (last - first) % (2.0 * jnp.pi), -((first - last) % (2.0 * jnp.pi)))
    circling = CIRCLING * jnp.min(leaves.slide_speed_max / radius)
    steps = jnp.stack([jnp.max(jnp.abs(way)) / STEP_SPEED for way in (out, up)])
    around = jnp.max(jnp.abs(turn)) / circling
    return Walk(centre, radius, begin, end, first, turn, jnp.stack([steps[0], around, steps[1]]) + SETTLING)


def _straight_back(poses: Array, normal: Array, centre: Array, radius: Array) -> tuple[Array, Array]:
    """Polar angles [N_r] at which robots that step straight back reach the circle, and how far that is [N_r] m."""
    off = poses[:, :2] - centre
    ahead, aside = jnp.sum(off * normal, axis=1), cross(normal, off)
    way = ahead + jnp.sqrt(jnp.maximum(radius**2 - aside**2, 0.0))
    there = off - way[:, None] * normal
    return jnp.arctan2(there[:, 1], there[:, 0]), way


@pytree
class Standing:
    """Which formation a team in a world has, or walks to."""

    formation: Array
    """[] int, taken or walked to"""
    left: Array
    """[] int, in which the last walk began"""
    leaving: Array
    """[N_r] m, contact offsets at which it began"""
    phase: Array
    """[] of the walk; `PHASES`: everybody has arrived"""

    @property
    def arrived(self) -> Array:
        """[] bool: nobody walks."""
        return self.phase >= PHASES

    def walk(self, scenario: Scenario) -> Walk:
        """The last walk."""
        leaves, reaches = (team_in(scenario.team, scenario.formations, k) for k in (self.left, self.formation))
        size = count(scenario.formations)
        return walk_around(scenario.object.vertices, leaves, self.leaving, reaches, self.left, self.formation, size)

    def asked(self, wanted: Array | int, offset: Array) -> tuple[Standing, Array]:
        """The team asked to take a formation, from contact offsets [N_r]; and whether it begins to walk, [] bool.

        A team that walks already does not listen.
        """
        wanted = jnp.asarray(wanted, jnp.int32)
        begins = self.arrived & (wanted != self.formation)
        return select(begins, Standing(wanted, self.formation, offset, jnp.zeros_like(self.phase)), self), begins


def standing(team: Team) -> Standing:
    """A team at its first faces."""
    first = jnp.zeros((), jnp.int32)
    return Standing(first, first, team.offset, jnp.full((), float(PHASES), team.offset.dtype))
