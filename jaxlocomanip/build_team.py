"""From checked `RobotSpec`s to the arrays of a `Team`: where each robot stands at its face, and how far it slides."""

from __future__ import annotations

import functools
from collections.abc import Sequence
from dataclasses import replace
from typing import Any

import jax
import numpy as np
from numpy.typing import NDArray

from jaxlocomanip.checked import InputError
from jaxlocomanip.footprint import placed, polygon_gap
from jaxlocomanip.numerics import host_array
from jaxlocomanip.obstacle_spec import Point
from jaxlocomanip.robots.model import ROBOT_TYPES, RobotModel, load_robot
from jaxlocomanip.scenario import UNPAIRED, Formations, Team
from jaxlocomanip.specification import BOX_FACES, RobotSpec, ScenarioSpec

Floats = NDArray[np.floating[Any]]

CONTACT_MARGIN = 0.03
"""m, contact points keep at least this far from the ends of their face (half a pusher's width)"""
TEAM_MARGIN = 0.02
"""m, free space that two robots beside each other keep"""


def face_index(face: str | int) -> int:
    """Index of the edge that a robot's `face` names."""
    return BOX_FACES.index(face) if isinstance(face, str) else face


def inward_normals(polygon: Floats) -> Floats:
    """[V, 2] unit push directions of the faces of a footprint [V, 2]."""
    edges = np.roll(polygon, -1, axis=0) - polygon
    return np.stack([-edges[:, 1], edges[:, 0]], axis=1) / np.linalg.norm(edges, axis=1)[:, None]


def build_team(robots: tuple[RobotSpec, ...], polygon: Floats) -> Team:
    """Robots at the faces of a footprint [V, 2], with NumPy leaves.

    Raises:
      InputError: a contact offset off its face, or two robots in each other's way.
    """
    models = [load_robot(r.type) for r in robots]
    edges = np.roll(polygon, -1, axis=0) - polygon
    lengths = np.linalg.norm(edges, axis=1)
    faces = [face_index(r.face) for r in robots]
    limits = np.maximum(lengths / 2.0 - CONTACT_MARGIN, 0.0)
    for i, (robot, face) in enumerate(zip(robots, faces, strict=True)):
        if abs(robot.offset) > limits[face]:
            raise InputError(
                f"robots[{i}].offset = {robot.offset:g}: must be within +-{limits[face]:g} m on face {robot.face!r}"
            )
    rows, bounds = _pairs(robots, faces, models, lengths)
    _refuse_overlaps(robots, faces, polygon)
    low, high = _free_ranges(np.array([r.offset for r in robots]), limits[faces], rows, bounds)

    kinds: Any = np.array([ROBOT_TYPES.index(r.type) for r in robots], np.int32)

    def each(name: str) -> Any:
        return host_array([getattr(model, name) for model in models])

    return Team(
        kind=kinds,
        origin=host_array(polygon[faces] + edges[faces] / 2.0),
        normal=host_array(inward_normals(polygon)[faces]),
        offset=host_array([r.offset for r in robots]),
        offset_limit=host_array(limits[faces]),
        free_low=host_array(low),
        free_high=host_array(high),
        force_max=each("push_force_max"),
        push_speed_max=each("push_speed_max"),
        slide_speed_max=each("slide_speed_max"),
        reach=each("reach"),
        half_length=each("half_length"),
        half_width=each("half_width"),
        pair_rows=host_array(rows),
        pair_bounds=host_array(bounds),
    )


def build_formations(spec: ScenarioSpec, team: Team, polygon: Floats) -> Formations:
    """The team moved on around the object face by face, if it may."""
    count = len(polygon)
    turned = [
        tuple(replace(robot, face=(face_index(robot.face) + shift) % count) for robot in spec.robots)
        for shift in range(1, count if spec.change_faces else 1)
    ]
    teams, fits = [team], []
    for robots in turned:
        try:
            teams.append(build_team(robots, polygon))
            fits.append(True)
        except InputError:
            # A shorter face than at the start: the robots would not fit at their offsets there.
            teams.append(team)
            fits.append(False)
    usable: Any = np.array(fits, bool)
    return Formations(jax.tree.map(lambda *leaves: np.stack(leaves)[1:], *teams), usable)


def _pairs(
    robots: tuple[RobotSpec, ...], faces: list[int], models: list[RobotModel], lengths: Floats
) -> tuple[Floats, Floats]:
    """Linear conditions rows @ d <= bounds under which robots on one face or around one corner do not touch.

    A robot's offset runs against the polygon's direction. Around a corner, at most one of the two may reach past
    it, and only as far as the other keeps back; that suffices for every convex corner.
    """
    count, edge_count = len(robots), len(lengths)
    rows, bounds = [], []
    for i in range(count):
        for j in range(i + 1, count):
            row, bound = np.zeros(count), UNPAIRED
            widths = models[i].half_width + models[j].half_width + TEAM_MARGIN
            corner = (lengths[faces[i]] + lengths[faces[j]]) / 2.0 - widths
            if faces[i] == faces[j]:
                low, high = (i, j) if robots[i].offset <= robots[j].offset else (j, i)
                row[low], row[high], bound = 1.0, -1.0, -widths
            elif (faces[i] + 1) % edge_count == faces[j]:
                row[i], row[j], bound = -1.0, 1.0, corner
            elif (faces[j] + 1) % edge_count == faces[i]:
                row[j], row[i], bound = -1.0, 1.0, corner
            excess = sum(row[k] * robots[k].offset for k in range(count)) - bound
            if excess > 1e-9:
                raise InputError(f"robots[{i}] and robots[{j}]: overlap by {excess:.3f} m at their contact offsets")
            rows.append(row)
            bounds.append(bound)
    return np.array(rows).reshape(-1, count), np.array(bounds)


def _refuse_overlaps(robots: tuple[RobotSpec, ...], faces: list[int], polygon: Floats) -> None:
    """Robots across an edge so short that they meet beyond it, of which the conditions on pairs know nothing."""
    kinds = tuple((robot.type, face) for robot, face in zip(robots, faces, strict=True))
    footprint = tuple((float(x), float(y)) for x, y in polygon)
    bodies = _local_rectangles(footprint, kinds, tuple(float(robot.offset) for robot in robots))
    overlap = -polygon_gap(bodies[:, None], bodies[None])
    for i, j in zip(*np.triu_indices(len(robots), 1), strict=True):
        if overlap[i, j] > 1e-9:
            raise InputError(f"robots[{i}] and robots[{j}]: overlap by {overlap[i, j]:.3f} m at their contact offsets")


def _free_ranges(offset: Floats, limit: Floats, rows: Floats, bounds: Floats) -> tuple[Floats, Floats]:
    """Each robot's own share of the room in the team: the slack at the start offsets is split evenly."""
    low, high = -limit, limit.copy()
    for row, bound in zip(rows, bounds, strict=True):
        slack = bound - row @ offset
        for i in np.flatnonzero(row):
            edge = offset[i] + row[i] * slack / 2.0
            if row[i] > 0:
                high[i] = min(high[i], edge)
            else:
                low[i] = max(low[i], edge)
    return low, high


def robot_rectangles(spec: ScenarioSpec, pose: Any, offsets: Sequence[float]) -> Floats:
    """[N_r, 4, 2] m, corners of the robots' bodies for an object pose [3] and contact offsets [N_r]."""
    kinds = tuple((robot.type, face_index(robot.face)) for robot in spec.robots)
    return placed(pose, _local_rectangles(spec.object.footprint, kinds, tuple(map(float, offsets))))


@functools.lru_cache(maxsize=4096)
def _local_rectangles(
    footprint: tuple[Point, ...], kinds: tuple[tuple[str, int], ...], offsets: tuple[float, ...]
) -> Floats:
    """Robots' bodies in the object's frame: few of them, asked for many times over in a study."""
    polygon, faces = np.array(footprint), [face for _, face in kinds]
    middle = (polygon[faces] + np.roll(polygon, -1, axis=0)[faces]) / 2.0
    normal = inward_normals(polygon)[faces]
    tangent = np.stack([-normal[:, 1], normal[:, 0]], axis=1)
    models = [load_robot(name) for name, _ in kinds]
    reach, half_length, half_width = (
        np.array([[getattr(model, name)] for model in models]) for name in ("reach", "half_length", "half_width")
    )
    centers = middle + np.array(offsets)[:, None] * tangent - reach * normal
    ahead, aside = half_length * normal, half_width * tangent
    corners = np.stack([-ahead - aside, ahead - aside, ahead + aside, aside - ahead], axis=1)
    return centers[:, None] + corners
