"""From the planner's command to the robots' references: approach, contact, push, slide, rest."""

import dataclasses

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from jaxlocomanip.locomotion.robot import BodyState
from jaxlocomanip.worlds import contact
from jaxlocomanip.worlds.contact import ContactSettings
from jaxlocomanip.worlds.interface import Push
from jaxlocomanip.worlds.legged import read_robot

SETTINGS, PERIOD = ContactSettings(), 0.01
POSE = jnp.array([1.0, -0.5, 0.4])
STILL = jnp.zeros(3)


@pytest.fixture(scope="module")
def team(make_scenario):
    return make_scenario().team


@pytest.fixture(scope="module")
def legged():
    robot = read_robot("aliengo")
    return jax.tree.map(lambda leaf: jnp.stack([leaf, leaf]), robot)


def bodies(team, legged, gap, offset, pose=POSE):
    """Robots that face their faces squarely, at a distance and an offset [N_r] from the middle."""
    origin, normal, tangent = (np.asarray(v) for v in (team.origin, team.normal, team.tangent))
    front = np.asarray(legged.pusher[:, 0] + legged.pusher_radius)
    at_B = origin - (gap + front)[:, None] * normal + np.asarray(offset)[:, None] * tangent
    c, s = np.cos(pose[2]), np.sin(pose[2])
    xy = np.asarray(pose[:2]) + at_B @ np.array([[c, s], [-s, c]])
    yaw = np.arctan2(normal[:, 1], normal[:, 0]) + float(pose[2])
    turn = np.zeros((2, 3, 3))
    turn[:, 0, 0] = turn[:, 1, 1] = np.cos(yaw)
    turn[:, 1, 0], turn[:, 0, 1] = np.sin(yaw), -np.sin(yaw)
    turn[:, 2, 2] = 1.0
    height = np.asarray(legged.stand_height)[:, None]
    none = jnp.zeros((2, 4, 3))
    place = jnp.asarray(np.concatenate([xy, height], axis=1))
    return BodyState(place, jnp.asarray(turn), jnp.zeros((2, 3)), jnp.zeros((2, 3)), none, none)


def seen(team, legged, gap=(0.1, 0.1), offset=(0.0, 0.0)):
    return contact.look(POSE, bodies(team, legged, np.array(gap), offset), legged, team)


def pushing(force=(20.0, 30.0), rate=(0.0, 0.0), twist=STILL, resting=False):
    return Push(jnp.asarray(force), jnp.asarray(rate), twist, jnp.asarray(resting))


def ask(state, team, faces, push=None, touching=(True, True), twist=STILL, settings=SETTINGS, calls=1):
    """State and motion after some calls in an unchanging situation."""
    one = jax.jit(lambda s: contact.command(s, POSE, twist, jnp.asarray(touching), faces, team, push, settings, PERIOD))
    push = pushing() if push is None else push
    motion = None
    for _ in range(calls):
        state, motion = one(state)
    return state, motion


def along(faces, motion):
    """Asked velocities [N_r] along the push direction and along the tangent."""
    normal = np.asarray(faces.normal)
    tangent = np.stack([-normal[:, 1], normal[:, 0]], axis=1)
    velocity = np.asarray(motion.velocity)
    return (velocity * normal).sum(1), (velocity * tangent).sum(1)


def test_gap_offset_and_contact_point_are_those_of_the_place(team, legged):
    faces = seen(team, legged, gap=(0.12, 0.03), offset=(0.05, -0.08))
    np.testing.assert_allclose(faces.gap, [0.12, 0.03], atol=1e-5)
    np.testing.assert_allclose(faces.offset, [0.05, -0.08], atol=1e-5)
    np.testing.assert_allclose(np.linalg.norm(faces.normal, axis=1), 1.0, atol=1e-6)
    touching = seen(team, legged, gap=(0.0, 0.0), offset=(0.05, -0.08))
    expected_B = np.asarray(team.contact_points(jnp.array([0.05, -0.08])))
    c, s = np.cos(0.4), np.sin(0.4)
    expected = np.asarray(POSE[:2]) + expected_B @ np.array([[c, s], [-s, c]])
    np.testing.assert_allclose(touching.point[:, :2], expected, atol=1e-5)


def test_robots_walk_up_to_their_faces_and_never_fast(team, legged):
    for gap in (0.02, 0.1, 2.0):
        faces = seen(team, legged, gap=(gap, gap))
        _, motion = ask(contact.start(team, faces), team, faces, touching=(False, False))
        ahead, aside = along(faces, motion)
        assert (ahead >= 0.04).all() and (ahead <= SETTINGS.approach_max + 1e-6).all()
        np.testing.assert_allclose(aside, 0.0, atol=1e-5)
        np.testing.assert_allclose(motion.force, 0.0)
        assert np.asarray(motion.walking).all()
        heading = np.arctan2(np.asarray(faces.normal)[:, 1], np.asarray(faces.normal)[:, 0])
        np.testing.assert_allclose(motion.heading, heading, atol=1e-6)


def test_nobody_pushes_before_everybody_has_touched(team, legged):
    faces = seen(team, legged, gap=(0.0, 0.1))
    state, motion = ask(contact.start(team, faces), team, faces, touching=(True, False), calls=100)
    force = np.linalg.norm(motion.force, axis=1)
    np.testing.assert_allclose(force, [SETTINGS.hold, 0.0], atol=1e-5)
    assert not contact.at_face(state, faces, SETTINGS).any()


def test_the_push_rises_and_acts_against_the_robot(team, legged):
    faces = seen(team, legged, gap=(0.0, 0.0))
    state = contact.start(team, faces)
    rising = []
    for _ in range(60):
        state, motion = ask(state, team, faces)
        rising.append(np.asarray(motion.force))
    sizes = np.linalg.norm(np.array(rising), axis=2)
    assert (np.diff(sizes, axis=0) >= -1e-5).all() and np.diff(sizes, axis=0).max() < 1.0
    np.testing.assert_allclose(sizes[-1], [20.0, 30.0], rtol=1e-5)
    np.testing.assert_allclose(rising[-1][:, :2], -np.array([[20.0], [30.0]]) * np.asarray(faces.normal), rtol=1e-4)
    assert contact.at_face(state, faces, SETTINGS).all()


def test_a_robot_is_never_asked_for_more_than_its_feet_hold(team, legged):
    faces = seen(team, legged, gap=(0.0, 0.0))
    _, motion = ask(contact.start(team, faces), team, faces, pushing((500.0, -5.0)), calls=100)
    np.testing.assert_allclose(np.linalg.norm(motion.force, axis=1), [float(team.force_max[0]), 0.0], rtol=1e-5)


def test_a_robot_that_lost_its_face_pushes_no_air(team, legged):
    faces = seen(team, legged, gap=(0.0, 0.0))
    state, _ = ask(contact.start(team, faces), team, faces, calls=100)
    apart = seen(team, legged, gap=(0.2, 0.0))
    state, motion = ask(state, team, apart, touching=(False, True))
    np.testing.assert_allclose(np.linalg.norm(motion.force, axis=1), [0.0, 30.0], atol=1e-4)
    assert contact.at_face(state, apart, SETTINGS).tolist() == [False, True]


def test_robots_move_with_their_faces(team, legged):
    """In touch and asked for the object's own velocity, each robot moves as the point of the object it touches."""
    faces = seen(team, legged, gap=(0.0, 0.0), offset=(0.1, -0.05))
    twist = jnp.array([0.2, -0.1, 0.3])
    state, _ = ask(contact.start(team, faces), team, faces, calls=100)
    _, motion = ask(state, team, faces, pushing(twist=twist), twist=twist)
    arm = np.asarray(faces.point[:, :2] - POSE[:2])
    expected = np.array([0.2, -0.1]) + 0.3 * np.stack([-arm[:, 1], arm[:, 0]], axis=1)
    np.testing.assert_allclose(motion.velocity, expected, atol=1e-4)
    np.testing.assert_allclose(motion.yaw_rate, 0.3, atol=1e-6)


def test_an_offset_is_led_but_never_far(team, legged):
    faces = seen(team, legged, gap=(0.0, 0.0))
    state, motion = ask(contact.start(team, faces), team, faces, pushing(rate=(0.1, -0.1)), calls=200)
    np.testing.assert_allclose(state.offset, [SETTINGS.offset_lead, -SETTINGS.offset_lead], atol=1e-5)
    _, aside = along(faces, motion)
    lead = SETTINGS.offset_gain * SETTINGS.offset_lead
    np.testing.assert_allclose(aside, [0.1 + lead, -0.1 - lead], atol=1e-4)


def test_no_offset_rate_is_followed_that_could_not_be_turned_back(team, legged):
    faces = seen(team, legged, gap=(0.0, 0.0))
    state = ask(contact.start(team, faces), team, faces)[0]
    _, fast = ask(state, team, faces, pushing(rate=(0.5, -0.5)))
    _, fastest = ask(state, team, faces, pushing(rate=(SETTINGS.slide_max, -SETTINGS.slide_max)))
    np.testing.assert_allclose(fast.velocity, fastest.velocity)
    _, aside = along(faces, fast)
    np.testing.assert_allclose(aside, [SETTINGS.slide_max, -SETTINGS.slide_max], rtol=0.1)


def test_once_arrived_robots_step_back_and_stand_until_woken(team, legged):
    rest = pushing((0.0, 0.0), resting=True)
    touching, apart = seen(team, legged, gap=(0.0, 0.0)), seen(team, legged, gap=(0.02, 0.02))
    state, _ = ask(contact.start(team, touching), team, touching, calls=100)
    state, motion = ask(state, team, touching, rest, calls=100)
    ahead, _ = along(touching, motion)
    assert (ahead < 0.0).all() and np.asarray(motion.walking).all()
    state, motion = ask(state, team, apart, rest, touching=(False, False), calls=200)
    assert not np.asarray(motion.walking).any()
    np.testing.assert_allclose(motion.force, 0.0, atol=1e-6)
    _, motion = ask(state, team, apart, pushing())
    assert np.asarray(motion.walking).all()


def test_a_moving_object_lets_nobody_stand(team, legged):
    rest, apart = pushing((0.0, 0.0), resting=True), seen(team, legged, gap=(0.02, 0.02))
    state = dataclasses.replace(contact.start(team, apart), touched=jnp.ones(2, bool))
    _, motion = ask(state, team, apart, rest, twist=jnp.array([0.0, 0.0, 0.2]), calls=200)
    assert np.asarray(motion.walking).all()
    _, motion = ask(state, team, apart, rest, calls=200)
    assert not np.asarray(motion.walking).any()  # once it stands, they do
