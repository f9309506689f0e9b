"""The derivative of the closest approach is that of the whole episode where the window holds all of it."""

import dataclasses

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from jaxlocomanip import gradients
from jaxlocomanip.approach import closest_approach
from jaxlocomanip.gradients import soft_outcome
from jaxlocomanip.planner.config import Horizon, PlannerConfig, Reference

pytestmark = [pytest.mark.slow, pytest.mark.timeout(1800)]

NEAR = [{"shape": "box", "size": [0.5, 0.5], "position": [1.0, 0.1]}]
TICKS = 60


def strong(tree):
    return jax.tree.map(lambda leaf: jnp.asarray(np.asarray(leaf)), tree)


@pytest.fixture
def made(x64, make_scenario):
    config = PlannerConfig(horizon=Horizon(steps=5), reference=Reference(replan=0.5))
    return strong(make_scenario(obstacles=NEAR, duration=5.0)), strong(config)


def parts(scenario):
    return scenario.truth, scenario.obstacles.position


def with_parts(scenario, given):
    truth, places = given
    return dataclasses.replace(
        scenario, truth=truth, obstacles=dataclasses.replace(scenario.obstacles, position=places)
    )


def test_a_window_over_the_whole_episode_gives_its_derivative(made, monkeypatch):
    """Two searches of the path lie within; the first state, which has seen the obstacles, is held fixed in both."""
    scenario, config = made
    begin = gradients.begin
    monkeypatch.setattr(gradients, "begin", lambda *given: jax.lax.stop_gradient(begin(*given)))

    def whole(given):
        return soft_outcome(with_parts(scenario, given), config, TICKS).clearance_m

    def windowed(given):
        return closest_approach(with_parts(scenario, given), config, TICKS, window=TICKS)

    (value, slope), (same, again) = (jax.jit(jax.value_and_grad(f))(parts(scenario)) for f in (whole, windowed))
    assert same == pytest.approx(float(value), abs=1e-9)
    for a, b in zip(jax.tree.leaves(slope), jax.tree.leaves(again), strict=True):
        assert np.allclose(a, b, rtol=1e-6, atol=1e-9 * np.abs(a).max())
    assert np.abs(slope[1]).max() > 0.1


def test_a_short_window_ends_at_the_closest_approach(made):
    scenario, config = made

    def windowed(given):
        return closest_approach(with_parts(scenario, given), config, TICKS, window=5)

    value, (_, by_place) = jax.jit(jax.value_and_grad(windowed))(parts(scenario))
    least = jax.jit(lambda s: soft_outcome(s, config, TICKS).clearance_m)(scenario)
    assert value == pytest.approx(float(least), abs=0.06)
    # An obstacle that is moved away is further away by as much.
    assert 0.8 < np.linalg.norm(by_place[0]) < 1.2
