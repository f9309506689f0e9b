"""The object's mechanics: equations of motion, the time step and Lie derivatives."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from jaxlocomanip.planar import dynamics
from jaxlocomanip.planar.geometry import rotate

step = jax.jit(dynamics.step)
FACES = np.array([[1.0, 0.0], [0.0, 1.0], [-1.0, 0.0]])  # push directions of three robots on a box


# Equations of motion


def test_mass_and_coriolis_matrices(x64, random_body):
    rng = np.random.default_rng(0)
    for _ in range(20):
        body, theta, omega = random_body(rng), jnp.asarray(rng.uniform(-3, 3)), jnp.asarray(rng.normal())
        mass, rate = jax.jvp(lambda a, b=body: dynamics.mass_matrix(b, a), (theta,), (omega,))
        assert np.allclose(mass, mass.T, rtol=0.0, atol=0.0)
        assert np.linalg.eigvalsh(mass).min() > 0.0
        skew = np.asarray(rate - 2.0 * dynamics.coriolis_matrix(body, theta, omega))
        assert np.allclose(skew, -skew.T, rtol=0.0, atol=1e-12)
        assert np.abs(skew).max() > 1e-6


def test_kinetic_energy_is_the_same_at_both_points(x64, random_body, at_com):
    rng = np.random.default_rng(1)
    for _ in range(10):
        body, theta, twist = (
            random_body(rng),
            jnp.asarray(rng.uniform(-3, 3)),
            jnp.asarray(rng.normal(size=3)),
        )
        central = dynamics.to_com(body, theta, twist)
        here = 0.5 * twist @ dynamics.mass_matrix(body, theta) @ twist
        there = 0.5 * np.sum(at_com(body)[0] * np.asarray(central) ** 2)
        assert here == pytest.approx(there, rel=1e-12)
        assert np.allclose(dynamics.from_com(body, theta, central), twist, rtol=0.0, atol=1e-14)


def test_free_motion_keeps_the_momentum_of_the_centre_of_mass(x64, make_body):
    body = make_body(force=0.0, moment=0.0)
    theta, twist = jnp.asarray(0.4), jnp.array([0.3, -0.2, 1.7])
    pull = dynamics.acceleration(body, theta, twist, jnp.zeros(3), 0.02)

    def central(t):
        return dynamics.to_com(body, theta + t * twist[2], twist + t * pull)

    assert np.allclose(jax.jvp(central, (0.0,), (1.0,))[1], 0.0, rtol=0.0, atol=1e-10)


def test_contact_wrench_is_the_sum_of_the_pushes(x64):
    rng = np.random.default_rng(2)
    points, forces, theta = rng.normal(size=(3, 2)), rng.uniform(0, 50, 3), 0.7
    total = np.zeros(3)
    R = np.array([[np.cos(theta), -np.sin(theta)], [np.sin(theta), np.cos(theta)]])
    for point, normal, force in zip(points, FACES, forces, strict=True):
        arm, push = R @ point, R @ normal * force
        total += [push[0], push[1], arm[0] * push[1] - arm[1] * push[0]]
    args = jnp.asarray(points), jnp.asarray(FACES), jnp.asarray(forces)
    assert np.allclose(dynamics.contact_wrench(jnp.asarray(theta), *args), total, rtol=1e-12)
    in_body = dynamics.body_wrench(*args)
    assert np.allclose(rotate(jnp.asarray(theta), in_body[:2]), total[:2], rtol=1e-12)
    assert in_body[2] == pytest.approx(total[2])


# Time step


def rest(made, dtype, wrench, steps=400):
    """Pose and twist after pushing an object at rest with a constant wrench at its centre of mass."""
    start = (jnp.asarray([1.3, -2.7, 0.6], dtype), jnp.zeros(3, dtype))
    h, wrench = jnp.asarray(0.005, dtype), jnp.asarray(wrench, dtype)
    arm = made.com
    about_p = wrench.at[2].add(arm[0] * wrench[1] - arm[1] * wrench[0])

    def body_step(carry, _):
        return dynamics.step(made, *carry, about_p, h, jnp.zeros((), dtype)), None

    return start[0], *jax.jit(lambda: jax.lax.scan(body_step, start, None, length=steps)[0])()


@pytest.mark.parametrize("dtype", [jnp.float32, jnp.float64])
@pytest.mark.parametrize("direction", [(1.0, 0.0, 0.0), (0.6, -0.8, 0.0), (0.0, 0.0, 1.0), (0.48, 0.36, 0.8)])
def test_sticks_below_break_away_and_slides_above(x64, dtype, direction, make_body):
    body, limits = make_body(dtype=dtype), np.array([20.0, 20.0, 4.0])
    start, pose, twist = rest(body, dtype, 0.99 * limits * direction)
    assert twist.tolist() == [0.0, 0.0, 0.0]
    assert np.allclose(pose, start, rtol=0.0, atol=4.0 * np.finfo(dtype).eps)  # of sums of coordinates only
    _, _, twist = rest(body, dtype, 1.05 * limits * direction, steps=40)
    moving = np.asarray(direction) != 0.0
    assert (np.asarray(twist)[2] > 0.0) == bool(moving[2])
    assert np.linalg.norm(twist) > 1e-3


@pytest.mark.parametrize("dtype", [jnp.float32, jnp.float64])
def test_a_sliding_object_comes_to_rest_where_energy_says(x64, dtype, make_body):
    """v^2 = 2 (F_c / m) s, and exactly at rest from then on."""
    body = make_body(com=(0.0, 0.0), dtype=dtype)
    start = (jnp.zeros(3, dtype), jnp.asarray([1.0, 0.0, 0.0], dtype))
    h = jnp.asarray(0.002, dtype)

    def body_step(carry, _):
        return dynamics.step(body, *carry, jnp.zeros(3, dtype), h, jnp.zeros((), dtype)), None

    pose, twist = jax.jit(lambda: jax.lax.scan(body_step, start, None, length=400)[0])()
    assert twist.tolist() == [0.0, 0.0, 0.0]
    assert pose[0] == pytest.approx(6.0 / (2.0 * 20.0), rel=1e-3)


def runge_kutta(body, pose, twist, wrench_B, span, steps):
    """Reference solution of the equations of motion under a wrench that turns with the object."""
    h = span / steps

    def slope(state):
        pose, twist = state
        wrench = jnp.concatenate([rotate(pose[2], wrench_B[:2]), wrench_B[2:]])
        return twist, dynamics.acceleration(body, pose[2], twist, wrench, 0.0)

    def shifted(state, slope, length):
        return tuple(s + length * k for s, k in zip(state, slope, strict=True))

    def one(state, _):
        k1 = slope(state)
        k2 = slope(shifted(state, k1, h / 2.0))
        k3 = slope(shifted(state, k2, h / 2.0))
        k4 = slope(shifted(state, k3, h))
        mean = tuple((a + 2.0 * b + 2.0 * c + d) / 6.0 for a, b, c, d in zip(k1, k2, k3, k4, strict=True))
        return shifted(state, mean, h), None

    return jax.lax.scan(one, (pose, twist), None, length=steps)[0]


def test_step_converges_to_the_equations_of_motion_at_first_order(x64, make_body):
    body, span = make_body(), 0.4
    start = jnp.array([0.0, 0.0, 0.3]), jnp.array([0.8, 0.2, 1.5])  # sliding all the way
    wrench_B = jnp.array([15.0, 10.0, 1.0])
    exact = runge_kutta(body, *start, wrench_B, span, 2000)
    errors = []
    for steps in (16, 32, 64, 128):
        state = jax.lax.fori_loop(
            0, steps, lambda _, s, n=steps: dynamics.step(body, *s, wrench_B, span / n, 0.0), start
        )
        errors.append(max(np.abs(a - b).max() for a, b in zip(state, exact, strict=True)))
    orders = np.log2(np.array(errors[:-1]) / np.array(errors[1:]))
    assert (orders > 0.9).all()
    assert errors[-1] < 3e-3


def test_step_without_friction_is_of_second_order(x64, make_body):
    body, span = make_body(force=0.0, moment=0.0), 0.4
    start = jnp.array([0.0, 0.0, 0.3]), jnp.array([0.8, 0.2, 1.5])
    wrench_B = jnp.array([15.0, 10.0, 1.0])
    exact = runge_kutta(body, *start, wrench_B, span, 2000)
    errors = []
    for steps in (4, 8):
        state = jax.lax.fori_loop(
            0, steps, lambda _, s, n=steps: dynamics.step(body, *s, wrench_B, span / n, 0.0), start
        )
        errors.append(max(np.abs(a - b).max() for a, b in zip(state, exact, strict=True)))
    assert errors[0] / errors[1] > 3.5


@pytest.mark.parametrize("h", [0.02, 0.1, 1.0])
def test_step_is_stable_at_any_length(h, make_body):
    body = make_body(dtype=jnp.float32)
    state = jnp.zeros(3), jnp.array([1.0, -0.5, 3.0])
    for _ in range(int(6.0 / h)):
        state = step(body, *state, jnp.zeros(3), h, 0.02)
        assert np.abs(state[1]).max() <= 3.3
    assert np.abs(state[1]).max() < 1e-3


# Control-affine form and Lie derivatives


def affine(body):
    origins, tangents = jnp.asarray(-0.25 * FACES), jnp.asarray(np.stack([-FACES[:, 1], FACES[:, 0]], axis=1))
    return (origins, tangents), dynamics.control_affine(body, origins, tangents, jnp.asarray(FACES), 0.02)


def test_control_affine_form_is_the_equations_of_motion(x64, random_body):
    rng = np.random.default_rng(6)
    for _ in range(10):
        body = random_body(rng)
        (origins, tangents), (drift, input_map) = affine(body)
        x, u = jnp.asarray(rng.normal(size=9)), jnp.asarray(rng.normal(size=6) * 10.0)
        points = origins + x[6:, None] * tangents
        wrench = dynamics.contact_wrench(x[2], points, jnp.asarray(FACES), u[:3])
        pull = dynamics.acceleration(body, x[2], x[3:6], wrench, 0.02)
        expected = jnp.concatenate([x[3:6], pull, u[3:]])
        assert np.allclose(drift(x) + input_map(x) @ u, expected, rtol=0.0, atol=1e-10)


def test_lie_derivatives_against_finite_differences(x64, random_body):
    rng = np.random.default_rng(7)
    drift, input_map = affine(random_body(rng))[1]
    height = lambda x: jnp.sin(x[0]) * x[3] + x[2] * x[6] ** 2  # noqa: E731
    first = dynamics.lie_derivative(height, drift)
    second = dynamics.lie_derivative(first, drift)
    along_inputs = dynamics.lie_derivative(height, lambda x: input_map(x)[:, 4])
    x, h = jnp.asarray(rng.normal(size=9)), 1e-5
    for function, derivative, field in (
        (height, first, drift(x)),
        (first, second, drift(x)),
        (height, along_inputs, input_map(x)[:, 4]),
    ):
        difference = (function(x + h * field) - function(x - h * field)) / (2.0 * h)
        assert derivative(x) == pytest.approx(float(difference), rel=1e-6, abs=1e-8)
