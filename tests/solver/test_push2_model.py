"""The reference problem with its derivatives written out, against the same problem differentiated by the machine."""

import dataclasses

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from benchmarks.push2 import push2
from benchmarks.push2_model import FastPush2
from jaxlocomanip.solver import sqp
from jaxlocomanip.solver.ocp import Plan, WholeHorizon, stage_models, stage_values
from jaxlocomanip.solver.sqp import Options


def lanes(count):
    """Problems with obstacles moved about, and plans from before the bounds to behind them."""
    rng = np.random.default_rng(0)
    plain, guess = push2()
    places = plain.places + jnp.asarray(rng.uniform(-0.3, 0.3, (count, 2, 2)))
    problems = dataclasses.replace(plain, reference=jnp.stack([plain.reference] * count), places=places)
    xs = guess.xs + jnp.asarray(rng.normal(size=(count, *guess.xs.shape)))
    return problems, Plan(xs, guess.us + jnp.asarray(rng.normal(size=(count, *guess.us.shape)) * [9.0, 9.0, 0.9, 0.9]))


@pytest.mark.parametrize("count", [None, 3])
def test_values_and_models_agree_with_forward_differentiation(x64, count):
    problems, plans = lanes(3)
    fast = FastPush2(**vars(problems))
    assert isinstance(fast, WholeHorizon) and not isinstance(problems, WholeHorizon)
    over = jax.vmap if count else lambda f: lambda p, q: f(*jax.tree.map(lambda leaf: leaf[1], (p, q)))
    for function in (stage_models, stage_values):
        mine, plain = (jax.jit(over(function))(p, plans) for p in (fast, problems))
        for a, b in zip(jax.tree.leaves(mine), jax.tree.leaves(plain), strict=True):
            assert a.shape == b.shape
            assert np.allclose(a, b, rtol=1e-9, atol=1e-9 * np.abs(b).max())


def test_lanes_in_single_precision_solve_as_they_do_alone():
    problem, guess = push2()
    fast = FastPush2(**vars(problem))
    options = Options(iterations=60)
    solve = lambda p, i: sqp.solve(p, jnp.zeros(8), i, options)  # noqa: E731
    alone = jax.jit(solve)(fast, sqp.start(guess, options))
    batch, starts = jax.tree.map(lambda leaf: jnp.stack([leaf] * 5), (fast, sqp.start(guess, options)))
    together = jax.jit(jax.vmap(solve))(batch, starts)
    assert alone.cost == pytest.approx(-34.43354, rel=1e-4)
    assert np.allclose(together.cost, alone.cost, rtol=1e-5)
    assert np.allclose(together.plan.us, alone.plan.us, rtol=0.0, atol=2e-2)
