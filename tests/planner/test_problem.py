"""The optimal control problem: its written-out model equals automatic differentiation, and absent obstacles are
absent."""

import dataclasses

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from jaxlocomanip.planner import problem, reference
from jaxlocomanip.planner.config import Horizon, PlannerConfig
from jaxlocomanip.planner.estimation import ObstacleEstimate
from jaxlocomanip.planner.path import POINTS, pace, straight_poses
from jaxlocomanip.planner.presets import paper
from jaxlocomanip.planner.shapes import shapes_of
from jaxlocomanip.solver import ocp
from jaxlocomanip.solver.ocp import Plan

STEPS = 7  # not a multiple of the stages that are computed together
FOUR = [{"type": "aliengo", "face": face} for face in ("-x", "-y", "+x", "+y")]
TWO = FOUR[:2]
OBSTACLES = [
    {"shape": "box", "size": [0.5, 0.7], "position": [1.5, 1.0]},
    {"shape": "circle", "radius": 0.3, "position": [-1.3, 0.9]},
]
CONFIGS = {
    "robust": PlannerConfig(horizon=Horizon(steps=STEPS)),
    "paper": dataclasses.replace(paper(), horizon=Horizon(steps=STEPS)),
}

# The problem is an argument: problems of equal shapes share these compilations.
stage_models = jax.jit(lambda made, plan: made.models(plan))
automatic_models = jax.jit(
    lambda made, plan: jax.vmap(lambda x, u, data: ocp.forward_model(made, x, u, data))(
        plan.xs[:-1], plan.us, made.stages
    )
)


def assemble(make_scenario, robots, config, seed=0, friction=22.0):
    """A problem with obstacles on the move, and random states and inputs [STEPS, ...] around its start."""
    rng = np.random.default_rng(seed)
    scenario = make_scenario(object={"size": [0.9, 0.8], "mass": 6.0}, robots=robots, obstacles=OBSTACLES)
    n = len(robots)
    body = dataclasses.replace(
        scenario.object.body,
        com=jnp.array([0.04, -0.03]),
        friction_force=jnp.asarray(friction),
        friction_moment=jnp.asarray(5.0),
    )
    shapes = shapes_of(scenario)
    turn_radius = config.reference.speed / config.reference.turn_rate
    path = pace(straight_poses(scenario.start, scenario.goal.pose, POINTS), shapes, body, turn_radius)
    times = config.horizon.dt * jnp.arange(STEPS + 1.0)
    targets = reference.targets(reference.start(), path, times, config.reference)
    velocity = jnp.array([[0.3, -0.2], [-0.4, 0.1]])
    estimate = ObstacleEstimate(scenario.obstacles.position, velocity, jnp.zeros((2, 3)))
    spread = np.concatenate([[0.5, 0.5, 0.5, 0.5, 0.5, 0.8], np.full(n, 0.1)])
    xs = jnp.asarray(rng.normal(size=(STEPS + 1, 6 + n)) * spread)
    us = jnp.asarray(np.concatenate([rng.uniform(-5, 60, (STEPS, n)), rng.normal(size=(STEPS, n)) * 0.2], axis=1))
    plan = Plan(xs, us)
    return problem.assemble(targets, plan, body, shapes, estimate, config), plan


@pytest.mark.parametrize("robots", [TWO, FOUR], ids=["two robots", "four robots"])
@pytest.mark.parametrize("name", CONFIGS)
def test_model_equals_forward_differentiation(x64, make_scenario, robots, name):
    made, plan = assemble(make_scenario, robots, CONFIGS[name])
    structured, automatic = stage_models(made, plan), automatic_models(made, plan)
    for field in dataclasses.fields(structured):
        a, b = getattr(structured, field.name), getattr(automatic, field.name)
        assert a.shape == b.shape
        assert np.allclose(a, b, rtol=0.0, atol=1e-10 * (1.0 + np.abs(b).max())), field.name


@pytest.mark.parametrize("robots", [TWO, FOUR], ids=["two robots", "four robots"])
def test_all_stages_at_once_are_the_stages_one_by_one(x64, make_scenario, robots):
    made, plan = assemble(make_scenario, robots, CONFIGS["robust"], seed=2)
    cost, following = jax.jit(lambda made, plan: made.values(plan))(made, plan)
    one_by_one = jax.jit(jax.vmap(ocp.stage_cost, in_axes=(None, 0, 0, 0)))
    expected = one_by_one(made, plan.xs[:-1], plan.us, made.stages)
    assert cost.shape == (STEPS,) and following.shape == (STEPS, plan.xs.shape[1])
    assert np.allclose(cost, expected[0], rtol=1e-12)
    assert np.allclose(following, expected[1], rtol=0.0, atol=1e-12)
    lone = jax.tree.map(lambda leaf: leaf[3], (plan.xs[:-1], plan.us, made.stages))
    model = jax.tree.map(lambda leaf: leaf[3], stage_models(made, plan))
    for a, b in zip(jax.tree.leaves(made.model(*lone)), jax.tree.leaves(model), strict=True):
        assert np.allclose(a, b, rtol=0.0, atol=1e-10 * (1.0 + np.abs(b).max()))


def test_slope_of_the_stage_cost_against_finite_differences(x64, make_scenario):
    made, plan = assemble(make_scenario, TWO, CONFIGS["robust"], seed=1)
    nx = plan.xs.shape[1]
    z = jnp.concatenate([plan.xs[:-1], plan.us], axis=1)

    def values(z, data):
        cost, following = ocp.stage_cost(made, z[:nx], z[nx:], data)
        return jnp.concatenate([cost[None], following])

    every = jax.jit(jax.vmap(values))
    model = stage_models(made, plan)
    exact = np.concatenate([model.gradient[:, None], model.dynamics], axis=1)
    h = 1e-6
    for i in range(z.shape[1]):
        difference = (every(z.at[:, i].add(h), made.stages) - every(z.at[:, i].add(-h), made.stages)) / (2 * h)
        column = exact[:, :, i]
        assert np.allclose(column, difference, rtol=1e-5, atol=1e-5 * np.abs(exact[:, :1]).max()), i


def test_absent_obstacles_contribute_nothing(x64, make_scenario):
    made, plan = assemble(make_scenario, TWO, CONFIGS["robust"])
    absent = dataclasses.replace(made.shapes, obstacle_mask=jnp.zeros(2, bool))
    present, far = jnp.zeros((2, 2)), jnp.full((2, 2), 50.0)

    def evaluated(shapes, places):
        """Cost, gradient and Hessian with the obstacles moved to `places`."""
        last = lambda a: jnp.concatenate([a, a[-1:]])  # noqa: E731
        pushes = made.stages.force / made.body.friction_force
        targets = reference.Targets(*map(last, (made.stages.pose, made.stages.twist, pushes, made.stages.offset)))
        estimate = ObstacleEstimate(places, jnp.zeros((2, 2)), jnp.zeros((2, 3)))
        built = problem.assemble(targets, plan, made.body, shapes, estimate, CONFIGS["robust"])
        model = stage_models(built, plan)
        return model.cost, model.gradient, model.hessian

    without = evaluated(absent, far)
    for a, b in zip(without, evaluated(absent, present), strict=True):
        assert (np.asarray(a) == np.asarray(b)).all()
    assert (evaluated(made.shapes, present)[0] > without[0] + 1.0).all()  # and the same obstacles do if they exist


def test_terminal_error_wraps_the_heading(x64, make_scenario):
    made, _ = assemble(make_scenario, TWO, CONFIGS["robust"])
    x = jnp.concatenate([made.final_pose, made.final_twist, jnp.zeros(2)])
    assert np.abs(made.terminal(x)).max() == 0.0
    assert np.abs(made.terminal(x.at[2].add(2.0 * np.pi))).max() < 1e-12
    weights = CONFIGS["robust"].weights
    assert made.terminal(x.at[0].add(0.1))[0] == pytest.approx(0.1 * np.sqrt(weights.final_pose[0]))


def test_feed_forward_never_exceeds_what_a_robot_can_push(x64, make_scenario):
    light, _ = assemble(make_scenario, TWO, CONFIGS["robust"])
    heavy, _ = assemble(make_scenario, TWO, CONFIGS["robust"], friction=500.0)
    limit = np.asarray(light.shapes.team.force_max)
    assert (np.asarray(light.stages.force) >= 0.0).all() and (np.asarray(light.stages.force) < limit).all()
    # Too heavy for the team: no more than its capacity is asked for.
    assert (np.asarray(heavy.stages.force) <= limit).all()
    assert (np.asarray(heavy.stages.force[0]) > 0.8 * limit).all()
