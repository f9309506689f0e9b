"""Plane vectors with their components apart, against complex numbers."""

import jax
import jax.numpy as jnp
import numpy as np

from jaxlocomanip.planar import dynamics
from jaxlocomanip.planar.dynamics import State
from jaxlocomanip.planar.vector import Vector, choose, trailing, unit, vector, vectors


def random_pair(rng, shape):
    z, w = (rng.normal(size=shape) + 1j * rng.normal(size=shape) for _ in range(2))
    return z, w, *(Vector(jnp.asarray(v.real), jnp.asarray(v.imag)) for v in (z, w))


def as_complex(v):
    return np.asarray(v.x) + 1j * np.asarray(v.y)


def test_arithmetic_is_that_of_complex_numbers(x64):
    rng = np.random.default_rng(0)
    z, w, v, u = random_pair(rng, (3, 4))
    angle = rng.uniform(-9.0, 9.0, (3, 4))
    assert np.allclose(as_complex(v + u), z + w)
    assert np.allclose(as_complex(v - u * 2.0), z - 2.0 * w)
    assert np.allclose(as_complex(v.turned), 1j * z)
    assert np.allclose(as_complex(v.rotated(unit(jnp.asarray(angle)))), z * np.exp(1j * angle))
    assert np.allclose(v.dot(u), (np.conj(z) * w).real)
    assert np.allclose(v.cross(u), (np.conj(z) * w).imag)
    assert np.allclose(as_complex(v[1:, 2]), z[1:, 2])
    assert np.allclose(as_complex(choose(jnp.asarray(angle > 0.0), v, u)), np.where(angle > 0.0, z, w))


def test_from_arrays():
    array = jnp.arange(12.0).reshape(2, 3, 2)
    assert (vector(array).y == array[1]).all() and (vectors(array).y == array[..., 1]).all()
    assert trailing(jnp.ones((2, 3)), jnp.ones((2, 3, 4, 5))).shape == (2, 3, 1, 1)


def test_derivatives_of_the_step_by_state_and_wrench(x64, random_body):
    rng = np.random.default_rng(1)

    def step(body, y):
        pose = jnp.concatenate([jnp.array([0.4, -0.2]), y[:1]])
        return jnp.concatenate(dynamics.step(body, pose, y[1:4], y[4:], 0.1, 0.02))

    @jax.jit
    def both(body, y):
        start = State(Vector(jnp.asarray(0.4), jnp.asarray(-0.2)), y[0], Vector(y[1], y[2]), y[3])
        after, slopes = dynamics.advance_slopes(body, start, Vector(y[4], y[5]), y[6], 0.1, 0.02)
        parts = lambda s: jnp.stack([s.position.x, s.position.y, s.heading, s.velocity.x, s.velocity.y, s.omega])  # noqa: E731
        found = parts(after), jnp.stack([parts(s) for s in slopes], axis=1)
        return found, (step(body, y), jax.jacfwd(step, argnums=1)(body, y))

    for _ in range(10):
        y = jnp.asarray(rng.normal(size=7) * [2.0, 0.5, 0.5, 1.0, 40.0, 40.0, 10.0])
        for a, b in zip(*both(random_body(rng), y), strict=True):
            assert np.allclose(a, b, rtol=1e-9, atol=1e-10)
