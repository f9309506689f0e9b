"""Which motions a team that can push but not pull can give an object: in which directions, and how tightly it turns.

On a floor with friction the object's centre of mass goes where the sum of the pushes points. Friction is an ellipsoidal
limit surface (`planar.dynamics`), so an object slid by a force f and a moment m about the centre of mass turns by
m / (rho^2 f) rad per metre of the way of that centre, with rho torsional over sliding friction; and |m| / |f| is
bounded unless the pushes can cancel each other and leave a moment.
"""

from __future__ import annotations

import math
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from jaxlocomanip.build_team import CONTACT_MARGIN, face_index, inward_normals
from jaxlocomanip.footprint import footprint_moments
from jaxlocomanip.planar.dynamics import GRAVITY
from jaxlocomanip.robots.model import load_robot
from jaxlocomanip.sampling.layout import push_cone
from jaxlocomanip.specification import ScenarioSpec

Floats = NDArray[np.floating[Any]]


PUSH_RESERVE = 1.05
"""largest push over sliding friction that a team needs at least; with exactly 1 it gets nowhere in finite time"""


class Pushing(NamedTuple):
    """Motions of the centre of mass that a team can push."""

    com: Floats
    """[2] m, true centre of mass in the object's frame"""
    middle: float
    """rad, middle of the directions at heading 0"""
    half: float
    """rad, half the width of the cone of directions"""
    curvature: float
    """rad/m, turn per way, to either side, that it can give an object slid slowly in any of these directions; infinite
    for a team that turns it on the spot"""
    bound: float
    """rad/m, more than which it turns in none of them, not even while it gathers speed or slides to a stop"""
    normals: Floats
    """[N_r, 2] unit push directions in the object's frame"""
    forces: Floats
    """[N_r] N, largest pushes"""
    friction: float
    """N, sliding friction that they have to overcome"""

    def strong(self, angles: Floats) -> NDArray[np.bool_]:
        """[...] whether the team can slide the object in directions at these angles to it, if it can push that way."""
        directions = np.stack([np.cos(angles), np.sin(angles)], axis=-1)
        reached = strength(self.normals, self.forces, directions.reshape(-1, 2)).reshape(angles.shape)
        return reached >= PUSH_RESERVE * self.friction - 1e-9


def pushing(spec: ScenarioSpec) -> Pushing:
    """What the team of a scenario can do with its object as it truly is."""
    com = np.array(spec.object.com if spec.truth.com is None else spec.truth.com)
    polygon = np.array(spec.object.footprint)
    faces = [face_index(robot.face) for robot in spec.robots]
    normals = inward_normals(polygon)[faces]
    low, width = push_cone([math.atan2(y, x) for x, y in normals])
    sure, most = math.inf, math.inf
    # Short of half a turn no pushes cancel each other.
    if width < math.pi - 1e-6:
        origins = (polygon[faces] + np.roll(polygon, -1, axis=0)[faces]) / 2.0 - com
        middles = origins[:, 0] * normals[:, 1] - origins[:, 1] * normals[:, 0]
        sides = middles + offset_limits(spec), offset_limits(spec) - middles
        sure = min(_sure_arm(normals, levers) for levers in sides)
        most = max(_arm(normals, levers) for levers in sides)
    square = footprint_moments(polygon).mean_radius ** 2
    bound = most / square * _inertia_factor(spec, com)
    friction = sliding_friction(spec)
    return Pushing(com, low + 0.5 * width, 0.5 * width, sure / square, bound, *pushes(spec), friction)


def pushes(spec: ScenarioSpec) -> tuple[Floats, Floats]:
    """Push directions [N_r, 2] in the object's frame and largest pushes [N_r] N of a team."""
    faces = [face_index(robot.face) for robot in spec.robots]
    forces = np.array([load_robot(robot.type).push_force_max for robot in spec.robots])
    return inward_normals(np.array(spec.object.footprint))[faces], forces


def sliding_friction(spec: ScenarioSpec) -> float:
    """N, true sliding friction."""
    coefficient = spec.object.friction if spec.truth.friction is None else spec.truth.friction
    mass = spec.object.mass if spec.truth.mass is None else spec.truth.mass
    return (coefficient or 0.0) * mass * GRAVITY


def strength(normals: Floats, forces: Floats, directions: Floats) -> Floats:
    """[n] N, how far the sum of pushes 0 <= f_i <= F_i along normals [N_r, 2] reaches in unit directions [n, 2].

    That sum is a zonotope, which its supporting half-planes m . w <= h(m) bound; those with a side along or across one
    of the normals include all of its faces.
    """
    across = np.stack([-normals[:, 1], normals[:, 0]], axis=1)
    planes = np.concatenate([normals, -normals, across, -across])
    support = np.maximum(planes @ normals.T, 0.0) @ forces
    rate = directions @ planes.T
    rate, support = np.broadcast_arrays(rate, support)
    return np.where(rate > 1e-9, support / np.where(rate > 1e-9, rate, 1.0), np.inf).min(axis=1)


def offset_limits(spec: ScenarioSpec) -> Floats:
    """[N_r] m, largest contact offsets."""
    polygon = np.array(spec.object.footprint)
    lengths = np.linalg.norm(np.roll(polygon, -1, axis=0) - polygon, axis=1)
    return np.maximum(lengths[[face_index(robot.face) for robot in spec.robots]] / 2.0 - CONTACT_MARGIN, 0.0)


def _arm(normals: Floats, levers: Floats) -> float:
    """m, most moment over force of pushes along normals [n, 2] with levers [n]; they span less than half a turn.

    For a given force, the moment is largest with one or two robots (a basic solution of a linear program). With two it
    is g . f, where g . n = lever for both, and largest along g if that lies between the normals.
    """
    best = float(levers.max())
    for i in range(len(levers)):
        for j in range(i):
            (ax, ay), (bx, by) = normals[i], normals[j]
            across = ax * by - ay * bx
            if abs(across) < 1e-9:
                continue
            gx, gy = (levers[i] * by - levers[j] * ay) / across, (ax * levers[j] - bx * levers[i]) / across
            if (gx * by - gy * bx) / across >= 0.0 and (ax * gy - ay * gx) / across >= 0.0:
                best = max(best, math.hypot(gx, gy))
    return max(best, 0.0)


def _sure_arm(normals: Floats, levers: Floats) -> float:
    """m, moment over force that pushes along normals [n, 2] with levers [n] give in every direction between these.

    The most moment for a force is concave in the force, so it is least for its length in one of the outermost
    directions, where only the robots that push that way have a part in it.
    """
    across = normals[:, None, 0] * normals[None, :, 1] - normals[:, None, 1] * normals[None, :, 0]
    ends = [i for i in range(len(normals)) if (across[i] > -1e-9).all() or (across[i] < 1e-9).all()]
    return max(min(float(levers[np.abs(across[i]) < 1e-9].max()) for i in ends), 0.0)


def _inertia_factor(spec: ScenarioSpec, com: Floats) -> float:
    """By which an object whose inertia is spread otherwise than its friction may turn more while its speed changes."""
    moments = footprint_moments(np.array(spec.object.footprint))
    mass = spec.object.mass if spec.truth.mass is None else spec.truth.mass
    inertia = spec.object.inertia if spec.truth.inertia is None else spec.truth.inertia
    friction = moments.mean_radius**2
    spread = moments.radius_of_gyration**2
    if inertia is not None:
        spread = max(inertia / mass - float(com @ com), 0.05 * inertia / mass)
    return max(spread / friction, friction / spread)
