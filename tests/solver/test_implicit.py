"""Derivatives of optimal plans against central differences of converged solutions."""

import dataclasses
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from jax import Array

from jaxlocomanip.numerics import pytree, safe_norm
from jaxlocomanip.solver import implicit, sqp
from jaxlocomanip.solver.ocp import Penalty, Plan, Stage, forward_model
from jaxlocomanip.solver.sqp import Options, Status

STEPS, DT, LANES = 12, 0.15, 100
OPTIONS = Options(tolerance=1e-4)


def relaxed_logarithm(h, weight, switch):
    near = jnp.maximum(h, switch)
    below = h - near
    slope = -1.0 / near
    value = -jnp.log(near) + slope * below + 0.5 * below**2 / near**2
    return Penalty(weight * value, weight * (slope + below / near**2), weight / near**2)


@pytree
class Puck:
    """A puck with quadratic drag that thrusts along and across its own heading past a disc, x = [p, v, heading]."""

    target: Array
    mass: Array
    drag: Array
    weights: Array
    place: Array
    gain: Array
    barrier: Array
    thrust_max: Array
    moving: Array
    label: Array
    """int: problems hold numbers that nothing can be differentiated by"""

    @property
    def stages(self) -> Array:
        return self.place + DT * jnp.arange(STEPS, dtype=self.place.dtype)[:, None] * self.moving

    def stage(self, x: Array, u: Array, data: Any) -> Stage:
        c, s = jnp.cos(x[4]), jnp.sin(x[4])
        push = jnp.stack([c * u[0] - s * u[1], s * u[0] + c * u[1]])
        pull = (push - self.drag * x[2:4] * safe_norm(x[2:4])) / self.mass
        following = jnp.concatenate([x[:2] + DT * x[2:4], x[2:4] + DT * pull, x[4:] + DT * u[2:]])
        arm = x[:2] - data
        distance = safe_norm(arm)
        barrier = jnp.sum(arm * (x[2:4] - self.moving)) / distance + self.gain * (distance - 0.5)
        residual = jnp.concatenate([x[:2] - self.target, x[2:4], u]) * jnp.sqrt(DT * self.weights[:7])
        bounds = jnp.concatenate([self.thrust_max - u[:2], self.thrust_max + u[:2]])
        return Stage(following, residual, jnp.concatenate([bounds, barrier[None]]))

    def penalty(self, h: Array, data: Any) -> Penalty:
        return relaxed_logarithm(h, self.barrier[0], self.barrier[1])

    def model(self, x: Array, u: Array, data: Any) -> Any:
        return forward_model(self, x, u, data)

    def terminal(self, x: Array) -> Array:
        return jnp.concatenate([x[:2] - self.target, x[2:4]]) * jnp.sqrt(self.weights[7])


def random_puck(seed):
    rng = np.random.default_rng(seed)
    puck = Puck(
        target=np.array([2.0, 0.0]) + rng.uniform(-0.3, 0.3, 2),
        mass=rng.uniform(0.5, 2.0),
        drag=rng.uniform(0.0, 0.8),
        weights=np.concatenate([rng.uniform(1.0, 3.0, 2), rng.uniform(0.1, 0.3, 5), [20.0]]),
        place=np.array([1.0, 0.1]) + rng.uniform(-0.3, 0.3, 2),
        gain=rng.uniform(1.0, 4.0),
        barrier=np.array([rng.uniform(0.05, 0.3), rng.uniform(0.1, 0.3)]),
        thrust_max=rng.uniform(1.0, 3.0),
        moving=rng.uniform(-0.1, 0.1, 2),
        label=np.asarray(seed),
    )
    x0 = np.concatenate([rng.uniform(-0.2, 0.2, 2), rng.uniform(-0.5, 0.5, 2), rng.uniform(-1.0, 1.0, 1)])
    # Through NumPy, so that no leaf is a Python number: equal types share one compilation.
    return jax.tree.map(lambda leaf: jnp.asarray(np.asarray(leaf)), puck), jnp.asarray(x0)


def guess(x0):
    return Plan(jnp.tile(x0, (STEPS + 1, 1)), jnp.zeros((STEPS, 3), x0.dtype))


def plan_of(problem, x0):
    return implicit.solve(problem, x0, sqp.start(guess(x0), OPTIONS), OPTIONS, limit=3000)


solve = jax.jit(plan_of)
solve_lanes = jax.jit(jax.vmap(plan_of))
polish_lanes = jax.jit(jax.vmap(implicit.polish))
jvp_lanes = jax.jit(
    jax.vmap(lambda p, x, plan, dp, dx: jax.jvp(lambda p, x: implicit.plan_of(p, x, plan), (p, x), (dp, dx))[1])
)
vjp_lanes = jax.jit(
    jax.vmap(lambda p, x, plan, by: jax.vjp(lambda p, x: implicit.plan_of(p, x, plan), p, x)[1](by), (0, 0, 0, 0))
)


def scaled(rng, leaf):
    if not jnp.issubdtype(leaf.dtype, jnp.floating):
        return np.zeros(leaf.shape, jax.dtypes.float0)
    return jnp.asarray(rng.normal(size=leaf.shape)) * (jnp.abs(leaf) + 0.1)


def moved(tree, tangent, h):
    return jax.tree.map(
        lambda leaf, by: leaf + h * by if jnp.issubdtype(leaf.dtype, jnp.floating) else leaf, tree, tangent
    )


@pytest.fixture(scope="module")
def lanes(double):
    """Random problems and their plans."""
    with double():
        pucks, starts = zip(*(random_puck(k) for k in range(LANES)), strict=True)
        problems, x0 = jax.tree.map(lambda *leaves: jnp.stack(leaves), *pucks), jnp.stack(starts)
        return problems, x0, solve_lanes(problems, x0)


def test_random_problems_converge_to_rounding_with_active_constraints(x64, lanes):
    problems, _, found = lanes
    assert (found.status == Status.CONVERGED).all()
    assert (found.step < 1e-10).all()
    values = jax.vmap(lambda p, plan: jax.vmap(p.stage)(plan.xs[:-1], plan.us, p.stages))(problems, found.plan)
    active = values.inequality < problems.barrier[:, None, 1:]
    assert active.any(axis=(1, 2)).sum() > LANES // 2
    # Nonlinear dynamics in most: an exact Hessian and the solver's own differ.
    assert (np.abs(found.plan.us).max(axis=(1, 2)) > 0.1).all()


@pytest.mark.parametrize("name", ["x0", *(n for n in Puck.__dataclass_fields__ if n != "label")])
def test_jvp_equals_central_differences(x64, lanes, name):
    problems, x0, found = lanes
    rng = np.random.default_rng(1)
    still = jax.tree.map(lambda leaf: jnp.zeros_like(leaf), problems)
    tangent = dataclasses.replace(still, label=np.zeros(LANES, jax.dtypes.float0))
    by_x0 = jnp.zeros_like(x0)
    if name == "x0":
        by_x0 = scaled(rng, x0)
    else:
        tangent = dataclasses.replace(tangent, **{name: scaled(rng, getattr(problems, name))})
    change = jvp_lanes(problems, x0, found.plan, tangent, by_x0)
    h = 1e-5
    ahead, left = polish_lanes(moved(problems, tangent, h), x0 + h * by_x0, found.plan)
    behind, right = polish_lanes(moved(problems, tangent, -h), x0 - h * by_x0, found.plan)
    assert max(left.max(), right.max()) < 1e-10
    for exact, a, b in zip(jax.tree.leaves(change), jax.tree.leaves(ahead), jax.tree.leaves(behind), strict=True):
        numeric = (a - b) / (2.0 * h)
        scale = np.abs(numeric).max(axis=(1, 2))
        assert (np.abs(exact - numeric).max(axis=(1, 2)) < 1e-4 * scale + 1e-9).all()
        assert np.median(scale) > 1e-3


def test_vjp_is_the_transpose_of_jvp(x64, lanes):
    problems, x0, found = lanes
    rng = np.random.default_rng(2)
    tangent, by_x0 = jax.tree.map(lambda leaf: scaled(rng, leaf), problems), scaled(rng, x0)
    by_plan = jax.tree.map(lambda leaf: jnp.asarray(rng.normal(size=leaf.shape)), found.plan)
    change = jvp_lanes(problems, x0, found.plan, tangent, by_x0)
    slope, slope_x0 = vjp_lanes(problems, x0, found.plan, by_plan)
    over = lambda a, b: np.sum(np.asarray(a) * np.asarray(b), axis=tuple(range(1, np.ndim(a))))  # noqa: E731
    forward = sum(over(a, b) for a, b in zip(jax.tree.leaves(change), jax.tree.leaves(by_plan), strict=True))
    pairs = zip(jax.tree.leaves(tangent), jax.tree.leaves(slope), strict=True)
    backward = over(by_x0, slope_x0) + sum(over(a, b) for a, b in pairs if a.dtype != jax.dtypes.float0)
    assert np.allclose(forward, backward, rtol=1e-8, atol=1e-8)


def test_gradient_through_the_solver(x64, lanes):
    """`solve` itself is differentiable in reverse mode, and its warm start does not count."""
    problems, x0, found = lanes
    problem, start = jax.tree.map(lambda leaf: leaf[1], problems), x0[1]

    def effort(target, first):
        plan = implicit.solve(dataclasses.replace(problem, target=target), start, sqp.start(first, OPTIONS), OPTIONS)
        return jnp.sum(plan.plan.us**2)

    by_target, by_guess = jax.jit(jax.grad(effort, argnums=(0, 1)))(problem.target, guess(start))
    plan = jax.tree.map(lambda leaf: leaf[1], found.plan)
    pulled = jax.vjp(lambda p: implicit.plan_of(p, start, plan), problem)[1](Plan(0.0 * plan.xs, 2.0 * plan.us))[0]
    assert np.allclose(by_target, pulled.target, rtol=1e-6, atol=1e-9)
    assert np.abs(by_target).max() > 1e-3
    assert all((leaf == 0.0).all() for leaf in jax.tree.leaves(by_guess))


@pytest.mark.slow
def test_memory_does_not_grow_with_the_iterations(x64):
    problem, x0 = random_puck(0)

    def temporary(iterations):
        options = Options(iterations=iterations)

        def effort(p):
            plan = implicit.solve(p, x0, sqp.start(guess(x0), options), options)
            return jnp.sum(plan.plan.us**2)

        compiled = jax.jit(jax.grad(effort, allow_int=True)).lower(problem).compile()
        return compiled.memory_analysis().temp_size_in_bytes

    assert temporary(50) < 1.2 * temporary(5)


def test_a_plan_that_is_not_converged_says_so_and_has_a_finite_derivative(x64):
    problem, x0 = random_puck(3)

    def stopped(x0):
        return implicit.solve(problem, x0, sqp.start(guess(x0), OPTIONS), OPTIONS, limit=0)

    found = jax.jit(stopped)(x0)
    slope = jax.jit(jax.grad(lambda x: jnp.sum(stopped(x).plan.us)))(x0)
    assert found.status == Status.ITERATION_LIMIT
    assert found.step > OPTIONS.tolerance
    assert np.isfinite(slope).all() and np.abs(slope).max() > 0.0


def test_nonfinite_problems_are_reported_and_count_as_constant(x64):
    problem, x0 = random_puck(4)
    broken = dataclasses.replace(problem, mass=jnp.asarray(jnp.nan))
    found = solve(broken, x0)
    assert found.status == Status.NONFINITE
    lane = jax.tree.map(lambda leaf: leaf[None], (broken, x0, found.plan))
    _, by_x0 = vjp_lanes(*lane, jax.tree.map(jnp.ones_like, lane[2]))
    assert (by_x0 == 0.0).all()


def test_single_precision_agrees_with_double(lanes, x64):
    problems, x0, found = lanes
    by_plan = jax.tree.map(jnp.ones_like, found.plan)
    single = jax.tree.map(lambda v: v.astype(jnp.float32) if v.dtype == jnp.float64 else v, (problems, x0, found.plan))
    exact = vjp_lanes(problems, x0, found.plan, by_plan)
    rough = vjp_lanes(*single, jax.tree.map(lambda v: v.astype(jnp.float32), by_plan))
    for a, b in zip(jax.tree.leaves(exact), jax.tree.leaves(rough), strict=True):
        if a.dtype != jax.dtypes.float0:
            assert b.dtype == jnp.float32
            error, scale = np.abs(a - b).reshape(LANES, -1).max(axis=1), np.abs(a).reshape(LANES, -1).max(axis=1)
            assert np.median(error / (scale + 1e-3)) < 1e-3
