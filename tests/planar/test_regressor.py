"""The linear parametrisation against the equations of motion."""

import jax.numpy as jnp
import numpy as np
import pytest

from jaxlocomanip.planar import dynamics, regressor
from jaxlocomanip.planar.dynamics import Body


def random_psi(rng):
    mass, force = rng.uniform(2.0, 12.0), rng.uniform(5.0, 60.0)
    return jnp.asarray([mass, rng.uniform(0.5, 2.0), *(mass * rng.uniform(-0.1, 0.1, 2)), force, 0.2 * force])


def test_inertial_columns_are_the_equations_of_motion(x64):
    rng = np.random.default_rng(0)
    for _ in range(20):
        psi = random_psi(rng)
        body = regressor.to_body(psi)
        theta, omega = jnp.asarray(rng.uniform(-3, 3)), jnp.asarray(rng.normal())
        w, a = jnp.asarray(rng.normal(size=3)), jnp.asarray(rng.normal(size=3))
        direct = dynamics.mass_matrix(body, theta) @ a + dynamics.coriolis_matrix(body, theta, omega) @ w
        Y = regressor.inertial_regressor(theta, omega, w, a)
        assert np.allclose(Y @ psi[:4], direct, rtol=0.0, atol=1e-12)


def test_friction_columns_are_the_friction_of_pure_motions(x64):
    """Translation of the centre of mass feels F_c only, turning about it M_c only; there both laws agree."""
    rng = np.random.default_rng(1)
    for _ in range(10):
        psi = random_psi(rng)
        body, theta = regressor.to_body(psi), jnp.asarray(rng.uniform(-3, 3))
        slide = jnp.concatenate([jnp.asarray(rng.normal(size=2)), jnp.zeros(1)])
        spin = dynamics.from_com(body, theta, jnp.array([0.0, 0.0, rng.normal()]))
        for twist in (slide, spin):
            columns = regressor.friction_regressor(theta, body.com, twist, 0.0)
            expected = dynamics.friction_wrench(body, theta, twist, 0.0)
            assert np.allclose(columns @ psi[4:], expected, rtol=1e-6, atol=1e-6)


def test_friction_columns_fade_at_rest(x64):
    com, theta = jnp.array([0.05, 0.02]), jnp.asarray(0.3)
    at_rest = regressor.friction_regressor(theta, com, jnp.zeros(3), 0.02)
    assert np.abs(at_rest).max() == 0.0
    slow = regressor.friction_regressor(theta, com, jnp.array([0.02, 0.0, 0.0]), 0.02)
    assert slow[0, 0] == pytest.approx(np.sqrt(0.5), rel=1e-6)


def test_body_and_parameters_convert_both_ways(x64):
    psi = random_psi(np.random.default_rng(2))
    body = regressor.to_body(psi)
    assert np.allclose(regressor.from_body(body), psi, rtol=1e-15)
    assert psi[regressor.MOMENT_X] == pytest.approx(float(body.mass * body.com[0]))
    assert psi[regressor.FRICTION] == body.friction_force
    again = regressor.to_body(regressor.from_body(body))
    assert isinstance(again, Body) and np.allclose(again.com, body.com, rtol=1e-15)
