"""From a checked `ScenarioSpec` to the arrays of a `Scenario`: geometry of faces, covering discs, default inertia."""

from __future__ import annotations

import math
from typing import NamedTuple

import jax
import jax.numpy as jnp
import numpy as np

from jaxlocomanip.checked import InputError
from jaxlocomanip.planar.dynamics import GRAVITY, Body
from jaxlocomanip.planar.geometry import polygon_distance, rectangle, transform
from jaxlocomanip.robots.model import ROBOT_TYPES, RobotModel, load_robot
from jaxlocomanip.scenario import Goal, ObjectModel, Obstacles, Scenario, Sensing, Team, pad_obstacles
from jaxlocomanip.specification import BOX_FACES, ObjectSpec, ObstacleSpec, RobotSpec, ScenarioSpec

CONTACT_MARGIN = 0.03
"""m, contact points keep at least this far from the ends of their face (half a pusher's width)"""
TEAM_MARGIN = 0.02
"""m, free space that two robots beside each other keep"""


def build(spec: ScenarioSpec, index: int = 0) -> Scenario:
    """Arrays of one scenario.

    Args:
      spec: a checked scenario.
      index: lane number, folded into every random draw.

    Raises:
      InputError: values that are fine alone but not together: a contact offset off its face, two robots in each
        other's way, an obstacle overlapping the start or the goal, an inertia that no body of that mass and centre can
        have.
    """
    polygon = np.array(spec.object.footprint)
    scenario = Scenario(
        object=_object(spec.object, polygon),
        truth=_truth(spec, polygon),
        start=_array(spec.start),
        goal=Goal(_array(spec.goal.pose), _array(spec.goal.position_tolerance), _array(spec.goal.heading_tolerance)),
        team=_team(spec.robots, polygon),
        obstacles=_obstacles(spec.obstacles),
        sensing=Sensing(
            _array(spec.sensing.position_std),
            _array(spec.sensing.heading_std),
            _array(spec.sensing.obstacle_std),
            _array(spec.sensing.command_delay),
        ),
        duration=_array(spec.duration),
        index=jnp.asarray(index, jnp.int32),
    )
    _refuse_overlaps(spec, scenario)
    _refuse_blocked_goal(spec, scenario)
    return scenario


def _array(value: object) -> jax.Array:
    return jnp.asarray(np.asarray(value, dtype=np.float64))


class Moments(NamedTuple):
    """Moments of a footprint under uniform density."""

    centroid: np.ndarray
    """[2] m"""
    radius_of_gyration: float
    """m, about the centroid"""
    mean_radius: float
    """m, mean distance from the centroid: torsional over sliding friction"""


def footprint_moments(polygon: np.ndarray, resolution: int = 200) -> Moments:
    """Moments of a convex polygon [V, 2] by midpoint samples on a grid."""
    low, high = polygon.min(axis=0), polygon.max(axis=0)
    ticks = (np.arange(resolution) + 0.5) / resolution
    grid = low + (high - low) * np.stack(np.meshgrid(ticks, ticks), axis=-1).reshape(-1, 2)
    edges = np.roll(polygon, -1, axis=0) - polygon
    offsets = grid[:, None, :] - polygon[None, :, :]
    inside = grid[(edges[:, 0] * offsets[..., 1] - edges[:, 1] * offsets[..., 0] >= 0.0).all(axis=1)]
    centroid = inside.mean(axis=0)
    radii = np.linalg.norm(inside - centroid, axis=1)
    return Moments(centroid, float(np.sqrt((radii**2).mean())), float(radii.mean()))


def _inertia(given: float | None, mass: float, com: np.ndarray, gyration: float, field: str) -> float:
    """Inertia about p: as given, or that of the footprint filled evenly about its centre of mass."""
    least = mass * float(com @ com)
    if given is None:
        return mass * gyration**2 + least
    if given <= least:
        raise InputError(
            f"{field} = {given:g}: must be > mass |com|^2 = {least:g} kg m^2 (it is about the body point p)"
        )
    return given


def _object(spec: ObjectSpec, polygon: np.ndarray) -> ObjectModel:
    moments = footprint_moments(polygon)
    com = np.array(spec.com)
    force = (spec.friction or 0.0) * spec.mass * GRAVITY
    centers, radii = covering_discs(polygon)
    body = Body(
        _array(spec.mass),
        _array(_inertia(spec.inertia, spec.mass, com, moments.radius_of_gyration, "object.inertia")),
        _array(com),
        _array(force),
        _array(force * moments.mean_radius),
    )
    return ObjectModel(
        vertices=_array(polygon),
        height=_array(spec.height),
        body=body,
        friction_known=jnp.asarray(spec.friction is not None),
        torsion_radius=_array(moments.mean_radius),
        disc_centers=_array(centers),
        disc_radii=_array(radii),
    )


def _truth(spec: ScenarioSpec, polygon: np.ndarray) -> Body:
    truth, belief = spec.truth, spec.object
    moments = footprint_moments(polygon)
    mass = belief.mass if truth.mass is None else truth.mass
    com = np.array(belief.com if truth.com is None else truth.com)
    given = belief.inertia if truth.inertia is None else truth.inertia
    friction = (belief.friction or 0.0) if truth.friction is None else truth.friction
    force = friction * mass * GRAVITY
    inertia = _inertia(given, mass, com, moments.radius_of_gyration, "truth.inertia")
    return Body(_array(mass), _array(inertia), _array(com), _array(force), _array(force * moments.mean_radius))


def covering_discs(polygon: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Few discs, along the longer principal axis, that cover a convex polygon: centres [K, 2], radii [K]."""
    middle = (polygon.max(axis=0) + polygon.min(axis=0)) / 2.0
    _, _, axes = np.linalg.svd(polygon - polygon.mean(axis=0))
    local = (polygon - middle) @ axes.T
    extent = local.max(axis=0) - local.min(axis=0)
    if extent[0] < 1.5 * extent[1]:
        return middle[None], np.array([np.linalg.norm(polygon - middle, axis=1).max()])
    count = min(4, math.ceil(extent[0] / extent[1]))
    width = extent[0] / count
    centers = local.min(axis=0) + np.stack([(np.arange(count) + 0.5) * width, np.full(count, extent[1] / 2.0)], axis=1)
    radius = math.hypot(width, extent[1]) / 2.0
    return middle + centers @ axes, np.full(count, radius)


def _team(robots: tuple[RobotSpec, ...], polygon: np.ndarray) -> Team:
    models = [load_robot(r.type) for r in robots]
    edges = np.roll(polygon, -1, axis=0) - polygon
    lengths = np.linalg.norm(edges, axis=1)
    faces = [BOX_FACES.index(r.face) if isinstance(r.face, str) else r.face for r in robots]
    limits = np.maximum(lengths / 2.0 - CONTACT_MARGIN, 0.0)
    for i, (robot, face) in enumerate(zip(robots, faces, strict=True)):
        if abs(robot.offset) > limits[face]:
            raise InputError(
                f"robots[{i}].offset = {robot.offset:g}: must be within +-{limits[face]:g} m on face {robot.face!r}"
            )
    inward = np.stack([-edges[:, 1], edges[:, 0]], axis=1) / lengths[:, None]
    rows, bounds = _pairs(robots, faces, models, lengths)
    low, high = _free_ranges(np.array([r.offset for r in robots]), limits[faces], rows, bounds)

    def each(name: str) -> jax.Array:
        return _array([getattr(model, name) for model in models])

    return Team(
        kind=jnp.asarray([ROBOT_TYPES.index(r.type) for r in robots], jnp.int32),
        origin=_array([(polygon[f] + edges[f] / 2.0) for f in faces]),
        normal=_array([inward[f] for f in faces]),
        offset=_array([r.offset for r in robots]),
        offset_limit=_array([limits[f] for f in faces]),
        free_low=_array(low),
        free_high=_array(high),
        force_max=each("push_force_max"),
        push_speed_max=each("push_speed_max"),
        slide_speed_max=each("slide_speed_max"),
        reach=each("reach"),
        half_length=each("half_length"),
        half_width=each("half_width"),
        pair_rows=_array(rows),
        pair_bounds=_array(bounds),
    )


def _pairs(
    robots: tuple[RobotSpec, ...], faces: list[int], models: list[RobotModel], lengths: np.ndarray
) -> tuple[np.ndarray, np.ndarray]:
    """Linear conditions rows @ d <= bounds under which robots on one face or around one corner do not touch.

    A robot's offset runs against the polygon's direction. Around a corner, at most one of the two may reach past
    it, and only as far as the other keeps back; that suffices for every convex corner.
    """
    count, edge_count = len(robots), len(lengths)
    rows, bounds = [], []
    for i in range(count):
        for j in range(i + 1, count):
            row, bound = np.zeros(count), 1e3
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


def _free_ranges(
    offset: np.ndarray, limit: np.ndarray, rows: np.ndarray, bounds: np.ndarray
) -> tuple[np.ndarray, np.ndarray]:
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


def _obstacles(specs: tuple[ObstacleSpec, ...]) -> Obstacles:
    corners = max([4, *(len(o.vertices) for o in specs)])
    marks = max([1, *(len(o.motion.times) for o in specs if o.motion)])
    count = len(specs)
    vertices, times, points = (
        np.zeros((count, corners, 2)),
        np.zeros((count, marks)),
        np.zeros((count, marks, 2)),
    )
    amplitude, period = np.zeros((count, 2)), np.ones(count)
    for i, o in enumerate(specs):
        vertices[i] = np.array([*o.vertices, *[o.vertices[-1]] * (corners - len(o.vertices))])
        if o.motion and o.motion.kind == "sine":
            amplitude[i], period[i] = o.motion.amplitude, o.motion.period
        elif o.motion:
            pad = marks - len(o.motion.times)
            times[i] = np.array([*o.motion.times, *[o.motion.times[-1]] * pad])
            points[i] = np.array([*o.motion.points, *[o.motion.points[-1]] * pad]) - np.array(o.position)
    moving = [bool(o.motion) or o.velocity != (0.0, 0.0) for o in specs]
    obstacles = Obstacles(
        vertices=_array(vertices),
        radius=_array([o.radius for o in specs]),
        position=_array(np.array([o.position for o in specs]).reshape(count, 2)),
        velocity=_array(np.array([o.velocity for o in specs]).reshape(count, 2)),
        amplitude=_array(amplitude),
        period=_array(period),
        times=_array(times),
        waypoints=_array(points),
        dynamic=jnp.asarray(np.array(moving, dtype=bool)),
        mask=jnp.ones(count, dtype=bool),
    )
    return pad_obstacles(obstacles, max(count, 1))


def _refuse_overlaps(spec: ScenarioSpec, scenario: Scenario) -> None:
    """Refuse a start at which an obstacle overlaps the object or a robot's body."""
    team, obstacles = scenario.team, scenario.obstacles
    poses = team.robot_poses(scenario.start, team.offset)
    positions = obstacles.at(jnp.zeros(()))
    bodies = [("the object", transform(scenario.start, scenario.object.vertices))]
    for i in range(len(spec.robots)):
        bodies.append((f"robots[{i}]", rectangle(poses[i], team.half_length[i], team.half_width[i])))
    for k in range(len(spec.obstacles)):
        shape = obstacles.vertices[k] + positions[k]
        for name, vertices in bodies:
            distance = float(_distance(vertices, shape, obstacles.radius[k]))
            if distance <= 0.0:
                raise InputError(
                    f"obstacles[{k}].position = {list(spec.obstacles[k].position)}: overlaps {name} at the start by "
                    f"{-distance:.3f} m (must be clear of it)"
                )


def _refuse_blocked_goal(spec: ScenarioSpec, scenario: Scenario) -> None:
    """Refuse a goal that a standing obstacle leaves no room for, whatever the tolerance."""
    obstacles = scenario.obstacles
    body = transform(scenario.goal.pose, scenario.object.vertices)
    for k in range(len(spec.obstacles)):
        shape = obstacles.vertices[k] + obstacles.position[k]
        overlap = -float(_distance(body, shape, obstacles.radius[k]))
        if not bool(obstacles.dynamic[k]) and overlap > spec.goal.position_tolerance:
            raise InputError(
                f"goal.pose = {list(spec.goal.pose)}: obstacles[{k}] overlaps the object there by {overlap:.3f} m "
                f"(at most goal.position_tolerance = {spec.goal.position_tolerance:g} m)"
            )


@jax.jit
def _distance(body: jax.Array, shape: jax.Array, radius: jax.Array) -> jax.Array:
    return polygon_distance(body, 0.0, shape, radius)
