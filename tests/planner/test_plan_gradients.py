"""Derivatives of the planner's optimal plan by each group of its parameters, against central differences.

The assembled problem is held: which corner or edge each disc is held against is not chosen anew.
"""

import dataclasses

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from jaxlocomanip import PlannerConfig, build_scenario, find_scenario
from jaxlocomanip import loop as closing
from jaxlocomanip.planner import problem, reference
from jaxlocomanip.planner.config import Horizon
from jaxlocomanip.planner.estimation import ObstacleEstimate
from jaxlocomanip.planner.path import POINTS, pace, straight_poses
from jaxlocomanip.planner.shapes import shapes_of
from jaxlocomanip.solver import implicit, sqp
from jaxlocomanip.solver.ocp import Plan
from jaxlocomanip.solver.sqp import Options, Status
from jaxlocomanip.worlds.planar import PlanarWorld

OPTIONS = Options(tolerance=1e-4)
GROUPS = {
    "initial state": lambda p, x0: x0,
    "body": lambda p, x0: p.body,
    "obstacles": lambda p, x0: p.stages.obstacles,
    "reference": lambda p, x0: (dataclasses.replace(p.stages, obstacles=None), p.final_pose, p.final_twist),
    "weights": lambda p, x0: p.config.weights,
    "barriers": lambda p, x0: p.barriers,
    "gains of CLF and CBF": lambda p, x0: p.config.constraints,
    "bounds": lambda p, x0: p.shapes.team,
    "horizon": lambda p, x0: p.config.horizon,
}


def floating(leaf):
    return jnp.issubdtype(jnp.result_type(leaf), jnp.floating)


def strong(tree):
    """Python numbers as arrays, so that each can be moved."""
    return jax.tree.map(lambda leaf: jnp.asarray(np.asarray(leaf)), tree)


def direction(group, made, x0, rng):
    """A random tangent of (problem, x0) that moves one group only, each number by about its own size."""
    marked = {id(leaf) for leaf in jax.tree.leaves(GROUPS[group](made, x0))}

    def one(leaf):
        if not floating(leaf):
            return np.zeros(leaf.shape, jax.dtypes.float0)
        size = jnp.abs(leaf) + (0.1 if group == "initial state" else 0.0)
        return jnp.asarray(rng.normal(size=leaf.shape)) * size if id(leaf) in marked else jnp.zeros_like(leaf)

    return jax.tree.map(one, (made, x0))


def moved(tree, tangent, h):
    return jax.tree.map(lambda leaf, by: leaf + h * by if floating(leaf) else leaf, tree, tangent)


def converge(made, x0, guess):
    return implicit.solve(made, x0, sqp.start(guess, OPTIONS), OPTIONS, limit=500)


def change(made, x0, plan, tangent):
    return jax.jvp(lambda p, x: implicit.plan_of(p, x, plan), (made, x0), tangent)[1]


def pulled(made, x0, plan, by_plan):
    return jax.vjp(lambda p, x: implicit.plan_of(p, x, plan), made, x0)[1](by_plan)


def inner(a, b):
    pairs = zip(jax.tree.leaves(a), jax.tree.leaves(b), strict=True)
    return sum(jnp.sum(x * y) for x, y in pairs if x.dtype != jax.dtypes.float0)


def check(made, x0, found, batched):
    """Errors below 1e-4 of the derivative of the plan and of its first input, for every group and both modes."""
    over = jax.vmap if batched else (lambda f: f)
    forward, backward = jax.jit(over(change)), jax.jit(over(pulled))
    polish, product = jax.jit(over(implicit.polish)), over(inner)
    rng = np.random.default_rng(0)
    by_plan = jax.tree.map(lambda leaf: jnp.asarray(rng.normal(size=leaf.shape)), found.plan)
    slopes = backward(made, x0, found.plan, by_plan)
    h = 1e-6
    for group in GROUPS:
        tangent = direction(group, made, x0, rng)
        exact = forward(made, x0, found.plan, tangent)
        ahead, left = polish(*moved((made, x0), tangent, h), found.plan)
        behind, right = polish(*moved((made, x0), tangent, -h), found.plan)
        assert max(left.max(), right.max()) < 1e-9, group
        numeric = jax.tree.map(lambda a, b: (a - b) / (2.0 * h), ahead, behind)
        for mine, truth in (
            (exact.us, numeric.us),
            (exact.xs, numeric.xs),
            (exact.us[..., 0, :], numeric.us[..., 0, :]),
        ):
            axes = tuple(range(1 if batched else 0, truth.ndim))
            error, scale = np.abs(mine - truth).max(axis=axes), np.abs(truth).max(axis=axes)
            assert (error < 1e-4 * scale + 1e-6).all(), (group, (error / scale).max())
        one, other = product(exact, by_plan), product(tangent, slopes)
        assert np.allclose(one, other, rtol=1e-6, atol=1e-6), group


@pytest.mark.slow
def test_adaptive_on_its_way_with_active_constraints(x64):
    """The scenario `adaptive` after six seconds of closed loop."""
    config = strong(PlannerConfig(horizon=Horizon(rest_skips=False)))
    scenario, world = strong(build_scenario(find_scenario("adaptive"))), PlanarWorld()
    key = jax.random.key(0)

    @jax.jit
    def tick(loop, state):
        view = world.view(state, scenario)
        made = closing.decide(loop, view, scenario, config, key, record=False)
        new = world.step(state, scenario, made.push, 0.0, config.horizon.tick)
        return closing.settle(loop, made, view, world.view(new, scenario), scenario, config)[0], new

    state = world.start(scenario)
    loop = closing.replan(closing.begin(scenario, config, key, world.view(state, scenario)), scenario, config)
    for _ in range(300):
        loop, state = tick(loop, state)
    planner, shapes = loop.planner, shapes_of(scenario)
    times = config.horizon.dt * jnp.arange(config.horizon.steps + 1.0)
    targets = reference.targets(planner.progress, planner.path, times, config.reference)
    plan = planner.solver.plan
    made = strong(problem.assemble(targets, plan, planner.parameters.body, shapes, planner.obstacles, config))
    x0 = jnp.concatenate([planner.object.pose, planner.object.twist, state.offset])
    found = jax.jit(converge)(made, x0, plan)
    assert found.status == Status.CONVERGED and found.step < 1e-10
    h = jax.vmap(made.stage)(found.plan.xs[:-1], found.plan.us, made.stages).inequality
    reached = (h < made.barriers.reach) & (made.barriers.weight > 0.0)
    assert reached.sum() > 30
    check(made, x0, found, batched=False)


STEPS, LANES = 10, 100
OBSTACLES = [
    {"shape": "box", "size": [0.5, 0.7], "position": [1.5, 1.0]},
    {"shape": "circle", "radius": 0.3, "position": [-1.3, 0.9]},
]


@pytest.mark.slow
def test_random_problems(x64, make_scenario):
    """Random bodies, states and moving obstacles near the way; those that no solver settles are counted."""
    scenario = strong(make_scenario(object={"size": [0.9, 0.8], "mass": 6.0}, obstacles=OBSTACLES))
    config, shapes = strong(PlannerConfig(horizon=Horizon(steps=STEPS))), shapes_of(scenario)
    turn_radius = config.reference.speed / config.reference.turn_rate

    def make(key):
        keys = jax.random.split(key, 6)
        mass = jax.random.uniform(keys[0], (), minval=3.0, maxval=12.0)
        force = mass * 9.81 * jax.random.uniform(keys[1], (), minval=0.15, maxval=0.5)
        com = jax.random.uniform(keys[2], (2,), minval=-0.05, maxval=0.05)
        body = dataclasses.replace(
            scenario.object.body,
            mass=mass,
            inertia=0.2 * mass,
            com=com,
            friction_force=force,
            friction_moment=0.3 * force,
        )
        path = pace(straight_poses(scenario.start, scenario.goal.pose, POINTS), shapes, body, turn_radius)
        times = config.horizon.dt * jnp.arange(STEPS + 1.0)
        targets = reference.targets(reference.start(), path, times, config.reference)
        place = jnp.array([[1.2, 0.6], [0.5, 1.4]]) + jax.random.uniform(keys[3], (2, 2), minval=-0.3, maxval=0.3)
        drift = jax.random.uniform(keys[4], (2, 2), minval=-0.2, maxval=0.2)
        spread = jnp.array([0.1, 0.1, 0.2, 0.3, 0.3, 0.2, 0.05, 0.05])
        x0 = spread * jax.random.normal(keys[5], (8,))
        start = Plan(jnp.tile(x0, (STEPS + 1, 1)), jnp.zeros((STEPS, 4)))
        first = problem.assemble(
            targets, start, body, shapes, ObstacleEstimate(place, drift, jnp.zeros((2, 3))), config
        )
        return first, x0, problem.pushing_start(first, x0)

    made, x0, guess = jax.jit(jax.vmap(make))(jax.random.split(jax.random.key(0), 130))
    found = jax.jit(jax.vmap(converge))(made, x0, guess)
    settled = np.flatnonzero((found.status == Status.CONVERGED) & (found.step < 1e-10))
    assert settled.size >= LANES
    kept = jax.tree.map(lambda leaf: leaf[settled[:LANES]], (made, x0, found))
    check(*kept, batched=True)
