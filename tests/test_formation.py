"""Walks of a team around the object: where they lead, and that nobody gets in anybody's way."""

import dataclasses

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from jaxlocomanip import build_scenario, find_scenario
from jaxlocomanip.formation import PHASES, circle, count, standing, team_in, usable, walk_around
from jaxlocomanip.padding import Padding, stack
from jaxlocomanip.planar.geometry import polygon_distance, rectangle

SPEC = dataclasses.replace(find_scenario("adaptive"), change_faces=True)
PHASE = jnp.linspace(0.0, PHASES, 61)


def made(faces=("-x", "-y"), types=("aliengo", "go1"), footprint=None, **changes):
    robots = tuple(
        dataclasses.replace(SPEC.robots[0], face=face, type=kind, offset=0.0)
        for face, kind in zip(faces, types, strict=True)
    )
    spec = dataclasses.replace(SPEC, robots=robots, **changes)
    if footprint is not None:
        spec = dataclasses.replace(spec, object=dataclasses.replace(spec.object, footprint=footprint, is_box=False))
    return build_scenario(spec)


def walk(scenario, now, wanted, offset=None):
    leaves, reaches = (team_in(scenario.team, scenario.formations, jnp.asarray(k)) for k in (now, wanted))
    offset = leaves.offset if offset is None else jnp.asarray(offset)
    size = count(scenario.formations)
    return walk_around(scenario.object.vertices, leaves, offset, reaches, jnp.asarray(now), jnp.asarray(wanted), size)


def test_robots_keep_their_faces_unless_they_may_change_them():
    scenario = made(change_faces=False)
    assert count(scenario.formations) == 1
    assert team_in(scenario.team, scenario.formations, jnp.asarray(0)) is scenario.team


def test_formations_move_every_robot_on_by_the_same_number_of_faces():
    scenario = made()
    assert count(scenario.formations) == 4 and usable(scenario.formations).all()
    for k in range(4):
        team = team_in(scenario.team, scenario.formations, jnp.asarray(k))
        turn = 0.5 * np.pi * k
        turned = scenario.team.normal @ np.array([[np.cos(turn), np.sin(turn)], [-np.sin(turn), np.cos(turn)]])
        np.testing.assert_allclose(team.normal, turned, atol=1e-6)
        np.testing.assert_allclose(team.force_max, scenario.team.force_max)
        np.testing.assert_array_equal(team.kind, scenario.team.kind)


def test_a_formation_whose_faces_are_too_short_is_not_usable():
    footprint = ((-0.4, -0.15), (0.4, -0.15), (0.4, 0.15), (-0.4, 0.15))
    scenario = made(faces=(0, 1), types=("aliengo", "aliengo"), footprint=footprint)
    spec = dataclasses.replace(
        SPEC,
        robots=(
            dataclasses.replace(SPEC.robots[0], face=0, offset=-0.3),
            dataclasses.replace(SPEC.robots[0], face=0, offset=0.3),
        ),
        object=dataclasses.replace(SPEC.object, footprint=footprint, is_box=False),
    )
    assert usable(scenario.formations).all()
    assert usable(build_scenario(spec).formations).tolist() == [True, False, True, False]


@pytest.mark.parametrize(("now", "wanted"), [(0, 1), (1, 0), (0, 3), (3, 2)])
def test_a_walk_leads_from_the_faces_to_the_next_ones_the_shorter_way(now, wanted):
    scenario = made()
    around = walk(scenario, now, wanted, offset=(0.1, -0.15))
    origin = jnp.zeros(3)
    leaves, reaches = (team_in(scenario.team, scenario.formations, jnp.asarray(k)) for k in (now, wanted))
    close = {"atol": 1e-5}
    first, last = around.poses(jnp.asarray(0.0)), around.poses(jnp.asarray(float(PHASES)))
    for pose, expected in (
        (first, leaves.robot_poses(origin, jnp.array([0.1, -0.15]))),
        (last, reaches.robot_poses(origin, reaches.offset)),
    ):
        np.testing.assert_allclose(pose[:, :2], expected[:, :2], **close)
        np.testing.assert_allclose(jnp.cos(pose[:, 2] - expected[:, 2]), 1.0, **close)
    assert (jnp.sign(around.turn) == (1 if (wanted - now) % 4 == 1 else -1)).all()
    assert (jnp.abs(around.turn) < 0.75 * np.pi).all()


def test_poses_of_a_walk_have_no_jumps():
    poses = jax.vmap(walk(made(), 0, 1, offset=(0.2, 0.1)).poses)(jnp.linspace(0.0, PHASES, 601))
    assert float(jnp.max(jnp.abs(jnp.diff(poses, axis=0)))) < 0.02


@pytest.mark.parametrize("faces", [("-x", "-y"), ("-x", "-y", "+x"), ("-y", "+x", "+y", "-x")])
def test_robots_stay_clear_of_each_other_and_of_the_object(faces):
    scenario = made(faces=faces, types=("aliengo", "a1", "go1", "aliengo")[: len(faces)])
    poses = jax.vmap(walk(scenario, 0, 1).poses)(PHASE)
    bodies = jax.vmap(jax.vmap(rectangle), in_axes=(0, None, None))(
        poses, scenario.team.half_length, scenario.team.half_width
    )
    distance = jax.jit(jax.vmap(lambda a, b: polygon_distance(a, 0.0, b, 0.0)))
    for i in range(len(faces)):
        for j in range(i):
            assert float(jnp.min(distance(bodies[:, i], bodies[:, j]))) > 0.02
        box = jnp.broadcast_to(scenario.object.vertices, (len(PHASE), *scenario.object.vertices.shape))
        assert float(jnp.min(distance(bodies[:, i], box))) > -1e-4


def test_robots_circle_beyond_the_corners_at_no_more_than_they_can_walk():
    scenario = made()
    around = walk(scenario, 0, 1)
    centre, radius = circle(scenario.object.vertices, scenario.team)
    middle = around.poses(jnp.asarray(1.5))
    np.testing.assert_allclose(jnp.linalg.norm(middle[:, :2] - centre, axis=1), radius, rtol=1e-5)
    speed = jnp.abs(around.turn) * radius / around.durations[1]
    assert (speed < scenario.team.slide_speed_max).all()


def test_a_team_that_walks_does_not_listen():
    scenario = made()
    team = standing(scenario.team)
    same, begins = team.asked(0, scenario.team.offset)
    assert not begins and bool(same.arrived)
    walking, begins = team.asked(1, scenario.team.offset)
    assert begins and not bool(walking.arrived)
    still, begins = walking.asked(2, scenario.team.offset)
    assert not begins and int(still.formation) == 1
    around = walking.walk(scenario)
    phase = jax.lax.fori_loop(0, 500, lambda _, phase: around.advance(phase, 0.02), walking.phase)
    assert float(phase) == PHASES


def test_scenarios_with_and_without_formations_share_a_batch():
    batch = stack([made(), made(change_faces=False)])
    assert Padding.of([made(), made(change_faces=False)]).formations == 3
    np.testing.assert_array_equal(batch.formations.usable, [[True] * 3, [False] * 3])
    np.testing.assert_array_equal(batch.formations.team.normal[1, 0], batch.team.normal[1])
