"""Barrier conditions against Lie derivatives by forward differentiation and against simulated trajectories."""

import jax
import numpy as np
import pytest

from jaxlocomanip.planar.dynamics import lie_derivative

found_conditions = jax.jit(lambda case: case.conditions())


@jax.jit
def by_lie_derivatives(case):
    """Conditions of object and robots, and how the barriers' first derivatives feel the inputs."""
    (drift, input_map), settings, x = case.affine, case.settings, case.x
    first = lie_derivative(case.object_barriers, drift)
    second = lie_derivative(first, drift)
    early = jax.jacfwd(case.object_barriers)(x) @ input_map(x)
    late = jax.jacfwd(first)(x) @ input_map(x)
    barrier, slope = case.object_barriers(x), first(x)
    objects = second(x) + late @ case.u + settings.object_beta * slope + settings.object_alpha * barrier
    felt = jax.jacfwd(case.robot_barriers)(x) @ input_map(x)
    slope = lie_derivative(case.robot_barriers, drift)(x) + felt @ case.u
    robots = slope + settings.robot_alpha * case.robot_barriers(x)
    return objects, robots, early, late, felt


@pytest.mark.parametrize("seed", range(4))
def test_conditions_are_lie_derivatives_for_obstacles_at_rest(x64, random_case, seed):
    case = random_case(seed, np.zeros((2, 2)))
    objects, robots, early, late, felt = by_lie_derivatives(case)
    found = found_conditions(case)
    assert np.allclose(found[0], objects, rtol=0.0, atol=1e-9)
    assert np.allclose(found[1], robots, rtol=0.0, atol=1e-9)
    assert np.abs(early).max() == 0.0  # relative degree 2: the object's barrier feels pushes
    assert np.abs(late[..., :2]).max() > 1e-3  # in its second derivative only
    assert np.abs(felt[..., 2:]).max() > 1e-3  # relative degree 1: a robot's barrier feels its sliding at once


@jax.jit
def by_differences(case, h):
    """Conditions of object and robots from barrier values shortly before, at, and after now."""

    def flow(span):
        """State a time later, or earlier, along the trajectory through x."""
        k1 = case.field(case.x)
        k2 = case.field(case.x + span / 2 * k1)
        k3 = case.field(case.x + span / 2 * k2)
        return case.x + span / 6 * (k1 + 2 * k2 + 2 * k3 + case.field(case.x + span * k3))

    before, after, settings = flow(-h), flow(h), case.settings

    def derivatives(barriers):
        low, here, high = barriers(before, -h), barriers(case.x), barriers(after, h)
        return here, (high - low) / (2 * h), (high - 2 * here + low) / h**2

    here, slope, curvature = derivatives(case.object_barriers)
    objects = curvature + settings.object_beta * slope + settings.object_alpha * here
    here, slope, _ = derivatives(case.robot_barriers)
    return objects, slope + settings.robot_alpha * here


@pytest.mark.parametrize("seed", range(4))
def test_conditions_are_time_derivatives_along_trajectories_past_moving_obstacles(x64, random_case, seed):
    case = random_case(seed, [[0.4, -0.3], [-0.2, 0.5]])
    for found, expected in zip(found_conditions(case), by_differences(case, 1e-4), strict=True):
        assert np.allclose(found, expected, rtol=0.0, atol=1e-5 * (1.0 + np.abs(expected).max()))
