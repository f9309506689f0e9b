"""Small dense linear algebra and smooth functions, against numpy and enumeration."""

import itertools

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from jaxlocomanip.numerics import (
    all_finite,
    apart,
    cholesky,
    cholesky_solve,
    logarithm,
    projected_least_squares,
    quotient,
    safe_norm,
    select,
    sine_and_cosine,
    smooth_positive,
    tiny,
    wrap_angle,
)

factor_and_solve = jax.jit(lambda a, b: (cholesky(a), cholesky_solve(cholesky(a), b)))
RIDGE = 0.05


def positive_definite(rng, n):
    root = rng.normal(size=(n, n))
    return root @ root.T + 0.5 * np.eye(n)


@pytest.mark.parametrize("n", range(1, 9))
def test_cholesky_and_solve_agree_with_numpy(x64, n):
    rng = np.random.default_rng(n)
    matrix, rhs = positive_definite(rng, n), rng.normal(size=(n, 3))
    factor, solution = factor_and_solve(jnp.asarray(matrix), jnp.asarray(rhs))
    assert np.allclose(factor, np.linalg.cholesky(matrix), rtol=0.0, atol=1e-12)
    assert np.allclose(solution, np.linalg.solve(matrix, rhs), rtol=0.0, atol=1e-11)


def test_cholesky_in_single_precision():
    rng = np.random.default_rng(0)
    matrix, rhs = positive_definite(rng, 4), rng.normal(size=(4, 2))
    factor, solution = factor_and_solve(jnp.asarray(matrix, jnp.float32), jnp.asarray(rhs, jnp.float32))
    assert factor.dtype == jnp.float32
    assert np.allclose(factor, np.linalg.cholesky(matrix), rtol=0.0, atol=1e-5)
    assert np.allclose(solution, np.linalg.solve(matrix, rhs), rtol=0.0, atol=1e-5)


@pytest.mark.parametrize("dtype", [jnp.float32, jnp.float64])
def test_singular_matrix_has_a_finite_factor_of_a_near_matrix(x64, dtype):
    v = np.array([1.0, -2.0, 0.5])
    for matrix in (np.zeros((3, 3)), np.outer(v, v)):
        factor, solution = factor_and_solve(jnp.asarray(matrix, dtype), jnp.ones((3, 1), dtype))
        assert np.isfinite(factor).all() and np.isfinite(solution).all()
        assert np.allclose(factor @ factor.T, matrix, rtol=0.0, atol=10.0 * tiny(dtype))


def test_indefinite_matrix_has_a_finite_factor():
    factor, solution = factor_and_solve(jnp.diag(jnp.array([1.0, -3.0, 2.0])), jnp.ones((3, 1)))
    assert np.isfinite(factor).all() and np.isfinite(solution).all()


def enumerate_minimum(matrix, target, upper):
    """Least |A x - b|^2 + ridge |x|^2 over the box, by trying every set of variables at their bounds."""
    n = matrix.shape[1]
    gram, linear = matrix.T @ matrix + RIDGE * np.eye(n), matrix.T @ target
    best, value = None, np.inf
    for where in itertools.product((0, 1, 2), repeat=n):  # free, at zero, at the upper bound
        where = np.array(where)
        if not np.isfinite(upper[where == 2]).all():
            continue
        x = np.where(where == 2, upper, 0.0)
        free = where == 0
        if free.any():
            x[free] = np.linalg.solve(gram[np.ix_(free, free)], (linear - gram @ x)[free])
        cost = 0.5 * x @ gram @ x - linear @ x
        if (x >= -1e-12).all() and (x <= upper + 1e-12).all() and cost < value:
            best, value = x, cost
    return best


@pytest.mark.parametrize("bound", [np.inf, 0.4])
def test_projected_least_squares_agrees_with_enumeration(x64, bound):
    solve = jax.jit(jax.vmap(lambda a, b, u: projected_least_squares(a, b, lambda x: jnp.clip(x, 0.0, u), RIDGE, 3000)))
    rng = np.random.default_rng(3)
    matrices, targets = rng.normal(size=(40, 3, 4)), rng.normal(size=(40, 3))
    matrices /= np.linalg.norm(matrices, axis=1, keepdims=True)
    upper = np.full((40, 4), bound)
    found = np.asarray(solve(jnp.asarray(matrices), jnp.asarray(targets), jnp.asarray(upper)))
    for matrix, target, high, x in zip(matrices, targets, upper, found, strict=True):
        assert x == pytest.approx(enumerate_minimum(matrix, target, high), abs=1e-6)
        gradient = matrix.T @ (matrix @ x - target) + RIDGE * x
        assert (x >= 0.0).all() and (x <= high).all()
        assert gradient[x < 1e-9].min(initial=0.0) >= -1e-6  # at zero: would only go below
        assert gradient[x > high - 1e-9].max(initial=0.0) <= 1e-6  # at the top: would only go above
        between = (x > 1e-9) & (x < high - 1e-9)
        assert np.abs(gradient[between]).max(initial=0.0) <= 1e-6


def test_projected_least_squares_keeps_the_accelerated_rate(x64):
    """Cost minus least cost is at most 2 L |x*|^2 / (k + 1)^2 after k steps of length 1/L."""
    rng = np.random.default_rng(4)
    solve = jax.jit(jax.vmap(lambda a, b: projected_least_squares(a, b, jax.nn.relu, RIDGE, 60)))
    matrices, targets = rng.normal(size=(40, 3, 4)), rng.normal(size=(40, 3))
    found = np.asarray(solve(jnp.asarray(matrices), jnp.asarray(targets)))
    for matrix, target, x in zip(matrices, targets, found, strict=True):
        best = enumerate_minimum(matrix, target, np.full(4, np.inf))
        cost = lambda y: 0.5 * np.sum((matrix @ y - target) ** 2) + 0.5 * RIDGE * y @ y  # noqa: E731, B023
        rate = np.trace(matrix.T @ matrix) + RIDGE
        assert -1e-12 <= cost(x) - cost(best) <= 2.0 * rate * (best @ best) / 61.0**2


def test_wrap_angle():
    angles = np.concatenate([np.linspace(-20.0, 20.0, 401), np.pi * np.arange(-3, 4)])
    wrapped = np.asarray(wrap_angle(jnp.asarray(angles, jnp.float32)), np.float64)
    assert (wrapped >= -np.pi - 1e-6).all() and (wrapped < np.pi).all()
    assert np.allclose(np.exp(1j * wrapped), np.exp(1j * angles), rtol=0.0, atol=5e-6)


def test_wrap_angle_has_slope_one():
    assert jax.grad(wrap_angle)(jnp.asarray(4.0)) == 1.0


def test_smooth_positive_identities(x64):
    x, width = jnp.linspace(-3.0, 3.0, 61), 0.2
    up, down = smooth_positive(x, width), smooth_positive(-x, width)
    assert np.allclose(up - down, x, rtol=0.0, atol=1e-12)
    assert np.allclose(up * down, width**2, rtol=1e-12)
    assert smooth_positive(jnp.asarray(0.0), width) == pytest.approx(width)
    assert (np.diff(np.asarray(up)) > 0.0).all()


def test_smooth_positive_does_not_cancel_in_single_precision():
    for x in (-1e2, -1e4, -1e6):
        assert smooth_positive(jnp.float32(x), 0.02) == pytest.approx(0.02**2 / abs(x), rel=1e-4)


@pytest.mark.parametrize("x", [-1.0, -1e-10, 0.0, 1e-10, 1.0])
def test_smooth_positive_of_no_width_is_the_positive_part(x):
    assert smooth_positive(jnp.float32(x), 0.0) == max(np.float32(x), 0.0)


def test_safe_norm_and_its_gradient():
    assert safe_norm(jnp.array([3.0, -4.0])) == 5.0
    assert np.asarray(jax.grad(safe_norm)(jnp.array([3.0, -4.0]))) == pytest.approx([0.6, -0.8])
    assert jax.grad(safe_norm)(jnp.zeros(2)).tolist() == [0.0, 0.0]
    assert jax.jacfwd(safe_norm)(jnp.zeros(3)).tolist() == [0.0, 0.0, 0.0]


def test_all_finite_looks_at_floating_leaves_only():
    good = {"a": jnp.ones(2), "n": jnp.array(3), "flag": jnp.array(True)}
    assert bool(all_finite(good))
    assert not bool(all_finite(good | {"a": jnp.array([1.0, jnp.nan])}))
    assert not bool(all_finite(good | {"a": jnp.array([jnp.inf, 1.0])}))


def test_select_takes_one_tree_whole():
    a, b = {"x": jnp.ones(2)}, {"x": jnp.array([jnp.nan, 2.0])}
    assert select(jnp.array(True), a, b)["x"].tolist() == [1.0, 1.0]
    assert select(jnp.array(False), b, a)["x"].tolist() == [1.0, 1.0]


def test_sine_and_cosine_in_single_precision():
    angle = np.concatenate([np.linspace(-7.0, 7.0, 20_001), np.linspace(-1e4, 1e4, 20_001)]).astype(np.float32)
    exact = np.sin(angle.astype(float)), np.cos(angle.astype(float))
    for found, expected in zip(jax.jit(sine_and_cosine)(angle), exact, strict=True):
        assert found.dtype == jnp.float32
        assert np.abs(found - expected).max() < 1.3e-7
    slopes = jax.vmap(lambda a: jnp.stack(jax.jvp(sine_and_cosine, (a,), (jnp.float32(2.0),))[1]))(angle)
    assert np.abs(slopes[:, 0] - 2.0 * exact[1]).max() < 3e-7
    backwards = jax.vmap(jax.grad(lambda a: sine_and_cosine(a)[1]))(angle)
    assert np.abs(backwards + exact[0]).max() < 1.3e-7


def test_sine_and_cosine_in_double_precision(x64):
    angle = jnp.linspace(-7.0, 7.0, 101)
    sine, cosine = sine_and_cosine(angle)
    assert (sine == jnp.sin(angle)).all() and (cosine == jnp.cos(angle)).all()


def test_apart_keeps_names_values_and_a_call_of_its_own():
    @apart
    def squared(x):
        """Of a number."""
        return x * x

    assert squared.__name__ == "squared" and squared.__doc__ == "Of a number."
    program = jax.jit(lambda x: squared(squared(x) + 1.0)).lower(jnp.ones(100)).compile()
    assert (program(jnp.full(100, 2.0)) == 25.0).all()
    if jax.default_backend() == "cpu":
        assert program.as_text().count(" call(") == 2


def test_quotients_and_logarithms_have_the_derivatives_of_the_plain_ones(x64):
    x, y = jnp.array([0.3, -2.0, 5.0]), jnp.array([0.7, 1.5, -4.0])
    for ours, plain in ((quotient, jnp.divide), (lambda a, b: b * logarithm(a * a), lambda a, b: b * jnp.log(a * a))):
        for argument in (0, 1):
            first, second = jax.jacfwd(ours, argument), jax.jacfwd(plain, argument)
            np.testing.assert_array_equal(ours(x, y), plain(x, y))
            np.testing.assert_allclose(first(x, y), second(x, y), rtol=1e-14)
            for other in (0, 1):
                np.testing.assert_allclose(
                    jax.jacrev(first, other)(x, y), jax.jacrev(second, other)(x, y), rtol=1e-13, atol=1e-15
                )


def test_quotients_broadcast_and_pass_numbers_on(x64):
    slope = jax.grad(lambda a, b: jnp.sum(quotient(a, b)), argnums=(0, 1))
    by_x, by_y = slope(jnp.float64(2.0), jnp.array([1.0, 4.0]))
    assert (by_x, by_y.tolist()) == (1.25, [-2.0, -0.125])
    assert quotient(jnp.float32(1.0), jnp.float32(3.0)) == jnp.float32(1.0) / jnp.float32(3.0)
