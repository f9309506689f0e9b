"""The closed form against the matrix exponential of the augmented system, and against Newton and Euler."""

import jax.numpy as jnp
import numpy as np
import pytest
from scipy.linalg import expm

from jaxlocomanip.locomotion import srbd
from jaxlocomanip.locomotion.srbd import GRAVITY, PushedBody, PushedState

STEPS, DT = 6, 0.05
RNG = np.random.default_rng(3)
MASS, INERTIA = 24.0, np.diag([0.25, 0.95, 1.0]) + 0.02
ARMS = RNG.normal(size=(STEPS, 4, 3)) * 0.2
PUSH_ARM, PUSH = np.array([0.36, 0.02, 0.01]), np.array([-30.0, 4.0])
START = RNG.normal(size=12) * 0.3


def cross(v):
    return np.array([[0.0, -v[2], v[1]], [v[2], 0.0, -v[0]], [-v[1], v[0], 0.0]])


def augmented(k):
    """A [15, 15] and B [15, 12] of the 13 states with gravity and the push's two."""
    a, b = np.zeros((15, 15)), np.zeros((15, 12))
    a[0:3, 6:9] = a[3:6, 9:12] = np.eye(3)
    a[11, 12] = 1.0
    a[6:9, 13:] = np.linalg.solve(INERTIA, cross(PUSH_ARM)[:, :2])
    a[9:11, 13:] = np.eye(2) / MASS
    for leg in range(4):
        b[6:9, 3 * leg : 3 * leg + 3] = np.linalg.solve(INERTIA, cross(ARMS[k, leg]))
        b[9:12, 3 * leg : 3 * leg + 3] = np.eye(3) / MASS
    return a, b


def parts():
    f = jnp.asarray
    body = PushedBody(f(MASS), f(INERTIA), f(ARMS), f(PUSH_ARM))
    state = PushedState(f(START[:3]), f(START[3:6]), f(START[6:9]), f(START[9:]), f(-GRAVITY), f(PUSH))
    return body, state


def test_prediction_is_the_exact_zero_order_hold(x64):
    forces = RNG.normal(size=(STEPS, 12)) * 50.0
    x, exact = np.concatenate([START, [-GRAVITY], PUSH]), []
    for k in range(STEPS):
        a, b = augmented(k)
        block = np.zeros((27, 27))
        block[:15, :15], block[:15, 15:] = a * DT, b * DT
        transition = expm(block)
        x = transition[:15, :15] @ x + transition[:15, 15:] @ forces[k]
        exact.append(x[:12])
    body, state = parts()
    acceleration = jnp.einsum("nij,nj->ni", srbd.responses(body), jnp.asarray(forces)) + srbd.drift(body, state)
    place, rate = srbd.predict(state, acceleration, DT)
    assert np.concatenate([place, rate], axis=1) == pytest.approx(np.array(exact), abs=1e-10)


def test_single_precision_is_enough():
    body, state = parts()
    place, rate = srbd.predict(state, jnp.broadcast_to(srbd.drift(body, state), (STEPS, 6)), DT)
    assert place.dtype == jnp.float32
    assert rate[-1, 5] == pytest.approx(START[11] - GRAVITY * STEPS * DT, abs=1e-5)
    assert place[-1, 5] == pytest.approx(START[5] + START[11] * 0.3 - 0.5 * GRAVITY * 0.09, abs=1e-5)
