"""The written-out curvature of a stage equals automatic differentiation."""

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
from jaxlocomanip.solver.implicit import Curved
from jaxlocomanip.solver.ocp import Plan

STEPS = 6
FOUR = [{"type": "aliengo", "face": face} for face in ("-x", "-y", "+x", "+y")]
OBSTACLES = [
    {"shape": "box", "size": [0.5, 0.7], "position": [1.5, 1.0]},
    {"shape": "circle", "radius": 0.3, "position": [-1.3, 0.9]},
]
CONFIGS = {
    "robust": PlannerConfig(horizon=Horizon(steps=STEPS)),
    "paper": dataclasses.replace(paper(), horizon=Horizon(steps=STEPS)),
}


def assemble(make_scenario, robots, config):
    """A problem with obstacles on the move, and random states, inputs and multipliers around its start."""
    rng = np.random.default_rng(0)
    scenario = make_scenario(object={"size": [0.9, 0.8], "mass": 6.0}, robots=robots, obstacles=OBSTACLES)
    n, shapes = len(robots), shapes_of(scenario)
    friction = {"friction_force": jnp.asarray(22.0), "friction_moment": jnp.asarray(5.0)}
    body = dataclasses.replace(scenario.object.body, com=jnp.array([0.04, -0.03]), **friction)
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
    multipliers = jnp.asarray(rng.normal(size=(STEPS, 6 + n)))
    return problem.assemble(targets, plan, body, shapes, estimate, config), plan, multipliers


def written(made, plan, multipliers):
    return made.curvature(plan, multipliers)


def automatic(made, plan, multipliers):
    nx = plan.xs.shape[1]

    def one(x, u, multiplier, data):
        def bent(z, slope):
            stage = made.stage(z[:nx], z[nx:], data)
            return jnp.sum(multiplier * stage.next_state) + jnp.sum(slope * stage.inequality)

        slope = made.penalty(made.stage(x, u, data).inequality, data).slope
        return jax.hessian(bent)(jnp.concatenate([x, u]), slope)

    return jax.vmap(one)(plan.xs[:-1], plan.us, multipliers, made.stages)


@pytest.mark.parametrize(
    "robots",
    [pytest.param(FOUR[:2], id="two robots"), pytest.param(FOUR, id="four robots", marks=pytest.mark.slow)],
)
@pytest.mark.parametrize("name", CONFIGS)
def test_curvature_equals_automatic_differentiation(x64, make_scenario, robots, name):
    made, plan, multipliers = assemble(make_scenario, robots, CONFIGS[name])
    assert isinstance(made, Curved)
    mine, truth = jax.jit(written)(made, plan, multipliers), jax.jit(automatic)(made, plan, multipliers)
    assert np.abs(truth).max() > 0.1
    # What three Newton steps of the friction leave of its residual shows in second derivatives.
    assert np.allclose(mine, truth, rtol=0.0, atol=1e-9 * np.abs(truth).max())
    assert np.allclose(mine, mine.transpose(0, 2, 1), rtol=0.0, atol=1e-11 * np.abs(truth).max())
