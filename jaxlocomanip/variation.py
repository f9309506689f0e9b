"""Scenarios in a box around random ones: how an adversary may change what the planner does not choose.

    where = jnp.zeros(dimension(scenario))                     # [d] coordinates, each from -1 to 1
    made = vary(scenario, where, Bounds())                     # a differentiable function of the coordinates
    spec = varied_spec(spec, scenario, where, Bounds())        # the same as a scenario file

Coordinates are, in this order: mass, friction, centre of mass (2), standard deviations of the noise on position,
heading and obstacles, and for each obstacle its displacement (2) and the change of its velocity (2). Standing
obstacles keep standing, those that follow waypoints keep their pace, and absent ones stay absent.
"""

from __future__ import annotations

import dataclasses
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
from jax import Array

from jaxlocomanip import checked
from jaxlocomanip.numerics import pytree
from jaxlocomanip.obstacle_spec import MotionSpec, ObstacleSpec, Point
from jaxlocomanip.planar.dynamics import GRAVITY, Body
from jaxlocomanip.scenario import Scenario
from jaxlocomanip.specification import ScenarioSpec

BODY = 4
"""coordinates of the object"""
NOISE = 3
"""coordinates of the noise"""
DIGITS = 6
"""decimal places of the numbers in a scenario file: micrometres"""

Range = tuple[float, float]


@pytree
class Bounds:
    """The box: ends of each quantity, or its largest change to either side."""

    mass_ratio: Range = (0.5, 2.0)
    """of the true mass to the believed one, on a logarithmic scale"""
    friction: Range = (0.15, 0.6)
    """true Coulomb coefficient"""
    com_offset: float = 0.2
    """share of the footprint's half extent, either way along each axis"""
    position_std: Range = (0.0, 0.01)
    """m"""
    heading_std: Range = (0.0, 0.02)
    """rad"""
    obstacle_std: Range = (0.0, 0.02)
    """m"""
    shift: float = 0.5
    """m, displacement of an obstacle either way along each axis"""
    velocity: float = 0.2
    """m/s, change of a moving obstacle's velocity either way along each axis"""
    start_room: float = 0.05
    """m, that obstacles leave the bodies at the start: less would be no fault of the planner"""


def check_bounds(bounds: Bounds) -> None:
    """The bounds are such that every scenario within them is one.

    Raises:
      InputError: an end or a change that is negative or not finite, ends in the wrong order, or a mass of zero.
    """
    for name in ("mass_ratio", "friction", "position_std", "heading_std", "obstacle_std"):
        ends = checked.pair(f"bounds.{name}", getattr(bounds, name))
        checked.number(f"bounds.{name}[0]", ends[0], 0.0, strictly=name == "mass_ratio")
        checked.number(f"bounds.{name}[1]", ends[1], ends[0])
    checked.number("bounds.com_offset", bounds.com_offset, 0.0, 1.0)
    for name in ("shift", "velocity", "start_room"):
        checked.number(f"bounds.{name}", getattr(bounds, name), 0.0)


@pytree
class Varied:
    """What the coordinates stand for."""

    mass: Array
    friction: Array
    com: Array
    """[2] m"""
    position_std: Array
    heading_std: Array
    obstacle_std: Array
    shift: Array
    """[N_o, 2] m"""
    velocity: Array
    """[N_o, 2] m/s, change"""


def dimension(scenario: Scenario) -> int:
    """Number of coordinates of a scenario without batch axis."""
    return BODY + NOISE + 4 * scenario.obstacles.mask.shape[0]


def quantities(scenario: Scenario, coordinates: Array, bounds: Bounds) -> Varied:
    """The physical quantities at the coordinates [d]."""

    def between(ends: Range, x: Array) -> Array:
        return ends[0] + (ends[1] - ends[0]) * 0.5 * (x + 1.0)

    light, heavy = bounds.mass_ratio
    extent = jnp.max(jnp.abs(scenario.object.vertices), axis=0)
    moves = coordinates[BODY + NOISE :].reshape(-1, 4)
    obstacles = scenario.obstacles
    walking = jnp.any(obstacles.waypoints != 0.0, axis=(1, 2))
    present, faster = obstacles.mask[:, None], (obstacles.mask & obstacles.dynamic & ~walking)[:, None]
    return Varied(
        mass=scenario.object.body.mass * light * (heavy / light) ** (0.5 * (coordinates[0] + 1.0)),
        friction=between(bounds.friction, coordinates[1]),
        com=bounds.com_offset * extent * coordinates[2:4],
        position_std=between(bounds.position_std, coordinates[4]),
        heading_std=between(bounds.heading_std, coordinates[5]),
        obstacle_std=between(bounds.obstacle_std, coordinates[6]),
        shift=jnp.where(present, bounds.shift * moves[:, :2], 0.0),
        velocity=jnp.where(faster, bounds.velocity * moves[:, 2:], 0.0),
    )


def vary(scenario: Scenario, coordinates: Array, bounds: Bounds) -> Scenario:
    """The scenario (without batch axis) at the coordinates [d]; differentiable and to be batched by `jax.vmap`.

    The inertia about the centre of mass stays in proportion to the mass.
    """
    new = quantities(scenario, coordinates, bounds)
    force = new.friction * new.mass * GRAVITY
    inertia = new.mass * (_gyration_squared(scenario) + jnp.sum(new.com**2))
    obstacles, sensing = scenario.obstacles, scenario.sensing
    return dataclasses.replace(
        scenario,
        truth=Body(new.mass, inertia, new.com, force, force * scenario.object.torsion_radius),
        obstacles=dataclasses.replace(
            obstacles, position=obstacles.position + new.shift, velocity=obstacles.velocity + new.velocity
        ),
        sensing=dataclasses.replace(
            sensing,
            position_std=new.position_std,
            heading_std=new.heading_std,
            obstacle_std=new.obstacle_std,
        ),
    )


def varied_spec(spec: ScenarioSpec, scenario: Scenario, coordinates: Any, bounds: Bounds) -> ScenarioSpec:
    """What `vary` makes of a scenario, as a scenario file, with its numbers rounded to `DIGITS` places.

    Args:
      spec: of the scenario.
      scenario: built from it; padding does no harm.
      coordinates: [d].
      bounds: the box.
    """
    new = jax.tree.map(np.asarray, _quantities(scenario, jnp.asarray(coordinates), bounds))
    mass, com = _rounded(new.mass), _pair(new.com)
    inertia = mass * (float(_gyration_squared(scenario)) + com[0] ** 2 + com[1] ** 2)
    return dataclasses.replace(
        spec,
        truth=dataclasses.replace(
            spec.truth, mass=mass, friction=_rounded(new.friction), com=com, inertia=_rounded(inertia)
        ),
        sensing=dataclasses.replace(
            spec.sensing,
            **{name: _rounded(getattr(new, name)) for name in ("position_std", "heading_std", "obstacle_std")},
        ),
        obstacles=tuple(
            _moved(obstacle, _pair(new.shift[k]), _pair(new.velocity[k])) for k, obstacle in enumerate(spec.obstacles)
        ),
    )


_quantities = jax.jit(quantities)


def _gyration_squared(scenario: Scenario) -> Array:
    """[] m^2, central inertia over mass."""
    truth = scenario.truth
    return truth.inertia / truth.mass - (truth.com**2).sum()


def _moved(obstacle: ObstacleSpec, shift: Point, velocity: Point) -> ObstacleSpec:
    return dataclasses.replace(
        obstacle,
        position=_plus(obstacle.position, shift),
        velocity=_plus(obstacle.velocity, velocity),
        motion=None if obstacle.motion is None else _carried(obstacle.motion, shift),
    )


def _carried(motion: MotionSpec, shift: Point) -> MotionSpec:
    # Waypoints are places in the world.
    return dataclasses.replace(motion, points=tuple(_plus(point, shift) for point in motion.points))


def _plus(a: Point, b: Point) -> Point:
    return round(a[0] + b[0], DIGITS), round(a[1] + b[1], DIGITS)


def _pair(value: Any) -> Point:
    return _rounded(value[0]), _rounded(value[1])


def _rounded(value: Any) -> float:
    return round(float(value), DIGITS)
