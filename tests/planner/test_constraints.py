"""Barrier conditions against Lie derivatives by forward differentiation and against simulated trajectories."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from jax import Array

from jaxlocomanip.numerics import pytree
from jaxlocomanip.planar import dynamics
from jaxlocomanip.planar.dynamics import Body, lie_derivative
from jaxlocomanip.planar.geometry import point_distance, rotate
from jaxlocomanip.planner import constraints
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
        seen = constraints.look(self.x[:3], self.x[6:], self.places, self.velocity, self.shapes, self.settings.margin)
        args = self.motion(), self.shapes, seen, self.settings
        scale, count = self.settings.cbf_scale, self.places.shape[0]
        objects = constraints.object_conditions(*args).reshape(-1, count) / scale
        return objects, constraints.robot_conditions(*args).reshape(-1, count) / scale

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


found_conditions = jax.jit(Case.conditions)


@jax.jit
def by_lie_derivatives(case):
    """Conditions of object and robots, and how the barriers' first derivatives feel the inputs."""
    (drift, input_map), settings, x = case.affine, case.settings, case.x
    first = lie_derivative(case.object_barriers, drift)
    second = lie_derivative(first, drift)
    early = jax.jacfwd(case.object_barriers)(x) @ input_map(x)
    late = jax.jacfwd(first)(x) @ input_map(x)
    barrier, slope = case.object_barriers(x), first(x)
    objects = second(x) + late @ case.u + settings.object_beta * slope + settings.object_alpha * barrier
    felt = jax.jacfwd(case.robot_barriers)(x) @ input_map(x)
    slope = lie_derivative(case.robot_barriers, drift)(x) + felt @ case.u
    robots = slope + settings.robot_alpha * case.robot_barriers(x)
    return objects, robots, early, late, felt


@pytest.mark.parametrize("seed", range(4))
def test_conditions_are_lie_derivatives_for_obstacles_at_rest(x64, random_case, seed):
    case = random_case(seed, np.zeros((2, 2)))
    objects, robots, early, late, felt = by_lie_derivatives(case)
    found = found_conditions(case)
    assert np.allclose(found[0], objects, rtol=0.0, atol=1e-9)
    assert np.allclose(found[1], robots, rtol=0.0, atol=1e-9)
    assert np.abs(early).max() == 0.0  # relative degree 2: the object's barrier feels pushes
    assert np.abs(late[..., :2]).max() > 1e-3  # in its second derivative only
    assert np.abs(felt[..., 2:]).max() > 1e-3  # relative degree 1: a robot's barrier feels its sliding at once


@jax.jit
def by_differences(case, h):
    """Conditions of object and robots from barrier values shortly before, at, and after now."""

    def flow(span):
        """State a time later, or earlier, along the trajectory through x."""
        k1 = case.field(case.x)
        k2 = case.field(case.x + span / 2 * k1)
        k3 = case.field(case.x + span / 2 * k2)
        return case.x + span / 6 * (k1 + 2 * k2 + 2 * k3 + case.field(case.x + span * k3))

    before, after, settings = flow(-h), flow(h), case.settings

    def derivatives(barriers):
        low, here, high = barriers(before, -h), barriers(case.x), barriers(after, h)
        return here, (high - low) / (2 * h), (high - 2 * here + low) / h**2

    here, slope, curvature = derivatives(case.object_barriers)
    objects = curvature + settings.object_beta * slope + settings.object_alpha * here
    here, slope, _ = derivatives(case.robot_barriers)
    return objects, slope + settings.robot_alpha * here


@pytest.mark.parametrize("seed", range(4))
def test_conditions_are_time_derivatives_along_trajectories_past_moving_obstacles(x64, random_case, seed):
    case = random_case(seed, [[0.4, -0.3], [-0.2, 0.5]])
    for found, expected in zip(found_conditions(case), by_differences(case, 1e-4), strict=True):
        assert np.allclose(found, expected, rtol=0.0, atol=1e-5 * (1.0 + np.abs(expected).max()))


def test_lyapunov_condition_is_the_decrease_of_the_composite_error(x64, random_case):
    """With V = 1/2 s' H s, the condition is -V' - 1/2 s' K_D s along the model's motion."""
    case = random_case(7, np.zeros((2, 2)))
    settings, body = case.settings, case.body
    pose, twist = case.x[:3], case.x[3:6]
    target, target_twist = pose + jnp.array([0.2, -0.1, 0.3]), jnp.array([0.3, 0.1, -0.2])
    points = case.shapes.team.contact_points(case.x[6:])
    wrench = dynamics.contact_wrench(pose[2], points, case.shapes.team.normal, case.u[:2])
    found = constraints.lyapunov_condition(pose, twist, wrench, body, target, target_twist, settings, SMOOTHING)
    rate = settings.clf_rate

    def energy(t):
        """V a time t later, to first order; the target moves at constant velocity."""
        pull = dynamics.acceleration(body, pose[2], twist, wrench, SMOOTHING)
        q, v = pose + t * twist, twist + t * pull
        s = v - target_twist + rate * (q - target - t * target_twist)
        return 0.5 * s @ dynamics.mass_matrix(body, q[2]) @ s, s

    (_, s), (slope, _) = jax.jit(lambda: jax.jvp(energy, (0.0,), (1.0,)))()
    expected = -slope - 0.5 * settings.clf_gain * s @ s
    assert found == pytest.approx(float(expected / (1.0 + settings.clf_normalised * jnp.linalg.norm(s))), rel=1e-9)


def test_bounds_are_zero_at_the_limits_and_positive_between(x64, random_case):
    case = random_case(0, np.zeros((2, 2)))
    team, zero = case.shapes.team, jnp.zeros(2)

    def bounds(force, offset, rate):
        return constraints.bounds(Motion(zero, zero, zero, force, offset, rate), case.shapes)

    force, offset, rate, room = bounds(0.5 * team.force_max, zero, zero)
    assert all((np.asarray(h) > 0.0).all() for h in (force, offset, rate))
    assert room.shape == (1,)
    force, offset, rate, _ = bounds(team.force_max, team.offset_limit, -team.slide_speed_max)
    assert np.allclose(force[2:], 0.0) and np.allclose(offset[2:], 0.0) and np.allclose(rate[:2], 0.0)
    force, offset, rate, _ = bounds(-jnp.ones(2), -1.5 * team.offset_limit, 2.0 * team.slide_speed_max)
    assert (force[:2] < 0.0).all() and (offset[:2] < 0.0).all() and (rate[2:] < 0.0).all()
