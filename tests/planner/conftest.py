"""Random states of a team and its object near two obstacles, for the tests of all inequalities."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from jax import Array

from jaxlocomanip.numerics import pytree, static
from jaxlocomanip.planar import dynamics
from jaxlocomanip.planar.dynamics import Body
from jaxlocomanip.planar.geometry import point_distance, rotate
from jaxlocomanip.planner import barriers
from jaxlocomanip.planner.config import Constraints, PlannerConfig
from jaxlocomanip.planner.constraints import Motion
from jaxlocomanip.planner.shapes import ROBOT_DISCS, Shapes, shapes_of

SMOOTHING = 0.05
OBSTACLES = [
    {"shape": "box", "size": [0.5, 0.7], "position": [2.0, 1.0]},
    {"shape": "circle", "radius": 0.3, "position": [-1.5, 1.5]},
]


@pytree
class Case:
    """A state of a team and its object near two obstacles, with everything the conditions need."""

    shapes: Shapes
    settings: Constraints
    body: Body
    x: Array
    u: Array
    places: Array
    velocity: Array
    smoothing: float = static(SMOOTHING)

    @property
    def affine(self):
        team = self.shapes.team
        return dynamics.control_affine(self.body, team.origin, team.tangent, team.normal, SMOOTHING)

    def field(self, x):
        drift, input_map = self.affine
        return drift(x) + input_map(x) @ self.u

    def motion(self):
        pull = self.field(self.x)[3:6]
        return Motion(self.x[:3], self.x[3:6], pull, self.u[:2], self.x[6:], self.u[2:])

    def conditions(self):
        """Unscaled conditions of the object [K, N_o] and the robots [N_r ROBOT_DISCS, N_o]."""
        seen = barriers.look(self.x[:3], self.x[6:], self.places, self.velocity, self.shapes, self.settings)
        found = barriers.conditions(self.motion(), self.shapes, seen, self.settings) / self.settings.cbf_scale
        count = self.shapes.object_radii.shape[0]
        return found[:count], found[count:]

    def object_barriers(self, x, time=0.0):
        return self._barriers(x, self.shapes.object_centers, self.shapes.object_radii, time)

    def robot_barriers(self, x, time=0.0):
        centers = self.shapes.robot_centers(x[6:]).reshape(-1, 2)
        return self._barriers(x, centers, jnp.repeat(self.shapes.robot_radii, ROBOT_DISCS), time)

    def _barriers(self, x, centers, radii, time):
        places = self.places + time * self.velocity
        vertices, rounding = self.shapes.obstacle_vertices, self.shapes.obstacle_radius
        over = jax.vmap(jax.vmap(point_distance, (0, 0, 0)), (0, None, None))
        points = x[:2] + rotate(x[2], centers)
        gaps = over(points[:, None] - places, vertices, rounding)
        return gaps - radii[:, None] - self.settings.margin


@pytest.fixture
def random_case(make_scenario):
    """A function: random case whose obstacles have the given velocities."""

    def make(seed, velocity):
        rng = np.random.default_rng(seed)
        scenario = make_scenario(object={"size": [0.9, 0.5], "mass": 6.0}, obstacles=OBSTACLES)
        force = rng.uniform(10.0, 40.0)
        body = Body(*map(jnp.asarray, (7.0, 0.8, rng.uniform(-0.05, 0.05, 2), force, 0.2 * force)))
        pose, twist = rng.normal(size=3) * [0.5, 0.5, 1.0], rng.normal(size=3) * [0.5, 0.5, 0.8]
        x = np.concatenate([pose, twist, rng.uniform(-0.1, 0.1, 2)])
        u = np.concatenate([rng.uniform(0.0, 40.0, 2), rng.uniform(-0.3, 0.3, 2)])
        shapes, settings = shapes_of(scenario), PlannerConfig().constraints
        x, u, velocity = jnp.asarray(x), jnp.asarray(u), jnp.asarray(velocity, float)
        return Case(shapes, settings, body, x, u, scenario.obstacles.position, velocity)

    return make
