"""Parameter adaptation: projection, the direction of learning, and convergence on a pushed object."""

import dataclasses

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from jaxlocomanip.loop import task_of
from jaxlocomanip.planar import dynamics, regressor
from jaxlocomanip.planar.dynamics import GRAVITY
from jaxlocomanip.planner import adaptation, nmpc
from jaxlocomanip.planner import state as planner_state
from jaxlocomanip.planner.adaptation import ParameterEstimate
from jaxlocomanip.planner.config import Adaptation, PlannerConfig
from jaxlocomanip.planner.state import Measurement
from jaxlocomanip.worlds.interface import Push
from jaxlocomanip.worlds.planar import PlanarWorld

TICK = 0.02
SETTINGS = Adaptation()
FRICTION = regressor.FRICTION
project = jax.jit(adaptation.project)


def test_starts_from_the_belief_and_the_prior_friction(make_scenario):
    unknown = adaptation.start(make_scenario().object, SETTINGS)
    assert unknown.body.mass == 6.0
    assert unknown.body.friction_force == pytest.approx(SETTINGS.prior_friction * 6.0 * GRAVITY, rel=1e-6)
    known = adaptation.start(make_scenario(object={"size": [0.5, 0.5], "mass": 6.0, "friction": 0.2}).object, SETTINGS)
    assert known.body.friction_force == pytest.approx(0.2 * 6.0 * GRAVITY, rel=1e-6)


def test_projection_keeps_a_possible_body_and_moves_others_to_the_box(x64, make_scenario):
    model = make_scenario().object
    inside = adaptation.start(model, SETTINGS).psi
    assert np.allclose(project(inside, model, SETTINGS), inside, rtol=0.0, atol=0.0)
    rng = np.random.default_rng(0)
    span, belief = SETTINGS.mass_range, model.body
    largest = SETTINGS.max_friction * belief.mass * span * GRAVITY
    for _ in range(50):
        psi = project(jnp.asarray(rng.normal(size=6) * 10.0 ** rng.uniform(-2, 4)), model, SETTINGS)
        body = regressor.to_body(psi)
        assert belief.mass / span <= body.mass <= belief.mass * span
        assert belief.inertia / span <= body.inertia <= belief.inertia * span
        assert np.abs(body.com).max() <= 0.4 * np.hypot(0.25, 0.25) + 1e-12
        assert 0.0 <= body.friction_force <= largest
        assert 0.4 * model.torsion_radius * body.friction_force <= body.friction_moment + 1e-12
        assert body.friction_moment <= 2.0 * model.torsion_radius * body.friction_force + 1e-12
        assert np.allclose(project(psi, model, SETTINGS), psi, rtol=1e-14)


@jax.jit
def learn(model, believed, true, push, settings=SETTINGS, held=jnp.inf, at=0.0):
    """Friction believed, and the estimate after one tick of a push at rest, learnt from the difference in velocity.

    The push is `at` m beside the body point, and `held` what the floor is known to hold.
    """

    def rubbing(force):
        force = jnp.asarray(force)
        return dataclasses.replace(model.body, friction_force=force, friction_moment=0.2 * force)

    psi, zero = regressor.from_body(rubbing(believed)), jnp.zeros(3)
    wrench = jnp.stack([jnp.asarray(push), jnp.zeros(()), -push * jnp.asarray(at)])
    observed = dynamics.step(rubbing(true), zero, zero, wrench, TICK, 0.0)[1]
    predicted = dynamics.step(regressor.to_body(psi), zero, zero, wrench, TICK, 0.02)[1]
    slope = adaptation.predict(psi, zero, zero, wrench, TICK, 0.02)[2](observed - predicted)
    return psi[FRICTION], adaptation.adapt(ParameterEstimate(psi, psi), slope, held, TICK, model, settings)


def test_an_object_at_rest_shows_little_more_than_that_the_floor_holds_the_push(x64, make_scenario):
    model = make_scenario().object
    moving = learn(model, believed=15.0, true=60.0, push=40.0, at=0.1)[1].psi
    resting = learn(model, believed=15.0, true=60.0, push=40.0, at=0.1, held=40.0)[1].psi
    assert np.abs(moving[2:4]).max() > 1e-4
    assert resting[:4].tolist() == [*map(float, regressor.from_body(model.body)[:4])]
    assert 15.0 < resting[FRICTION] < 40.0
    assert resting[5] / resting[FRICTION] == pytest.approx(0.2)
    for believed, held in ((49.9, 40.0), (60.0, 40.0)):
        psi = regressor.from_body(model.body).at[4:].set(jnp.array([believed, 0.2 * believed]))
        sliding = jnp.zeros(6).at[FRICTION].set(-100.0)  # asks for much more friction
        after = adaptation.adapt(ParameterEstimate(psi, psi), sliding, held, TICK, model, SETTINGS).psi
        assert after[FRICTION] == pytest.approx(max(believed, adaptation.BEYOND * held))


def test_the_papers_law_learns_at_rest_as_well(x64, make_scenario):
    paper = dataclasses.replace(SETTINGS, on_prediction=0.0)
    model = make_scenario().object
    moving, resting = (learn(model, 15.0, 60.0, 40.0, paper, held, at=0.1)[1].psi for held in (jnp.inf, 40.0))
    assert resting.tolist() == moving.tolist()


def test_friction_rises_while_the_prediction_slides_and_the_object_sticks(x64, make_scenario):
    before, after = learn(make_scenario().object, believed=15.0, true=60.0, push=40.0)
    assert after.psi[FRICTION] > before
    assert before < after.filtered[FRICTION] < after.psi[FRICTION]


def test_friction_falls_while_the_object_slides_more_than_predicted(x64, make_scenario):
    before, after = learn(make_scenario().object, believed=30.0, true=10.0, push=40.0)
    assert after.psi[FRICTION] < before
    assert after.psi[FRICTION] < after.filtered[FRICTION] < before


def test_friction_falls_while_the_prediction_sticks_and_the_object_slides(x64, make_scenario):
    before, after = learn(make_scenario().object, believed=50.0, true=10.0, push=40.0)
    assert after.psi[FRICTION] < before


def test_without_gain_nothing_is_learnt(x64, make_scenario):
    off = dataclasses.replace(SETTINGS, gain=(0.0,) * 6)
    _, after = learn(make_scenario().object, believed=15.0, true=60.0, push=40.0, settings=off)
    assert after.psi[FRICTION] == 15.0
    assert np.allclose(after.filtered, after.psi, rtol=0.0, atol=0.0)


def test_prediction_slope_is_a_gradient(x64, make_scenario):
    """Minus the derivative of s' M qdd by the parameters, M held, against finite differences."""
    rng = np.random.default_rng(1)
    model = make_scenario().object
    psi = adaptation.start(model, SETTINGS).psi + jnp.array([0.5, 0.1, 0.2, -0.1, 3.0, 0.4])
    pose, twist, error = (jnp.asarray(rng.normal(size=3)) for _ in range(3))
    wrench = jnp.asarray(rng.normal(size=3) * 20.0)
    slope = jax.jit(lambda p, e: adaptation.predict(p, pose, twist, wrench, TICK, 0.02)[2](e))(psi, error)
    mass = dynamics.mass_matrix(regressor.to_body(psi), pose[2])

    @jax.jit
    def value(p):
        new = dynamics.step(regressor.to_body(p), pose, twist, wrench, TICK, 0.02)[1]
        return error @ mass @ (new - twist) / TICK

    h = 1e-5
    for i in range(6):
        step = jnp.zeros(6).at[i].set(h)
        assert slope[i] == pytest.approx(-float(value(psi + step) - value(psi - step)) / (2 * h), rel=1e-5, abs=1e-7)


def test_reference_slope_is_the_regressor_of_the_paper(x64, make_scenario):
    """On the reference nothing is learnt; off it, Y' s with the reference velocity and acceleration of the paper."""
    psi = adaptation.start(make_scenario().object, SETTINGS).psi
    pose, twist = jnp.array([0.1, 0.2, 0.3]), jnp.array([0.3, -0.1, 0.2])
    on_it = adaptation.reference_slope(pose, twist, pose, twist, psi, 3.0, 0.02)
    assert np.abs(on_it).max() == 0.0
    target, target_twist = pose + jnp.array([0.1, 0.0, -0.1]), twist + jnp.array([0.2, 0.1, 0.0])
    s = (twist - target_twist) + 3.0 * (pose - target)
    body = dataclasses.replace(
        regressor.to_body(psi), friction_force=jnp.asarray(0.0), friction_moment=jnp.asarray(0.0)
    )
    needed = dynamics.mass_matrix(body, pose[2]) @ (-3.0 * (twist - target_twist))
    needed = needed + dynamics.coriolis_matrix(body, pose[2], twist[2]) @ (twist - s)
    off_it = adaptation.reference_slope(pose, twist, target, target_twist, psi, 3.0, 0.02)
    assert off_it[:4] @ psi[:4] == pytest.approx(float(s @ needed), rel=1e-9)


def test_friction_converges_on_a_pushed_object(make_scenario):
    """An object of the believed mass but unknown friction, pushed to and fro in speed by a simple controller."""
    config, world = PlannerConfig(), PlanarWorld()
    truth = {"friction": 0.55}
    scenario = make_scenario(truth=truth, robots=[{"type": "aliengo", "face": "-x"}])
    task = task_of(scenario)

    def measure(state):
        places, touching = scenario.obstacles.position, jnp.ones(1, bool)
        return Measurement(state.pose, state.offset, places, touching, jnp.zeros((), jnp.int32))

    def tick(carry, k):
        state, planner = carry
        planner_object, parameters, obstacles, force, watched = nmpc.observe(planner, measure(state), task, config)
        speed = 0.3 + 0.15 * jnp.sin(2.0 * k * TICK)
        push = jnp.clip(30.0 + 100.0 * (speed - state.twist[:1]), 0.0, scenario.team.force_max)
        command = dataclasses.replace(planner.command, force=push)
        planner = dataclasses.replace(
            planner,
            object=planner_object,
            parameters=parameters,
            obstacles=obstacles,
            force=force,
            offset=state.offset,
            breakaway=watched,
            command=command,
        )
        asked = Push(push, jnp.zeros(1), jnp.zeros(3), jnp.zeros((), bool))
        return (world.step(state, scenario, asked, 0.0, TICK), planner), parameters.psi

    start = world.start(scenario)
    carry = start, planner_state.start(task, measure(start), config)
    _, psis = jax.jit(lambda c: jax.lax.scan(tick, c, jnp.arange(750.0)))(carry)
    friction = np.asarray(psis)[:, FRICTION]
    true = float(scenario.truth.friction_force)
    assert abs(friction[0] - true) > 0.25 * true
    assert np.abs(friction[-150:] - true).max() < 0.1 * true
