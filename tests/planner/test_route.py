"""When obstacles that move are a reason to search a new path."""

import dataclasses

import jax.numpy as jnp
import numpy as np
import pytest

from jaxlocomanip.planner import estimation
from jaxlocomanip.planner.config import Estimation
from jaxlocomanip.planner.estimation import PREDICTED
from jaxlocomanip.planner.route import beset
from jaxlocomanip.planner.shapes import shapes_of


@pytest.mark.parametrize(
    ("distance", "speed", "expected"),
    [
        (1.5, 0.0, True),
        (2.5, 0.0, False),
        (2.5 + 0.5 * PREDICTED, -0.5, False),  # comes no nearer than 2.2 m in that time
        (2.0 + 0.5 * PREDICTED, -0.5, True),
        (1.5, 0.5, True),
        (2.5, 0.5, False),
    ],
)
def test_only_obstacles_that_are_near_or_soon_will_be_matter(make_scenario, distance, speed, expected):
    ahead = np.array([0.6, 0.8])
    obstacle = {
        "shape": "circle",
        "radius": 0.3,
        "velocity": [0.1, 0.0],
        "position": ((distance + 0.3) * ahead).tolist(),
    }
    scenario = make_scenario(obstacles=[obstacle])
    seen = estimation.start_obstacles(scenario.obstacles.position, Estimation())
    seen = dataclasses.replace(seen, velocity=jnp.asarray(speed * ahead)[None])
    shapes = shapes_of(scenario)
    assert bool(beset(scenario.start, shapes, seen)) is expected
    standing = dataclasses.replace(shapes, obstacle_dynamic=jnp.zeros(1, bool))
    assert not bool(beset(scenario.start, standing, seen)), "an obstacle that stands is never a reason"
