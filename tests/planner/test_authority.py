"""What a team that can only push can do."""

import dataclasses

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from jaxlocomanip.planar.dynamics import body_wrench
from jaxlocomanip.planner.authority import USABLE_RANGE, pushability, share, sliding_wrench

FOUR = [{"type": "aliengo", "face": face} for face in ("-x", "-y", "+x", "+y")]
RADIUS = 0.2
UNBOUNDED = 1e6
share_jit, pushability_jit = jax.jit(share), jax.jit(pushability)


@pytest.fixture
def team(make_scenario):
    """A function: team of the first so many of four robots around a box."""

    def make(count):
        return make_scenario(object={"size": [0.8, 0.8], "mass": 6.0}, robots=FOUR[:count]).team

    return make


@pytest.fixture
def body(make_scenario):
    return make_scenario(object={"size": [0.8, 0.8], "mass": 6.0, "friction": 0.4}).object.body


def test_a_reachable_wrench_is_shared_exactly(x64, team):
    rng = np.random.default_rng(0)
    for count in (2, 4):
        made = team(count)
        ends = USABLE_RANGE * np.stack([made.free_low, made.free_high])
        for _ in range(10):
            offset = rng.uniform(ends[0], ends[1])
            force = rng.uniform(5.0, 40.0, count)
            wrench = body_wrench(made.contact_points(jnp.asarray(offset)), made.normal, jnp.asarray(force))
            forces, offsets, residual = share_jit(made, wrench, RADIUS, UNBOUNDED)
            assert residual < 5e-3
            assert (forces >= 0.0).all()
            assert (np.abs(offsets) <= np.asarray(made.offset_limit)).all()
            again = body_wrench(made.contact_points(offsets), made.normal, forces)
            scale = np.hypot(np.hypot(wrench[0], wrench[1]), wrench[2] / RADIUS)
            assert np.allclose(np.asarray(again - wrench) / [1, 1, RADIUS], 0.0, atol=2e-2 * scale)


def test_two_robots_cannot_pull(x64, team):
    made = team(2)
    for wrench in ([-20.0, 0.0, 0.0], [0.0, -20.0, 0.0], [-10.0, -10.0, 0.0]):
        forces, _, residual = share_jit(made, jnp.array(wrench), RADIUS, UNBOUNDED)
        assert residual > 0.9
        assert np.abs(forces).max() < 1.0


def test_sharing_scales_with_the_wrench(x64, team):
    made, wrench = team(2), jnp.array([20.0, 10.0, 1.0])
    once, twice = share_jit(made, wrench, RADIUS, UNBOUNDED), share_jit(made, 2.0 * wrench, RADIUS, UNBOUNDED)
    assert np.allclose(2.0 * once[0], twice[0], rtol=1e-9)
    assert np.allclose(once[1], twice[1], atol=1e-9)


def test_pushability_of_two_robots_on_neighbouring_faces(x64, team, body):
    misfit = pushability_jit(
        team(2),
        body,
        jnp.array([[1.0, 0, 0], [0, 1.0, 0], [0.7, 0.7, 0], [-1.0, 0, 0], [0, -1.0, 0]]),
        RADIUS,
    )
    assert (misfit[:3] < 0.02).all()
    assert (misfit[3:] > 0.9).all()


def test_four_robots_go_anywhere_and_turn_on_the_spot(x64, team, body):
    angles = np.linspace(0.0, 2.0 * np.pi, 8, endpoint=False)
    slides = np.stack([np.cos(angles), np.sin(angles), 0.0 * angles], axis=1)
    turns = np.array([[0.0, 0.0, 0.4], [0.0, 0.0, -0.4]])
    twists = jnp.asarray(np.concatenate([slides, turns]))
    assert (pushability_jit(team(4), body, twists, RADIUS) < 0.02).all()
    assert (pushability_jit(team(2), body, twists[-2:], RADIUS) > 0.1).all()


def test_sliding_wrench_has_the_size_of_the_friction(x64, body):
    wrench = sliding_wrench(body, jnp.array([0.3, -0.4, 0.0]), 0.0)
    assert np.allclose(wrench[:2], body.friction_force * jnp.array([0.6, -0.8]), rtol=1e-6)
    spin = sliding_wrench(body, jnp.array([0.0, 0.0, -2.0]), 0.0)
    assert spin[2] == pytest.approx(-float(body.friction_moment), rel=1e-6)


def test_no_robot_is_asked_for_more_than_it_can_push(x64, team):
    made = team(2)
    forces, _, residual = share_jit(made, jnp.array([30.0, 5.0, 0.0]), RADIUS, jnp.array([20.0, 50.0]))
    assert residual > 0.2
    assert (forces <= np.array([20.0, 50.0]) + 1e-6).all()
    assert forces[0] == pytest.approx(20.0, abs=0.1)


def test_a_heavy_object_is_pushed_along_no_face_alone(x64, team, body):
    """Two robots may together overcome a friction that neither does alone."""
    made, along = team(2), jnp.array([[1.0, 0.0, 0.0], [1.0, 1.0, 0.0]])
    friction = 1.2 * float(made.force_max[0])
    heavy = dataclasses.replace(body, friction_force=jnp.asarray(friction), friction_moment=jnp.asarray(0.2 * friction))
    alone, together = pushability_jit(made, heavy, along, RADIUS)
    assert alone > 0.1
    assert together < 0.02
