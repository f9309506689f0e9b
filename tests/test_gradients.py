"""Gradients of whole episodes against central differences, and that they stay finite."""

import dataclasses
import re

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from jaxlocomanip.build import build
from jaxlocomanip.checked import InputError
from jaxlocomanip.gradients import SHARPNESS, soft_outcome
from jaxlocomanip.library import find
from jaxlocomanip.padding import stack
from jaxlocomanip.planner.config import Horizon, PlannerConfig, Reference
from jaxlocomanip.planner.presets import preset
from jaxlocomanip.sampling.sampler import sample
from jaxlocomanip.sampling.study import find_study
from jaxlocomanip.sweep.plan import padding

# Reverse differentiation of the whole loop compiles for minutes on a busy machine.
pytestmark = pytest.mark.timeout(1800)

TRUTH = {"mass": 8.0, "friction": 0.3, "com": [0.03, -0.04]}
NEAR = [{"shape": "box", "size": [0.5, 0.5], "position": [1.3, 0.0]}]


def strong(tree, dtype=float):
    """Numbers as arrays, floats of one type."""
    values = jax.tree.map(lambda leaf: jnp.asarray(np.asarray(leaf)), tree)
    return jax.tree.map(lambda v: v.astype(dtype) if jnp.issubdtype(v.dtype, jnp.floating) else v, values)


def total(outcome):
    """One number of all of them, each of about the same size."""
    return (
        outcome.path_error_m2
        + 1e-4 * outcome.effort_n2s
        + outcome.clearance_m
        + outcome.team_clearance_m
        + outcome.time_s
        + outcome.off_goal
        + outcome.goal_error_m2
        + outcome.heading_error_rad2
    )


def episode(parts, scenario, config, ticks):
    """Outcome as a function of (truth, obstacle positions, weights, constraints, adaptation)."""
    truth, places, weights, constraints, adaptation = parts
    settings = dataclasses.replace(config, weights=weights, constraints=constraints, adaptation=adaptation)
    obstacles = dataclasses.replace(scenario.obstacles, position=places)
    return soft_outcome(dataclasses.replace(scenario, truth=truth, obstacles=obstacles), settings, ticks)


def parts_of(scenario, config):
    return scenario.truth, scenario.obstacles.position, config.weights, config.constraints, config.adaptation


slopes = jax.jit(
    jax.value_and_grad(lambda parts, s, c, ticks: total(episode(parts, s, c, ticks))), static_argnames="ticks"
)
lanes = jax.jit(
    jax.vmap(jax.value_and_grad(lambda p, s, c, ticks: total(episode(p, s, c, ticks))), (0, 0, None, None)),
    static_argnums=3,
)


@pytest.mark.slow
@pytest.mark.parametrize("name", ["free floor", "pushed against the bounds", "along an obstacle"])
def test_gradient_over_200_ticks_equals_central_differences(x64, make_scenario, name):
    """A straight path that is not searched anew, because the path is held fixed by the gradient."""
    config = strong(
        PlannerConfig(horizon=Horizon(steps=8), reference=Reference(plan_path=0.0, replan=10.0, speed=0.3, lead=1.0))
    )
    truth = TRUTH | ({"mass": 9.0, "friction": 0.42} if name == "pushed against the bounds" else {})
    obstacles = NEAR if name == "along an obstacle" else []
    scenario = strong(make_scenario(truth=truth, obstacles=obstacles, duration=10.0))
    if name == "pushed against the bounds":
        team = dataclasses.replace(scenario.team, force_max=scenario.team.force_max * 0.65)
        scenario = dataclasses.replace(scenario, team=team)
    parts = parts_of(scenario, config)
    value, slope = slopes(parts, scenario, config, 200)
    assert np.isfinite(value)
    run = jax.jit(lambda p: total(episode(p, scenario, config, 200)))
    rng, h = np.random.default_rng(0), 1e-6
    for _ in range(3):
        way = jax.tree.map(lambda leaf: jnp.asarray(rng.normal(size=leaf.shape)) * leaf, parts)
        ahead, behind = (run(jax.tree.map(lambda a, b: a + s * b, parts, way)) for s in (h, -h))  # noqa: B023
        numeric = (ahead - behind) / (2.0 * h)
        exact = sum(jnp.sum(a * b) for a, b in zip(jax.tree.leaves(slope), jax.tree.leaves(way), strict=True))
        assert abs(exact - numeric) < 1e-3 * abs(numeric)
        assert abs(numeric) > 1e-3


@pytest.mark.slow
def test_memory_hardly_grows_with_the_ticks(make_scenario):
    config, scenario = strong(PlannerConfig(horizon=Horizon(steps=5))), strong(make_scenario())
    sizes = []
    for ticks in (100, 800):
        program = slopes.lower(parts_of(scenario, config), scenario, config, ticks).compile()
        sizes.append(program.memory_analysis().temp_size_in_bytes)
    assert sizes[1] < 1.5 * sizes[0]


def random_lanes(first, count, config, ticks):
    """Values and gradients of random scenarios with obstacles, drawn by the study `standard`."""
    drawn = [build(sample("standard", 0, first + k), first + k) for k in range(count)]
    scenarios = strong(stack(drawn, padding(find_study("standard"))), jnp.float32)
    parts = jax.vmap(lambda s: parts_of(s, config))(scenarios)
    return lanes(parts, scenarios, config, ticks)


def all_lanes_finite(tree):
    return all(np.isfinite(leaf).all() for leaf in jax.tree.leaves(tree))


@pytest.mark.slow
@pytest.mark.timeout(7200)
def test_gradients_of_random_scenarios_are_finite():
    """Searched paths, second starts, sticking, contact bounds, the safety filter: all on."""
    config = strong(PlannerConfig(horizon=Horizon(steps=5)), jnp.float32)
    for first in range(0, 1000, 50):
        value, slope = random_lanes(first, 50, config, 60)
        assert all_lanes_finite((value, slope)), first
        assert (np.abs(slope[0].mass) > 0.0).mean() > 0.9


@pytest.mark.slow
def test_forward_mode_agrees_with_reverse_mode(x64, make_scenario):
    config, scenario = strong(PlannerConfig(horizon=Horizon(steps=5))), strong(make_scenario(obstacles=NEAR))
    parts = parts_of(scenario, config)
    _, slope = slopes(parts, scenario, config, 60)
    _, forward = jax.jit(lambda p, d: jax.jvp(lambda p: total(episode(p, scenario, config, 60)), (p,), (d,)))(
        parts, parts
    )
    backward = sum(jnp.sum(a * b) for a, b in zip(jax.tree.leaves(slope), jax.tree.leaves(parts), strict=True))
    assert forward == pytest.approx(float(backward), rel=1e-8)


@pytest.mark.slow
def test_soft_outcomes_are_near_the_hard_ones(make_scenario):
    """Against `simulate` of the same world."""
    from jaxlocomanip.closed_loop import simulate
    from jaxlocomanip.gradients import WORLD

    scenario = strong(make_scenario(obstacles=NEAR, truth=TRUTH, duration=2.0), jnp.float32)
    config = PlannerConfig(horizon=Horizon(steps=5))
    soft = jax.jit(lambda s: soft_outcome(s, config, 100))(scenario)
    hard = simulate(scenario, config, WORLD)
    outcome = hard.outcome
    least = min(outcome.min_object_clearance_m, outcome.min_robot_clearance_m)
    assert -SHARPNESS * np.log(9.0) < soft.clearance_m - least < SHARPNESS * np.log(100.0)
    assert soft.goal_error_m2 == pytest.approx(float(outcome.final_position_error_m) ** 2, rel=1e-3)
    assert soft.heading_error_rad2 == pytest.approx(float(outcome.final_heading_error_rad) ** 2, abs=1e-3)
    # The log has the state before each row's command.
    effort = 0.02 * np.sum(hard.log.view.force[1:] ** 2)
    assert effort == pytest.approx(float(soft.effort_n2s), rel=0.05)
    assert soft.time_s == pytest.approx(2.0, abs=0.05)


@pytest.mark.slow
def test_means_are_those_of_the_episode_not_of_the_batch(make_scenario):
    config = PlannerConfig(horizon=Horizon(steps=5))
    scenario = strong(make_scenario(obstacles=NEAR, truth=TRUTH, duration=0.4), jnp.float32)
    alone, padded = (jax.jit(soft_outcome, static_argnums=2)(scenario, config, ticks) for ticks in (20, 40))
    jax.tree.map(lambda a, b: np.testing.assert_allclose(a, b, rtol=1e-5), alone, padded)


@pytest.mark.parametrize(
    ("change", "text"),
    [
        ({"ticks": 0}, "ticks = 0: must be a whole number >= 1"),
        ({"ticks": 2.5}, "ticks = 2.5: must be a whole number"),
        ({"memory": 0.0}, "memory = 0.0: must be > 0"),
        ({"memory": float("nan")}, "memory = nan: must be finite"),
        ({"plans": 1.5}, "plans = 1.5: must be >= 0 and <= 1"),
    ],
)
def test_bad_numbers_are_refused(make_scenario, change, text):
    with pytest.raises(InputError, match=re.escape(text)):
        soft_outcome(make_scenario(), PlannerConfig(), **({"ticks": 10} | change))


def test_a_batch_is_refused(make_scenario):
    with pytest.raises(InputError, match="scenario = a batch of 2: must be a single scenario"):
        soft_outcome(stack([make_scenario(0), make_scenario(1)]), PlannerConfig(), 10)


@pytest.mark.slow
def test_a_short_memory_bounds_the_gradient(make_scenario):
    """The outcome is the same; what an early state does to a late one is left out of its derivative."""
    config, scenario = strong(PlannerConfig(horizon=Horizon(steps=5))), strong(make_scenario(obstacles=NEAR))

    @jax.jit
    def slope(memory):
        def error(start):
            return soft_outcome(dataclasses.replace(scenario, start=start), config, 60, memory=memory).goal_error_m2

        return jax.value_and_grad(error)(scenario.start)

    (value, whole), (same, little) = slope(jnp.inf), slope(0.02)
    assert value == same
    # The squares of the former are too small for single precision.
    assert 0.0 < jnp.abs(little).max() < 1e-6 * jnp.abs(whole).max()


@pytest.mark.slow
def test_where_plans_converge_those_of_the_last_tick_do_not_count(x64, make_scenario):
    """Once iterations have settled, a plan depends on its problem and not on where they began."""
    scenario = strong(make_scenario(obstacles=NEAR))

    def slope(iterations):
        config = strong(PlannerConfig(horizon=Horizon(steps=5, sqp_iterations=iterations)))

        @jax.jit
        def by_truth(plans):
            def error(truth):
                return soft_outcome(dataclasses.replace(scenario, truth=truth), config, 25, plans=plans).off_goal

            return jax.value_and_grad(error)(scenario.truth)

        (value, whole), (same, given) = by_truth(1.0), by_truth(0.0)
        assert value == same
        whole, given = (np.concatenate([np.ravel(leaf) for leaf in jax.tree.leaves(tree)]) for tree in (whole, given))
        return np.linalg.norm(given - whole) / np.linalg.norm(whole)

    assert slope(12) < 0.1 * slope(1)


@pytest.mark.slow
def test_iterations_that_do_not_settle_do_not_spoil_gradients_without_plans(make_scenario):
    """The paper's settings, one iteration a tick."""
    scenario, config = strong(make_scenario(obstacles=NEAR), jnp.float32), strong(preset("paper"), jnp.float32)

    @jax.jit
    def slope(plans):
        def error(weights):
            return soft_outcome(scenario, dataclasses.replace(config, weights=weights), 60, plans=plans).off_goal

        return jax.grad(error)(config.weights)

    whole, given = (np.array(jax.tree.leaves(slope(plans))) for plans in (1.0, 0.0))
    assert np.isfinite(given).all()
    assert 0.0 < np.abs(given).max() < 10.0
    assert not np.abs(whole).max() < 10.0 * np.abs(given).max()


def test_the_library_scenario_can_be_differentiated_by_any_of_its_parts():
    """No part of the loop refuses differentiation; nothing is computed here."""
    scenario = strong(build(find("adaptive")), jnp.float32)
    config = strong(PlannerConfig(horizon=Horizon(steps=5)), jnp.float32)

    def risk(scenario, config):
        return soft_outcome(scenario, config, 10).clearance_m

    slope = jax.eval_shape(jax.grad(risk, argnums=(0, 1), allow_int=True), scenario, config)
    assert jax.tree.structure(slope) == jax.tree.structure((scenario, config))
