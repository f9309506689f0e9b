"""The relaxed barrier: twice continuously differentiable, convex, finite, and zero beyond its reach."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from jaxlocomanip.planner.penalty import UNBOUNDED, relaxed_barrier

# weight, switch, reach: the paper's plain logarithm and the local barrier, at several scales
LOGARITHMS = [(0.8, 0.5, UNBOUNDED), (0.1, 0.01, UNBOUNDED)]
LOCAL = [(0.8, 0.1, 0.4), (0.1, 0.01, 0.05), (0.02, 1.0, 5.0)]
every = pytest.mark.parametrize(("weight", "switch", "reach"), LOGARITHMS + LOCAL)
local = pytest.mark.parametrize(("weight", "switch", "reach"), LOCAL)


def one(h, *settings):
    return relaxed_barrier(jnp.asarray(h), *(jnp.asarray(v) for v in settings))


def assert_joins(left, right, scale):
    for a, b in zip(jax.tree.leaves(left), jax.tree.leaves(right), strict=True):
        assert a == pytest.approx(float(b), rel=1e-7, abs=1e-7 * scale)


@every
def test_twice_continuous_at_the_switch(x64, weight, switch, reach):
    step = 1e-9 * switch
    assert_joins(one(switch - step, weight, switch, reach), one(switch + step, weight, switch, reach), weight)


@local
def test_twice_continuous_at_its_reach_and_zero_beyond(x64, weight, switch, reach):
    step = 1e-9 * reach
    assert_joins(one(reach - step, weight, switch, reach), one(reach + step, weight, switch, reach), weight / reach**2)
    beyond = one(np.array([1.0, 1.5, 100.0]) * reach, weight, switch, reach)
    assert all((np.asarray(part) == 0.0).all() for part in jax.tree.leaves(beyond))


@pytest.mark.parametrize(("weight", "switch", "reach"), LOGARITHMS)
def test_plain_logarithm_and_its_quadratic_as_the_paper_prints_them(x64, weight, switch, reach):
    h = switch * np.array([1.0, 2.0, 30.0])
    assert np.allclose(one(h, weight, switch, reach).value, -weight * np.log(h), rtol=1e-12)
    h = switch * np.array([-40.0, 0.0, 0.9])
    quadratic = 0.5 * (((h - 2.0 * switch) / switch) ** 2 - 1.0) - np.log(switch)
    assert np.allclose(one(h, weight, switch, reach).value, weight * quadratic, rtol=1e-12)


@every
def test_slope_and_curvature_are_the_derivatives(x64, weight, switch, reach):
    value = lambda h: one(h, weight, switch, reach).value  # noqa: E731
    for h in switch * np.array([-50.0, -1.0, 0.0, 0.5, 0.999, 1.001, 2.0, 3.9, 100.0]):
        point = one(h, weight, switch, reach)
        assert point.slope == pytest.approx(float(jax.grad(value)(h)), rel=1e-12, abs=1e-12)
        assert point.curvature == pytest.approx(float(jax.grad(jax.grad(value))(h)), rel=1e-12, abs=1e-12)


@every
def test_convex_and_falling_within_reach(x64, weight, switch, reach):
    h = jnp.linspace(-20.0 * switch, min(20.0 * switch, reach), 801)
    point = one(h, weight, switch, reach)
    assert (np.asarray(point.curvature) >= 0.0).all()
    assert (np.diff(np.asarray(point.slope)) > 0.0).all()
    assert (np.diff(np.asarray(point.value)) < 0.0).all()


@every
def test_finite_far_away_in_single_precision(weight, switch, reach):
    h = jnp.array([-1e6, -1e3, -0.0, 0.0, 1e-30, 1e6], jnp.float32)
    point = one(h, *np.array([weight, switch, reach], np.float32))
    for part in jax.tree.leaves(point):
        assert part.dtype == jnp.float32
        assert np.isfinite(part).all()


@every
def test_no_weight_means_nothing(weight, switch, reach):
    point = one(jnp.array([-1e6, 0.0, 1.0]), 0.0, switch, reach)
    assert all((np.asarray(part) == 0.0).all() for part in jax.tree.leaves(point))
