"""Friction from the moment at which the object breaks away."""

import dataclasses

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from jaxlocomanip.planar import dynamics
from jaxlocomanip.planner import adaptation, breakaway
from jaxlocomanip.planner.config import PlannerConfig
from jaxlocomanip.planner.estimation import start_object
from jaxlocomanip.planner.shapes import shapes_of

CONFIG = PlannerConfig()
TICK = CONFIG.horizon.tick
RAMP = 30.0  # N/s
watch = jax.jit(breakaway.watch)


def moving(estimate, twist):
    return dataclasses.replace(estimate, twist=jnp.asarray(twist))


@pytest.fixture
def ramped(make_scenario):
    """A function: what is seen of an object at rest under a push that rises, with noise; (time, push, state, slip)."""

    def run(friction, noise=0.005, seconds=3.0, hold=None, ramp=RAMP, tight=False):
        scenario = make_scenario(truth={"friction": friction})
        shapes, body = shapes_of(scenario), scenario.truth
        step = jax.jit(lambda q, v, w: dynamics.step(body, q, v, w, TICK, 1e-3))
        random, rows = np.random.default_rng(0), []
        pose, twist = jnp.zeros(3), jnp.zeros(3)
        state = dataclasses.replace(breakaway.start(pose), tight=jnp.asarray(tight))
        for k in range(round(seconds / TICK)):
            push = min(ramp * k * TICK, np.inf if hold is None else hold)
            pose, twist = step(pose, twist, jnp.array([push, 0.0, 0.0]))
            measured = pose + jnp.asarray(random.normal(size=3) * [noise, noise, 2.0 * noise], jnp.float32)
            state, slips = watch(state, measured, jnp.asarray(push), shapes, TICK)
            rows.append((k * TICK, push, state, bool(slips)))
        return float(body.friction_force), rows

    return run


@pytest.mark.parametrize("friction", [0.15, 0.35, 0.6])
def test_the_push_at_the_first_slip_is_the_friction(ramped, friction):
    true, rows = ramped(friction)
    seen = [(push, float(state.push)) for _, push, state, slips in rows if slips]
    assert len(seen) >= 1
    push, bound = seen[0]
    assert push < true + 0.4 * RAMP  # within 0.4 s
    assert bound == pytest.approx(true, abs=0.15 * RAMP)


def test_near_an_obstacle_it_is_seen_before_it_is_fast(ramped):
    ways = {}
    for tight in (False, True):
        true, rows = ramped(0.3, seconds=6.0, ramp=6.0, tight=tight)
        push, way = next((push, float(state.seen.pose[0])) for _, push, state, slips in rows if slips)
        assert true < push < true + 4.0
        ways[tight] = way
    assert breakaway.SHIFT < ways[True] < 0.02 < 0.025 < ways[False]


@pytest.mark.parametrize("tight", [False, True])
def test_an_object_that_sticks_is_not_seen_to_slip(ramped, tight):
    true, rows = ramped(0.4, seconds=20.0, hold=15.0, tight=tight)
    assert true > 15.0
    assert not any(slips for *_, slips in rows)
    assert all(bool(state.waiting) for _, _, state, _ in rows)


def test_an_object_that_has_come_to_rest_is_waited_for_again(make_scenario):
    scenario = make_scenario()
    shapes, random = shapes_of(scenario), np.random.default_rng(1)
    state, waits = breakaway.start(jnp.zeros(3)), []
    for k in range(200):
        place = 0.4 * min(k * TICK, 1.5)  # 0.4 m/s for 1.5 s, then at rest
        measured = jnp.asarray([place, 0.0, 0.0]) + jnp.asarray(random.normal(size=3) * [0.005, 0.005, 0.01])
        state, _ = watch(state, measured.astype(jnp.float32), jnp.asarray(10.0), shapes, TICK)
        waits.append(bool(state.waiting))
    assert not any(waits[25:75])
    assert waits[-1]


def test_a_slip_lowers_friction_to_the_push_and_never_raises_it(make_scenario):
    scenario = make_scenario()
    parameters = adaptation.start(scenario.object, CONFIG.adaptation)
    before = start_object(jnp.zeros(3))
    state = breakaway.start(jnp.zeros(3))
    least = float(CONFIG.safety.friction * parameters.psi[0] * dynamics.GRAVITY / parameters.psi[4])
    for push, slips, share in ((8.0, True, None), (8.0, False, 1.0), (1e3, True, 1.0), (0.0, True, least)):
        seen = dataclasses.replace(state, push=jnp.asarray(push), seen=moving(state.seen, [0.2, 0.0, 0.1]))
        estimate, after = breakaway.corrected(before, parameters, seen, jnp.asarray(slips), CONFIG)
        expected = push / float(parameters.psi[4]) if share is None else share
        np.testing.assert_allclose(after.psi[4:], expected * parameters.psi[4:], rtol=1e-5)
        np.testing.assert_allclose(after.filtered[4:], expected * parameters.filtered[4:], rtol=1e-5)
        np.testing.assert_allclose(after.psi[:4], parameters.psi[:4])
        assert estimate.twist[0] == pytest.approx(0.2 if slips else 0.0)


@pytest.mark.parametrize("part", ["gain", "breakaway", "filter"])
def test_nothing_is_learnt_of_a_slip_where_it_should_not(make_scenario, part):
    """Without adaptation, without this part of it, or where pushes may be sudden."""
    adaptation_settings = {"gain": {"gain": (0.0,) * 6}, "breakaway": {"breakaway": 0.0}}.get(part, {})
    config = dataclasses.replace(
        CONFIG,
        adaptation=dataclasses.replace(CONFIG.adaptation, **adaptation_settings),
        safety=dataclasses.replace(CONFIG.safety, enabled=0.0 if part == "filter" else 1.0),
    )
    parameters = adaptation.start(make_scenario().object, config.adaptation)
    state = breakaway.start(jnp.zeros(3))
    seen = dataclasses.replace(state, seen=moving(state.seen, [1.0, 1.0, 1.0]))
    estimate, after = breakaway.corrected(start_object(jnp.zeros(3)), parameters, seen, jnp.asarray(True), config)
    np.testing.assert_array_equal(after.psi, parameters.psi)
    np.testing.assert_array_equal(estimate.twist, 0.0)
