"""The SQP solver on a pendulum and on the reference pushing problem."""

import dataclasses
import math
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from jax import Array

from benchmarks.push2 import barrier, push2
from jaxlocomanip.numerics import pytree
from jaxlocomanip.solver import riccati, sqp
from jaxlocomanip.solver.ocp import Penalty, Plan, Stage, forward_model
from jaxlocomanip.solver.sqp import Iterate, Options, Status

# A pendulum swung up from hanging, with less torque than it weighs

STEPS, DT = 30, 0.1


@pytree
class Pendulum:
    """Angle from hanging and its rate; the torque is bounded."""

    target: Array
    torque_max: Array

    @property
    def stages(self) -> Array:
        return jnp.arange(STEPS)

    def stage(self, x: Array, u: Array, data: Any) -> Stage:
        rate = x[1] + DT * (u[0] - 9.81 * jnp.sin(x[0]) - 0.1 * x[1])
        following = jnp.stack([x[0] + DT * rate, rate])
        residual = jnp.sqrt(DT) * jnp.concatenate([x - self.target, 0.3 * u])
        return Stage(following, residual, jnp.stack([self.torque_max - u[0], self.torque_max + u[0]]))

    def penalty(self, h: Array, data: Any) -> Penalty:
        return barrier(h, 0.01, 0.05)

    def model(self, x: Array, u: Array, data: Any) -> Any:
        return forward_model(self, x, u, data)

    def terminal(self, x: Array) -> Array:
        return jnp.array([10.0, 3.0], x.dtype) * (x - self.target)


OPTIONS = Options(iterations=1)
MANY = Options(iterations=120)
one_iteration = jax.jit(lambda problem, x0, iterate: sqp.solve(problem, x0, iterate, OPTIONS))
solve_many = jax.jit(lambda problem, x0, iterate: sqp.solve(problem, x0, iterate, MANY))


def pendulum(torque_max=6.0):
    return Pendulum(jnp.array([math.pi, 0.0]), jnp.asarray(torque_max))


def bad_guess(seed=0):
    """States that no dynamics connects and inputs beyond their bounds."""
    rng = np.random.default_rng(seed)
    return Plan(jnp.asarray(rng.normal(size=(STEPS + 1, 2))), jnp.asarray(20.0 * rng.normal(size=(STEPS, 1))))


def first_lane(tree, k):
    return jax.tree.map(lambda leaf: leaf[k], tree)


@pytest.mark.parametrize("seed", range(3))
def test_converges_to_a_stationary_point_from_a_bad_guess(x64, seed):
    problem, x0 = pendulum(), jnp.zeros(2)
    end = solve_many(problem, x0, sqp.start(bad_guess(seed), MANY))
    for _ in range(3):
        end = solve_many(problem, x0, end)
    assert end.status == Status.CONVERGED
    assert end.defect < 1e-9

    def shooting(us):
        """Cost of the inputs alone; its gradient is that of the Lagrangian where the dynamics hold."""

        def one(x, u):
            stage = problem.stage(x, u, None)
            cost = 0.5 * jnp.sum(stage.residual**2) + jnp.sum(problem.penalty(stage.inequality, None).value)
            return stage.next_state, cost

        last, costs = jax.lax.scan(one, x0, us)
        return jnp.sum(costs) + 0.5 * jnp.sum(problem.terminal(last) ** 2)

    cost, gradient = jax.jit(jax.value_and_grad(shooting))(end.plan.us)
    assert cost == pytest.approx(float(end.cost), rel=1e-9)
    assert np.abs(gradient).max() < 1e-5 * max(1.0, abs(float(cost)))
    assert (np.abs(end.plan.us) < 6.0 + 0.05).all()


def test_costates_make_the_lagrangian_stationary(x64):
    problem, x0 = pendulum(), jnp.zeros(2)
    end = solve_many(problem, x0, solve_many(problem, x0, sqp.start(bad_guess(), MANY)))
    end = solve_many(problem, x0, end)
    costates = riccati.solve(sqp.linearise(problem, end.plan)[0], jnp.zeros(2), 0.0).costates

    def lagrangian(plan):
        nexts = jax.vmap(lambda x, u: problem.stage(x, u, None).next_state)(plan.xs[:-1], plan.us)
        return sqp.evaluate(problem, plan)[0] + jnp.sum(costates[1:] * (nexts - plan.xs[1:]))

    slope = jax.grad(lagrangian)(end.plan)
    assert np.abs(slope.xs[1:]).max() < 1e-5 * np.abs(costates).max()
    assert np.abs(slope.us).max() < 1e-5 * np.abs(costates).max()


def test_merit_never_rises(x64):
    """phi = cost + 1.5 max |costate| |defect|_1, the weight being that of the iteration."""
    problem, x0 = pendulum(), jnp.zeros(2)
    merit_weight = jax.jit(
        lambda plan, damping: (
            1.5 * jnp.max(jnp.abs(riccati.solve(sqp.linearise(problem, plan)[0], jnp.zeros(2), damping).costates))
        )
    )
    now = sqp.start(bad_guess(), OPTIONS)
    now = dataclasses.replace(now, plan=Plan(now.plan.xs.at[0].set(x0), now.plan.us))
    seen = set()
    for _ in range(60):
        cost, defect = sqp.evaluate(problem, now.plan)
        weight = merit_weight(now.plan, now.damping)
        after = one_iteration(problem, x0, now)
        seen.add(int(after.status))
        if after.status == Status.ITERATION_LIMIT:
            assert after.cost + weight * after.defect < cost + weight * defect
        if after.status == Status.NO_DESCENT:
            assert after.length == 0.0
            assert after.damping > now.damping
            assert (after.plan.xs == now.plan.xs).all() and (after.plan.us == now.plan.us).all()
        exact = sqp.evaluate(problem, after.plan)
        assert after.cost == pytest.approx(float(exact[0]), rel=1e-9)
        assert after.defect == pytest.approx(float(exact[1]), rel=1e-9, abs=1e-12)
        now = after
    assert Status.ITERATION_LIMIT in seen


def test_the_initial_state_replaces_that_of_the_plan(x64):
    x0 = jnp.array([0.3, -0.2])
    after = one_iteration(pendulum(), x0, sqp.start(bad_guess(), OPTIONS))
    assert np.allclose(after.plan.xs[0], x0, rtol=0.0, atol=0.0)


def test_a_linear_problem_is_solved_in_one_full_step(x64):
    """Small angles without bounds in sight: Gauss-Newton is exact, so the second step is nothing."""
    problem = dataclasses.replace(pendulum(1e6), target=jnp.array([1e-6, 0.0]))
    guess = Plan(jnp.zeros((STEPS + 1, 2)), jnp.zeros((STEPS, 1)))
    first = one_iteration(problem, jnp.zeros(2), sqp.start(guess, Options(damping=0.0)))
    second = one_iteration(problem, jnp.zeros(2), first)
    assert first.length == 1.0
    assert second.step < 1e-3 * first.step
    assert second.status == Status.CONVERGED


def test_nonfinite_numbers_keep_the_last_finite_iterate(x64):
    good = one_iteration(pendulum(), jnp.zeros(2), sqp.start(bad_guess(), OPTIONS))
    for broken in (pendulum(jnp.nan), dataclasses.replace(pendulum(), target=jnp.array([jnp.inf, 0.0]))):
        after = one_iteration(broken, jnp.zeros(2), good)
        assert after.status == Status.NONFINITE
        assert after.length == 0.0
        assert (after.plan.xs == good.plan.xs).all() and (after.plan.us == good.plan.us).all()
    after = one_iteration(pendulum(), jnp.array([jnp.nan, 0.0]), good)
    assert after.status == Status.NONFINITE
    assert (after.plan.xs[1:] == good.plan.xs[1:]).all() and (after.plan.us == good.plan.us).all()
    recovered = solve_many(pendulum(), jnp.zeros(2), after)
    assert np.isfinite(recovered.cost) and recovered.status != Status.NONFINITE


@pytest.mark.parametrize("dtype", [jnp.float32, jnp.float64])
def test_a_broken_lane_leaves_its_neighbours_alone(x64, dtype):
    def batch(bad):
        torque = jnp.asarray([6.0, bad, 4.0], dtype)
        problems = Pendulum(jnp.asarray([[math.pi, 0.0]] * 3, dtype), torque)
        guess = bad_guess()
        plans = Plan(jnp.stack([guess.xs] * 3).astype(dtype), jnp.stack([guess.us] * 3).astype(dtype))
        starts = jax.vmap(lambda plan: sqp.start(plan, MANY))(plans)
        return lanes(problems, jnp.zeros((3, 2), dtype), starts)

    lanes = jax.jit(jax.vmap(lambda p, x, i: sqp.solve(p, x, i, MANY)))
    healthy, broken = batch(5.0), batch(jnp.nan)
    assert broken.status[1] == Status.NONFINITE
    assert np.isfinite(broken.plan.us).all()
    for k in (0, 2):
        for a, b in zip(jax.tree.leaves(first_lane(healthy, k)), jax.tree.leaves(first_lane(broken, k)), strict=True):
            assert a.dtype == b.dtype and (np.asarray(a) == np.asarray(b)).all()


def test_single_precision_stays_single_and_finite():
    guess = jax.tree.map(lambda leaf: leaf.astype(jnp.float32), bad_guess())
    end = solve_many(pendulum(), jnp.zeros(2), sqp.start(guess, MANY))
    assert isinstance(end, Iterate)
    assert all(leaf.dtype in (jnp.float32, jnp.int32) for leaf in jax.tree.leaves(end))
    assert np.isfinite(end.plan.us).all()
    assert end.status != Status.NONFINITE


def test_every_status_has_a_sentence():
    sentences = [status.sentence for status in Status]
    assert len(set(sentences)) == len(Status) == 4
    assert all(len(s.split()) >= 5 and s[0].islower() for s in sentences)
    assert [int(s) for s in Status] == [0, 1, 2, 3]


# Two robots push a box past two obstacles


def test_reference_problem(x64):
    """Cost at the guess and at the solution, as found by other solvers; full steps alone diverge near this optimum."""
    problem, guess = push2()
    assert sqp.evaluate(problem, guess)[0] == pytest.approx(421.20244, rel=1e-6)
    options = Options(iterations=100)
    end = jax.jit(lambda p, i: sqp.solve(p, jnp.zeros(8), i, options))(problem, sqp.start(guess, options))
    assert end.cost == pytest.approx(-34.43354, rel=1e-4)
    assert end.defect < 1e-6


def test_converging_takes_as_many_iterations_as_it_needs(x64):
    """The same iterates as one by one, until the step is small or the limit is met."""
    problem, x0 = pendulum(), jnp.zeros(2)
    converge = jax.jit(lambda i, limit: sqp.converge(problem, x0, i, OPTIONS, limit), static_argnums=1)
    end, count = converge(sqp.start(bad_guess(), OPTIONS), 200)
    now, steps = sqp.start(bad_guess(), OPTIONS), []
    while not steps or steps[-1] >= OPTIONS.tolerance:
        now = one_iteration(problem, x0, now)
        steps.append(float(now.step))
    assert end.status == Status.CONVERGED and count == len(steps)
    assert np.allclose(end.plan.us, now.plan.us, rtol=1e-9)
    end, count = converge(sqp.start(bad_guess(), OPTIONS), 3)
    assert end.status != Status.CONVERGED and count == 3


def test_single_precision_tells_steps_apart_near_a_minimum():
    """Where full steps overshoot, the least of merits that round alike is no guide; their changes are."""
    problem, guess = push2()
    guess = jax.tree.map(lambda leaf: leaf.astype(jnp.float32), guess)
    end, count = jax.jit(lambda p, i: sqp.converge(p, jnp.zeros(8), i, Options(), 40))(
        problem, sqp.start(guess, Options())
    )
    assert end.status == Status.CONVERGED and count <= 15
    assert end.cost == pytest.approx(-34.43354, rel=1e-5)
