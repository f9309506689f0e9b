"""Random objects are recognised from five seconds of motion, with and without noise."""

import dataclasses
import re

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from jaxlocomanip.checked import InputError
from jaxlocomanip.closed_loop import simulate
from jaxlocomanip.identification import Knowledge, Recording, identify, recording_of, replay
from jaxlocomanip.planar.dynamics import GRAVITY, Body
from jaxlocomanip.planner.config import Horizon, PlannerConfig
from jaxlocomanip.worlds.planar import PlanarWorld

TICK, TICKS, OBJECTS = 0.02, 250, 8
WORLD = PlanarWorld()


def random_body(rng, torsion_radius):
    """Half to twice the mass believed, which the team can move, its centre up to 8 cm off."""
    mass = rng.uniform(3.0, 12.0)
    friction = min(rng.uniform(0.15, 0.5), 40.0 / (mass * GRAVITY))
    com, force = rng.uniform(-0.06, 0.06, 2), friction * mass * GRAVITY
    inertia = mass * (rng.uniform(0.03, 0.06) + com @ com)
    return Body(mass, inertia, com, force, force * torsion_radius * rng.uniform(0.9, 1.1))


def random_pushes(rng):
    """Both robots push in waves and walk to and fro along their faces."""
    time = np.arange(TICKS)[:, None] * TICK
    turns = 2.0 * np.pi * time / rng.uniform([1.0, 1.0, 1.5, 1.5], [2.5, 2.5, 3.0, 3.0]) + rng.uniform(0.0, 6.3, 4)
    return 24.0 + 24.0 * np.sin(turns[:, :2]), 0.15 * np.sign(np.sin(turns[:, 2:]))


def arrays(tree):
    return jax.tree.map(lambda leaf: jnp.asarray(np.asarray(leaf), float), tree)


def record(scenario, body, force, rate):
    made = dataclasses.replace(scenario, truth=body)
    start = WORLD.start(made)
    empty = Recording(jnp.zeros((TICKS + 1, 3)), force, rate, start.offset, start.force)
    return dataclasses.replace(empty, pose=replay(empty, made, start, WORLD, TICK))


fit = jax.jit(jax.vmap(lambda made, r, known: identify(r, made, TICK, known), (None, 0, None)))


@pytest.fixture(scope="module")
def objects(make_scenario):
    """Scenario, true bodies and recordings [OBJECTS, ...]."""
    scenario = jax.tree.map(jnp.asarray, make_scenario())
    rng = np.random.default_rng(0)
    bodies = [random_body(rng, float(scenario.object.torsion_radius)) for _ in range(OBJECTS)]
    pushes = [random_pushes(rng) for _ in range(OBJECTS)]
    truth = arrays(jax.tree.map(lambda *leaves: np.stack(leaves), *bodies))
    force, rate = arrays(tuple(np.stack(part) for part in zip(*pushes, strict=True)))
    return scenario, truth, jax.jit(jax.vmap(record, (None, 0, 0, 0)))(scenario, truth, force, rate)


def errors(found, truth):
    """Relative errors of mass and friction, and that of the centre of mass in m."""
    friction = truth.friction_force / (truth.mass * GRAVITY)
    off = np.linalg.norm(found.body.com - truth.com, axis=1)
    return np.abs(found.body.mass / truth.mass - 1.0), np.abs(found.friction / friction - 1.0), off


def test_noiseless_motion(objects):
    scenario, truth, recording = objects
    found = fit(scenario, recording, arrays(Knowledge()))
    mass, friction, com = errors(found, truth)
    assert mass.max() < 0.02 and friction.max() < 0.02 and com.max() < 5e-3
    # Of some objects the last transition of friction is too narrow for another step to mean much.
    assert np.median(np.abs(found.step).max(axis=1)) < 0.05
    # The belief is far off: nothing of this is the prior's.
    assert np.abs(truth.mass / scenario.object.body.mass - 1.0).max() > 0.3
    assert np.linalg.norm(truth.com, axis=1).max() > 0.03


def test_noisy_poses(objects):
    scenario, truth, recording = objects
    noise = 5e-3 * np.random.default_rng(1).normal(size=recording.pose.shape)
    noisy = dataclasses.replace(recording, pose=recording.pose + noise.astype(recording.pose.dtype))
    found = fit(scenario, noisy, arrays(Knowledge(position=5e-3, heading=5e-3)))
    mass, friction, com = errors(found, truth)
    assert mass.max() < 0.1 and friction.max() < 0.1 and com.max() < 0.01
    assert (np.abs(found.misfit - 1.0) < 0.1).all()
    # The deviations that it states are those that it has.
    off = np.concatenate([np.log(found.body.mass / truth.mass), (found.body.com - truth.com).ravel()])
    stated = np.concatenate([found.deviation[:, 0], found.deviation[:, 2:4].ravel()])
    assert 0.5 < np.sqrt(np.mean((off / stated) ** 2)) < 2.0


def test_an_object_that_is_believed_to_slide_freely(objects):
    scenario, truth, recording = objects
    believed = dataclasses.replace(scenario.object.body, friction_force=jnp.zeros(()), friction_moment=jnp.zeros(()))
    known = dataclasses.replace(scenario.object, body=believed, friction_known=jnp.ones((), bool))
    found = fit(dataclasses.replace(scenario, object=known), recording, arrays(Knowledge()))
    mass, friction, com = errors(found, truth)
    assert mass.max() < 0.02 and friction.max() < 0.02 and com.max() < 5e-3


def test_a_wrong_model_shows_in_the_misfit(objects):
    """Somebody else pushed as well."""
    scenario, _, recording = objects
    drift = jnp.linspace(0.0, 1.0, TICKS + 1)[:, None] ** 2 * jnp.array([0.0, 0.5, 1.0])
    found = fit(scenario, dataclasses.replace(recording, pose=recording.pose + drift), arrays(Knowledge()))
    assert (found.misfit > 3.0).mean() > 0.7


@pytest.mark.parametrize(
    ("change", "text"),
    [
        ({"pose": np.zeros((TICKS, 3))}, f"recording.pose has shape [250, 3]: must be [T + 1, 3] = [{TICKS + 1}, 3]"),
        ({"pose": np.full((TICKS + 1, 3), np.nan)}, "recording.pose[0, 0] = nan: must be finite"),
        (
            {"offset_rate": np.zeros((TICKS, 3))},
            "recording.offset_rate has shape [250, 3]: must be [T, N_r] = [250, 2]",
        ),
        ({"acting": np.zeros(3)}, "recording.acting has shape [3]: must be [N_r] = [2]"),
        ({"force": np.zeros((0, 2))}, "recording.force has no rows"),
    ],
)
def test_bad_recordings_are_refused(make_scenario, change, text):
    force, offset = np.zeros((TICKS, 2)), np.zeros(2)
    fine = Recording(np.zeros((TICKS + 1, 3)), force, force, offset, offset)
    with pytest.raises(InputError, match=re.escape(text)):
        identify(dataclasses.replace(fine, **change), make_scenario(), TICK)


def test_bad_knowledge_is_refused(make_scenario):
    force, offset = np.zeros((TICKS, 2)), np.zeros(2)
    fine = Recording(np.zeros((TICKS + 1, 3)), force, force, offset, offset)
    with pytest.raises(InputError, match=r"knowledge.heading = 0.0: must be > 0"):
        identify(fine, make_scenario(), TICK, Knowledge(heading=0.0))
    with pytest.raises(InputError, match=r"tick = -0.02: must be > 0"):
        identify(fine, make_scenario(), -TICK)


@pytest.mark.slow
def test_from_the_log_of_a_closed_loop(make_scenario):
    truth = {"mass": 9.0, "friction": 0.35, "com": [0.03, -0.04]}
    scenario = jax.tree.map(jnp.asarray, make_scenario(truth=truth, duration=5.02))
    log = simulate(scenario, PlannerConfig(horizon=Horizon(steps=8))).log
    recording = recording_of(log, TICK)
    assert recording.force.shape == (TICKS, 2)
    # The team hardly turns the object, so that little noise would hide its centre of mass.
    exact = Knowledge(position=1e-4, heading=1e-4)
    found = jax.jit(lambda r, s: identify(r, s, TICK, exact))(recording, scenario)
    mass, friction, com = errors(
        jax.tree.map(lambda v: v[None], found), jax.tree.map(lambda v: v[None], scenario.truth)
    )
    assert mass < 0.02 and friction < 0.02 and com < 5e-3
