"""The observer of the object and the obstacle filters."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from jaxlocomanip.planner.config import Estimation
from jaxlocomanip.planner.estimation import (
    correct_object,
    start_object,
    start_obstacles,
    track_obstacles,
)

TICK = 0.02
SETTINGS = Estimation()
track = jax.jit(track_obstacles)


def test_observer_finds_pose_and_velocity_of_a_coasting_object(x64):
    twist = jnp.array([0.4, -0.2, 0.5])
    pose = jnp.array([1.0, 2.0, 3.0])  # the heading passes pi on the way, and is measured wrapped
    estimate = start_object(pose + jnp.array([0.1, -0.1, 0.2]))
    for k in range(1, 301):
        truth = pose + k * TICK * twist
        measured = truth.at[2].set((truth[2] + jnp.pi) % (2.0 * jnp.pi) - jnp.pi)
        predicted = estimate.pose + TICK * estimate.twist
        estimate = correct_object(predicted, estimate.twist, measured, TICK, SETTINGS)
    assert np.allclose(estimate.pose, truth, rtol=0.0, atol=1e-4)
    assert np.allclose(estimate.twist, twist, rtol=0.0, atol=1e-4)
    assert np.abs(estimate.innovation).max() < 1e-4


def test_observer_trusts_a_right_prediction():
    pose, twist = jnp.array([1.0, 2.0, 0.3]), jnp.array([0.1, 0.2, 0.3])
    estimate = correct_object(pose, twist, pose, TICK, SETTINGS)
    assert np.allclose(estimate.pose, pose) and np.allclose(estimate.twist, twist)
    assert estimate.innovation.tolist() == [0.0, 0.0, 0.0]


def test_static_obstacle_is_the_mean_of_all_measurements(x64):
    rng = np.random.default_rng(0)
    place = np.array([[2.0, -1.0], [0.5, 0.5]])
    measured = place + SETTINGS.obstacle_noise * rng.normal(size=(200, 2, 2))
    estimate = start_obstacles(jnp.asarray(measured[0]), SETTINGS)
    for y in measured[1:]:
        estimate = track(estimate, jnp.asarray(y), jnp.zeros(2, bool), TICK, SETTINGS)
    assert np.allclose(estimate.position, measured.mean(axis=0), rtol=0.0, atol=1e-12)
    assert np.allclose(estimate.covariance[:, 0], SETTINGS.obstacle_noise**2 / 200, rtol=1e-9)
    assert (estimate.velocity == 0.0).all()


def test_velocity_of_a_moving_obstacle_is_found(x64):
    velocity = np.array([[0.6, -0.3], [0.0, 0.0]])
    start = np.array([[0.0, 1.0], [3.0, 3.0]])
    estimate = start_obstacles(jnp.asarray(start), SETTINGS)
    for k in range(1, 151):
        estimate = track(estimate, jnp.asarray(start + k * TICK * velocity), jnp.ones(2, bool), TICK, SETTINGS)
    assert np.allclose(estimate.velocity, velocity, rtol=0.0, atol=1e-3)
    assert np.allclose(estimate.position, start + 150 * TICK * velocity, rtol=0.0, atol=1e-4)


def test_velocity_from_noisy_measurements_is_as_good_as_the_filter_says(x64):
    """Over many obstacles the error has the variance that the filter reports, acceleration noise left out."""
    rng = np.random.default_rng(1)
    count, velocity = 400, np.array([0.5, 0.2])
    quiet = Estimation(obstacle_acceleration=0.0)
    truth = np.zeros((count, 2))

    def measure():
        return jnp.asarray(truth + quiet.obstacle_noise * rng.normal(size=truth.shape))

    estimate = start_obstacles(measure(), quiet)
    for _ in range(100):
        truth = truth + TICK * velocity
        estimate = track(estimate, measure(), jnp.ones(count, bool), TICK, quiet)
    error = np.asarray(estimate.velocity) - velocity
    assert error.var() == pytest.approx(float(estimate.covariance[0, 2]), rel=0.2)
    assert np.abs(error.mean(axis=0)).max() < 4.0 * np.sqrt(estimate.covariance[0, 2] / count)


def test_covariance_stays_positive_in_single_precision():
    estimate = start_obstacles(jnp.zeros((1, 2)), SETTINGS)
    for _ in range(500):
        estimate = track(estimate, jnp.zeros((1, 2)), jnp.ones(1, bool), TICK, SETTINGS)
    xx, xv, vv = np.asarray(estimate.covariance[0], np.float64)
    assert xx > 0.0 and vv > 0.0 and xx * vv > xv**2
