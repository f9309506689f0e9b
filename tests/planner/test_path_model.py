"""All stages of a path's problem at once equal the stage, differentiated forwards."""

import dataclasses
from functools import partial

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from jaxlocomanip.planner import adaptation
from jaxlocomanip.planner.config import PlannerConfig
from jaxlocomanip.planner.estimation import ObstacleEstimate
from jaxlocomanip.planner.quasistatic import PathProblem, PathStage, friction_of
from jaxlocomanip.planner.shapes import shapes_of
from jaxlocomanip.solver.ocp import Plan, forward_model, stage_cost

STEPS = 12
CONFIG = PlannerConfig()
FACES = {1: ("-x",), 2: ("-x", "-y"), 4: ("-x", "-y", "+x", "+y")}
OBSTACLES = [
    {"shape": "box", "size": [0.5, 0.7], "position": [1.5, 1.0]},
    {"shape": "circle", "radius": 0.3, "position": [-1.3, 0.9]},
]


@pytest.fixture(params=[pytest.param(n, marks=[] if n == 2 else pytest.mark.slow, id=f"{n} robots") for n in FACES])
def given(request, x64, make_scenario):
    """A problem among an obstacle that stands and one that moves, and random poses, offsets, pushes and walks."""
    rng, n = np.random.default_rng(0), request.param
    robots = [{"type": "aliengo", "face": face} for face in FACES[n]]
    scenario = make_scenario(object={"size": [0.9, 0.8], "mass": 6.0}, robots=robots, obstacles=OBSTACLES)
    shapes = dataclasses.replace(shapes_of(scenario), obstacle_dynamic=jnp.array([False, True]))
    body = adaptation.start(scenario.object, CONFIG.adaptation).body
    body = dataclasses.replace(body, com=jnp.array([0.04, -0.03]))
    guess, turning = rng.uniform(-1.0, 2.0, (STEPS, 3)), rng.uniform(0.6, 1.5, STEPS)
    stages = PathStage(*map(jnp.asarray, (guess, turning, np.linspace(0.0, 3.0, STEPS))))
    places = scenario.obstacles.position
    seen = ObstacleEstimate(places, jnp.array([[0.0, 0.0], [0.3, -0.2]]), jnp.zeros((2, 3)))
    goal, tolerance, step = jnp.array([2.0, 1.0, 0.3]), jnp.array([0.15, 0.15, 0.3]), jnp.asarray(0.08)
    problem = PathProblem(stages, goal, tolerance, step, friction_of(shapes, body), shapes, seen, CONFIG)
    xs = np.concatenate([rng.uniform(-1.0, 2.0, (STEPS + 1, 3)), rng.uniform(-0.3, 0.3, (STEPS + 1, n))], axis=1)
    us = np.concatenate([rng.uniform(-0.01, 0.1, (STEPS, n)), rng.uniform(-0.05, 0.05, (STEPS, n))], axis=1)
    return problem, Plan(jnp.asarray(xs), jnp.asarray(us))


@partial(jax.jit, static_argnums=0)
def by_stage(function, problem, plan):
    return jax.vmap(lambda x, u, data: function(problem, x, u, data))(plan.xs[:-1], plan.us, problem.stages)


models, values = jax.jit(PathProblem.models), jax.jit(PathProblem.values)


def test_models_are_those_of_forward_differentiation(given):
    expected, found = by_stage(forward_model, *given), models(*given)
    for field in dataclasses.fields(expected):
        one, other = getattr(found, field.name), getattr(expected, field.name)
        np.testing.assert_allclose(one, other, rtol=1e-9, atol=1e-9, err_msg=field.name)


def test_values_are_those_of_the_stages(given):
    for one, other in zip(values(*given), by_stage(stage_cost, *given), strict=True):
        np.testing.assert_allclose(one, other, rtol=1e-10, atol=1e-10)


def test_rooms_are_those_of_the_stages(given):
    problem, plan = given
    states = plan.xs[:-1]
    expected = jax.vmap(lambda x, time: problem.room(x[:3], x[3:], time))(states, problem.stages.time)
    np.testing.assert_allclose(problem.rooms(states), expected, atol=1e-10)
    assert (expected < 0.0).any() and (expected > 0.0).any()


def test_a_step_without_pushes_is_finite(given):
    problem, plan = given
    still = Plan(plan.xs, jnp.zeros_like(plan.us))
    expected, found = by_stage(forward_model, problem, still), models(problem, still)
    assert all(np.isfinite(leaf).all() for leaf in jax.tree.leaves(found))
    np.testing.assert_allclose(found.gradient, expected.gradient, rtol=1e-9, atol=1e-9)
