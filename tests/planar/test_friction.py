"""Friction of the object on the ground: the limit surface, and the step that friction takes from a free velocity."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from jaxlocomanip.planar import dynamics, friction
from jaxlocomanip.planar.geometry import rotate

friction_step = jax.jit(dynamics.friction_step)


def test_friction_wrench_lies_on_the_limit_surface_and_dissipates(x64, random_body, at_com):
    rng = np.random.default_rng(3)
    for _ in range(20):
        body, theta, twist = (
            random_body(rng),
            jnp.asarray(rng.uniform(-3, 3)),
            jnp.asarray(rng.normal(size=3)),
        )
        wrench = np.asarray(dynamics.friction_wrench(body, theta, twist, 0.0))
        arm = np.asarray(rotate(theta, body.com))
        moment = wrench[2] - (arm[0] * wrench[1] - arm[1] * wrench[0])
        limits = at_com(body)[1]
        assert np.sum((np.array([*wrench[:2], moment]) / limits) ** 2) == pytest.approx(1.0)
        V = np.asarray(dynamics.to_com(body, theta, twist))
        assert wrench @ np.asarray(twist) == pytest.approx(np.sqrt(np.sum((limits * V) ** 2)))


def test_smoothed_friction_fades_at_rest(make_body):
    body = make_body()
    twist = jnp.array([0.01, 0.0, 0.0])
    still = dynamics.friction_wrench(body, jnp.asarray(0.0), jnp.zeros(3), 0.02)
    slow = dynamics.friction_wrench(body, jnp.asarray(0.0), twist, 0.01)
    assert still.tolist() == [0.0, 0.0, 0.0]
    assert slow[0] == pytest.approx(20.0 / np.sqrt(2.0), rel=1e-5)


def minimise(inertia, limits, free, h):
    """Minimiser of 1/2 (V - V_free)' M (V - V_free) + h |A V| by damped Newton with the cone's corner checked first."""
    if np.sum((inertia * free / (h * limits)) ** 2) <= 1.0:  # the wrench that holds it is inside the limit surface
        return np.zeros(3)
    cost = lambda V: 0.5 * np.sum(inertia * (V - free) ** 2) + h * np.linalg.norm(limits * V)  # noqa: E731
    V = free.copy()
    while cost(V) >= cost(np.zeros(3)):
        V = V / 2.0
    for _ in range(200):
        norm = np.linalg.norm(limits * V)
        pull = limits**2 * V
        gradient = inertia * (V - free) + h * pull / norm
        hessian = np.diag(inertia + h * limits**2 / norm) - h * np.outer(pull, pull) / norm**3
        change = -np.linalg.solve(hessian, gradient)
        length = 1.0
        while cost(V + length * change) > cost(V) + 1e-4 * length * gradient @ change and length > 1e-12:
            length /= 2.0
        V = V + length * change
    return V


@pytest.mark.parametrize("h", [0.005, 0.02, 0.1])
def test_friction_step_minimises_distance_plus_dissipation(x64, h, random_body, at_com):
    rng = np.random.default_rng(4)
    stuck = 0
    for _ in range(60):
        inertia, limits = at_com(random_body(rng))
        free = rng.normal(size=3) * 10.0 ** rng.uniform(-2.0, 0.5)
        found = np.asarray(friction_step(jnp.asarray(inertia), limits[0], limits[2], jnp.asarray(free), h, 0.0))
        least = minimise(inertia, limits, free, h)
        assert np.abs(found - least).max() <= 1e-3 * np.abs(free).max()
        assert (found == 0.0).all() == (least == 0.0).all()
        stuck += (least == 0.0).all()
    assert 0 < stuck < 60


def test_friction_step_never_adds_energy(random_body, at_com):
    rng = np.random.default_rng(5)
    for smoothing in (0.0, 0.02):
        for _ in range(50):
            inertia, limits = at_com(random_body(rng))
            free = jnp.asarray(rng.normal(size=3) * 10.0 ** rng.uniform(-4.0, 1.0), jnp.float32)
            after = friction_step(jnp.asarray(inertia), limits[0], limits[2], free, 0.02, smoothing)
            assert jnp.sum(inertia * after**2) <= jnp.sum(inertia * free**2)
            assert (np.abs(after) <= np.abs(free)).all() and (after * free >= 0.0).all()


def test_friction_step_without_friction_is_free(x64):
    free = jnp.array([0.3, -0.2, 0.5])
    after = friction_step(jnp.array([6.0, 6.0, 0.5]), jnp.asarray(0.0), jnp.asarray(0.0), free, 0.02, 0.0)
    assert np.allclose(after, free, rtol=1e-4)


@pytest.mark.parametrize("dtype", [jnp.float32, jnp.float64])
def test_break_away_itself_is_finite(x64, dtype):
    """At exactly the limit the object rests; the formula divides zero by zero if it is not careful."""
    inertia, force, h = jnp.array([6.0, 6.0, 0.3], dtype), jnp.asarray(20.0, dtype), jnp.asarray(0.005, dtype)
    for scale in (1.0 - 1e-6, 1.0, 1.0 + 1e-6):
        free = jnp.array([1.0, 0.0, 0.0], dtype) * (h * force / inertia[0]) * jnp.asarray(scale, dtype)
        after = friction_step(inertia, force, jnp.asarray(3.0, dtype), free, h, jnp.asarray(0.0, dtype))
        assert np.isfinite(after).all()
        assert np.abs(after).max() <= 1e-6


def test_derivative_of_the_friction_step(x64, random_body, at_com):
    rng = np.random.default_rng(6)

    @jax.jit
    def both(inertia, force, moment, free, change):
        drop = friction.drops(inertia, force, moment, 0.1)
        velocity, derivative = friction.slowing((free[0], free[1], free[2]), drop, 0.02)
        automatic = jax.jvp(lambda v: dynamics.friction_step(inertia, force, moment, v, 0.1, 0.02), (free,), (change,))
        return (jnp.stack(velocity), jnp.stack(derivative(change[0], change[1], change[2]))), automatic

    for speed in (0.0, 1e-3, 0.3, 1.0, 5.0):
        inertia, limits = at_com(random_body(rng))
        free, change = speed * rng.normal(size=3), rng.normal(size=3)
        found, expected = both(jnp.asarray(inertia), limits[0], limits[2], jnp.asarray(free), jnp.asarray(change))
        # One differentiates three Newton steps, the other the equation that they solve.
        for a, b in zip(found, expected, strict=True):
            assert np.allclose(a, b, rtol=1e-7, atol=1e-12)


def test_second_derivatives_of_the_friction_step(x64, random_body, at_com):
    """Against central differences of first derivatives, sliding and sticking, by velocity and by the limits."""
    rng = np.random.default_rng(8)

    @jax.jit
    def slope(inertia, parameters):
        def speed(p):
            return jnp.sum(dynamics.friction_step(inertia, p[0], p[1], p[2:], 0.1, 0.02) ** 2)

        return jax.grad(speed)(parameters)

    hessian = jax.jit(jax.jacfwd(slope, 1))
    for speed in (0.1, 0.5, 2.0):
        inertia, limits = at_com(random_body(rng))
        at = jnp.concatenate([jnp.array([limits[0], limits[2]]), jnp.asarray(speed * rng.normal(size=3))])
        step = 1e-5
        numeric = [
            (slope(inertia, at.at[i].add(step)) - slope(inertia, at.at[i].add(-step))) / (2.0 * step) for i in range(5)
        ]
        exact = np.asarray(hessian(inertia, at))
        np.testing.assert_allclose(exact, np.stack(numeric), rtol=1e-5, atol=1e-6 * np.abs(exact).max())
        np.testing.assert_allclose(exact, exact.T, atol=1e-9 * np.abs(exact).max())
