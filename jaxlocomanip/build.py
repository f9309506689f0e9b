"""From a checked `ScenarioSpec` to the arrays of a `Scenario`: geometry of faces, covering discs, default inertia.

Everything is computed by NumPy in double precision and put on the device at the very end, so that thousands of
scenarios are built in seconds; `build_on_host` leaves out that last step.
"""

from __future__ import annotations

from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
from numpy.typing import NDArray

from jaxlocomanip.build_team import build_formations, build_team, robot_rectangles
from jaxlocomanip.checked import InputError
from jaxlocomanip.footprint import covering_discs, footprint_moments, padded, placed, polygon_gap
from jaxlocomanip.numerics import host_array
from jaxlocomanip.obstacles import corners_at, moves, obstacle_arrays
from jaxlocomanip.planar.dynamics import GRAVITY, Body
from jaxlocomanip.scenario import Goal, ObjectModel, Scenario, Sensing
from jaxlocomanip.specification import ObjectSpec, ScenarioSpec

Floats = NDArray[np.floating[Any]]


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
    return jax.tree.map(jnp.asarray, build_on_host(spec, index))


def build_on_host(spec: ScenarioSpec, index: int = 0) -> Scenario:
    """`build` with NumPy leaves of the same values and types, for `padding.stack` to put on the device at once.

    Raises:
      InputError: as `build`.
    """
    polygon = np.array(spec.object.footprint)
    team = build_team(spec.robots, polygon)
    scenario = Scenario(
        object=_object(spec.object, polygon),
        truth=_truth(spec, polygon),
        start=host_array(spec.start),
        goal=Goal(
            host_array(spec.goal.pose),
            host_array(spec.goal.position_tolerance),
            host_array(spec.goal.heading_tolerance),
        ),
        team=team,
        formations=build_formations(spec, team, polygon),
        obstacles=obstacle_arrays(spec.obstacles),
        sensing=Sensing(
            host_array(spec.sensing.position_std),
            host_array(spec.sensing.heading_std),
            host_array(spec.sensing.obstacle_std),
            host_array(spec.sensing.command_delay),
        ),
        duration=host_array(spec.duration),
        index=_of(index, np.int32),
    )
    _refuse_overlaps(spec)
    _refuse_blocked_goal(spec)
    return scenario


def _of(value: object, dtype: Any) -> Any:
    return np.asarray(value, dtype=dtype)


def _inertia(given: float | None, mass: float, com: Floats, gyration: float, field: str) -> float:
    """Inertia about p: as given, or that of the footprint filled evenly about its centre of mass."""
    least = mass * float(com @ com)
    if given is None:
        return mass * gyration**2 + least
    if given <= least:
        raise InputError(
            f"{field} = {given:g}: must be > mass |com|^2 = {least:g} kg m^2 (it is about the body point p)"
        )
    return given


def _object(spec: ObjectSpec, polygon: Floats) -> ObjectModel:
    moments = footprint_moments(polygon)
    com = np.array(spec.com)
    force = (spec.friction or 0.0) * spec.mass * GRAVITY
    centers, radii = covering_discs(polygon)
    body = Body(
        host_array(spec.mass),
        host_array(_inertia(spec.inertia, spec.mass, com, moments.radius_of_gyration, "object.inertia")),
        host_array(com),
        host_array(force),
        host_array(force * moments.mean_radius),
    )
    return ObjectModel(
        vertices=host_array(polygon),
        height=host_array(spec.height),
        body=body,
        friction_known=_of(spec.friction is not None, bool),
        torsion_radius=host_array(moments.mean_radius),
        disc_centers=host_array(centers),
        disc_radii=host_array(radii),
    )


def _truth(spec: ScenarioSpec, polygon: Floats) -> Body:
    truth, belief = spec.truth, spec.object
    moments = footprint_moments(polygon)
    mass = belief.mass if truth.mass is None else truth.mass
    com = np.array(belief.com if truth.com is None else truth.com)
    given = belief.inertia if truth.inertia is None else truth.inertia
    friction = (belief.friction or 0.0) if truth.friction is None else truth.friction
    force = friction * mass * GRAVITY
    inertia = _inertia(given, mass, com, moments.radius_of_gyration, "truth.inertia")
    return Body(
        host_array(mass),
        host_array(inertia),
        host_array(com),
        host_array(force),
        host_array(force * moments.mean_radius),
    )


def start_gaps(spec: ScenarioSpec) -> NDArray[np.floating[Any]]:
    """[N_o, 1 + N_r] m, signed distances of the obstacles to the object and the robots' bodies at the start."""
    if not spec.obstacles:
        return np.zeros((0, 1 + len(spec.robots)))
    robots = robot_rectangles(spec, spec.start, [robot.offset for robot in spec.robots])
    bodies = padded([placed(spec.start, np.array(spec.object.footprint)), *robots])
    shapes = padded([corners_at(obstacle, 0.0) for obstacle in spec.obstacles])
    return polygon_gap(bodies[None], shapes[:, None], np.array([[o.radius] for o in spec.obstacles]))


def _refuse_overlaps(spec: ScenarioSpec) -> None:
    """Refuse a start at which an obstacle overlaps the object or a robot's body."""
    gaps = start_gaps(spec)
    for k, i in np.argwhere(gaps <= 0.0):
        name = f"robots[{i - 1}]" if i else "the object"
        raise InputError(
            f"obstacles[{k}].position = {list(spec.obstacles[k].position)}: overlaps {name} at the start by "
            f"{-gaps[k, i]:.3f} m (must be clear of it)"
        )


def _refuse_blocked_goal(spec: ScenarioSpec) -> None:
    """Refuse a goal that a standing obstacle leaves no room for, whatever the tolerance."""
    if not spec.obstacles:
        return
    body = placed(spec.goal.pose, np.array(spec.object.footprint))
    shapes = padded([corners_at(obstacle, 0.0) for obstacle in spec.obstacles])
    overlaps = -polygon_gap(body[None], shapes, np.array([o.radius for o in spec.obstacles]))
    for k, overlap in enumerate(overlaps):
        if not moves(spec.obstacles[k]) and overlap > spec.goal.position_tolerance:
            raise InputError(
                f"goal.pose = {list(spec.goal.pose)}: obstacles[{k}] overlaps the object there by {overlap:.3f} m "
                f"(at most goal.position_tolerance = {spec.goal.position_tolerance:g} m)"
            )
