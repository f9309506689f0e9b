"""The path search: it avoids, it asks only for what the team can do, and it prefers no side."""

import dataclasses

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from jaxlocomanip.checked import InputError
from jaxlocomanip.planar.geometry import rotate, transform
from jaxlocomanip.planner import adaptation, path, search
from jaxlocomanip.planner.authority import pushability
from jaxlocomanip.planner.config import PlannerConfig
from jaxlocomanip.planner.estimation import ObstacleEstimate
from jaxlocomanip.planner.pose_grid import CELLS, FREE
from jaxlocomanip.planner.refine import guess_from, refine
from jaxlocomanip.planner.room import bodies_of, rooms_at
from jaxlocomanip.planner.search import Query
from jaxlocomanip.planner.shapes import ROBOT_DISCS, shapes_of

CONFIG = PlannerConfig()
AWAY = (20.0, 20.0)


@jax.jit
def search_path(scenario, shapes, obstacles, body, config):
    goal, first, zero, no = scenario.goal, jnp.zeros((), jnp.int32), jnp.zeros(()), jnp.zeros((), bool)
    query = Query(scenario.start, shapes.team.offset, goal, first, no, no, zero, first)
    rough = search.search_poses(query, shapes, scenario.formations, obstacles, body, config)
    guess = guess_from(rough.poses, shapes.team.offset, shapes, body, config)
    found = refine(guess, goal, shapes, obstacles, body, config)
    paced = path.pace(found.poses, shapes, body, config.reference.turn_radius, found.cost)
    return path.with_pushes(paced, found.force, found.offset, found.room, shapes.team)


@pytest.fixture
def find(make_scenario):
    """A function: path of two robots from the origin past circles at two places, and the scenario's shapes."""

    def run(places, goal=(4.0, 4.0, 0.0), velocity=(0.0, 0.0), exist=True, start=(0.0, 0.0, 0.0), radii=(0.3, 0.3)):
        circles = [
            {"shape": "circle", "radius": radius, "position": list(place)}
            for place, radius in zip(places, radii, strict=True)
        ]
        scenario = make_scenario(start={"pose": list(start)}, goal={"pose": list(goal)}, obstacles=circles)
        shapes = dataclasses.replace(shapes_of(scenario), obstacle_mask=jnp.full(2, exist))
        places = scenario.obstacles.position
        estimate = ObstacleEstimate(places, jnp.zeros_like(places) + jnp.asarray(velocity), jnp.zeros((2, 3)))
        body = adaptation.start(scenario.object, CONFIG.adaptation).body
        return search_path(scenario, shapes, estimate, body, CONFIG), shapes, body

    return run


def clearance(poses, shapes, place, radius=0.3, offsets=None):
    """Least distance of the discs of object and robots to a circle, over all poses of a path."""
    offsets = jnp.zeros((poses.shape[0], 2)) if offsets is None else offsets
    radii = jnp.concatenate([shapes.object_radii, jnp.repeat(shapes.robot_radii, ROBOT_DISCS)])

    def centers(pose, offset):
        robots = shapes.robot_centers(offset).reshape(-1, 2)
        return transform(pose, jnp.concatenate([shapes.object_centers, robots]))

    points = jax.vmap(centers)(poses, offsets)
    return float(jnp.min(jnp.linalg.norm(points - jnp.asarray(place), axis=-1) - radii - radius))


@jax.jit
def all_rooms(poses, offsets, places, shapes):
    """[3, n] room to obstacles that stand, to those that move, and within the team along a path."""
    rooms = rooms_at(poses.T, offsets.T, places[..., None], bodies_of(shapes, CONFIG))
    return jnp.stack([rooms.standing, rooms.moving, rooms.team])


def body_directions(path):
    """[n, 3] direction of the path at each pose, in body axes."""
    change = jnp.gradient(path.poses, axis=0)
    turned = jax.vmap(rotate)(-path.poses[:, 2], change[:, :2])
    twists = jnp.concatenate([turned, change[:, 2:]], axis=1)
    return twists / jnp.linalg.norm(twists, axis=1, keepdims=True)


@pytest.mark.parametrize("place", [(2.0, 2.0), (2.5, 1.8), (1.4, 1.8)])
def test_path_avoids_an_obstacle_on_the_line(x64, find, place):
    path, shapes, _ = find([place, AWAY])
    straight = jnp.linspace(0.0, 4.0, 100)[:, None] * jnp.array([1.0, 1.0, 0.0])
    assert clearance(straight, shapes, place) < -0.1
    assert clearance(path.poses, shapes, place, offsets=path.offset) > CONFIG.constraints.margin
    assert np.allclose(path.poses[0], 0.0, atol=1e-9)
    # It may end beside the goal by the share of the tolerances that costs nothing.
    miss = np.abs(np.asarray(path.poses[-1]) - [4.0, 4.0, 0.0]) / [0.15, 0.15, 0.3]
    assert max(np.hypot(*miss[:2]), miss[2]) < FREE + 0.05


@pytest.mark.parametrize("place", [(2.0, 2.0), (2.5, 1.8), AWAY])
def test_path_lies_in_the_cone_of_the_team(x64, find, place):
    """Two robots that push along +x and +y of the body never have to pull, and need no wrench they have not."""
    path, shapes, body = find([place, AWAY])
    directions = body_directions(path)
    assert directions[:, :2].min() > 0.0
    assert pushability(shapes.team, body, directions, shapes.torsion_radius).max() < 0.02
    assert (path.force >= 0.0).all()
    assert (np.abs(path.offset) <= np.asarray(shapes.team.offset_limit)).all()


def test_mirrored_layouts_have_mirrored_paths(x64, find):
    """Mirror about y = x: coordinates and robots change places, headings change sign."""
    path, _, _ = find([(2.5, 1.8), (0.5, 2.9)])
    mirror, _, _ = find([(1.8, 2.5), (2.9, 0.5)])
    assert np.abs(path.poses[:, 0] - path.poses[:, 1]).max() > 0.2
    assert np.allclose(path.poses, mirror.poses[:, jnp.array([1, 0, 2])] * jnp.array([1, 1, -1]), rtol=0.0, atol=1e-6)
    assert np.allclose(path.force, mirror.force[:, ::-1], rtol=0.0, atol=1e-6)
    assert np.allclose(path.offset, -mirror.offset[:, ::-1], rtol=0.0, atol=1e-6)


def test_free_floor_gives_the_diagonal(x64, find):
    path, _, _ = find([(2.0, 2.0), AWAY], exist=False)
    assert np.allclose(path.poses[:, 0], path.poses[:, 1], rtol=0.0, atol=1e-9)
    assert np.allclose(path.poses[:, 2], 0.0, atol=1e-9)
    assert np.hypot(4.0, 4.0) - FREE * 0.15 - 1e-3 < path.length < np.hypot(4.0, 4.0) + 1e-3


def test_free_floor_gives_nearly_the_straight_line(x64, find):
    path, _, _ = find([(2.0, 1.0), AWAY], goal=(4.0, 2.0, 0.0), exist=False)
    aside = np.abs(path.poses[:, 0] - 2.0 * path.poses[:, 1]) / np.sqrt(5.0)
    cell = (4.0 + 3.2) / (CELLS - 1)
    assert aside.max() < cell
    assert np.hypot(*np.diff(path.poses[:, :2], axis=0).T).sum() < 1.02 * np.hypot(4.0, 2.0)


def test_arc_length_is_even_and_true(x64, find):
    path, _, _ = find([(2.5, 1.8), AWAY])
    radius = CONFIG.reference.speed / CONFIG.reference.turn_rate
    change = np.diff(np.asarray(path.poses), axis=0)
    steps = np.sqrt((change[:, :2] ** 2).sum(axis=1) + (radius * change[:, 2]) ** 2)
    assert np.allclose(steps.cumsum(), path.arc[1:], rtol=1e-2)
    assert np.allclose(np.diff(path.arc), path.arc[1], rtol=1e-9)
    assert np.allclose(path.at(jnp.asarray([-1.0, 99.0])), path.poses[jnp.array([0, -1])], atol=1e-12)


def test_moving_obstacle_is_met_where_it_will_be(x64, find):
    """A walker that has left the line by the time the object arrives costs no detour; one that comes does."""
    straight, _, _ = find([(1.2, 1.2), AWAY], exist=False)
    leaving, _, _ = find([(1.2, 1.2), AWAY], velocity=(0.7, -0.7))
    coming, shapes, _ = find([(1.2 + 0.7 * 3.0, 1.2 - 0.7 * 3.0), AWAY], velocity=(-0.7, 0.7))
    assert leaving.cost == pytest.approx(float(straight.cost), rel=1e-3)
    assert leaving.length == pytest.approx(float(straight.length), rel=1e-3)
    assert coming.cost > leaving.cost + 0.5
    assert clearance(coming.poses, shapes, (1.2, 1.2), offsets=coming.offset) > 0.0


def test_paths_of_random_layouts_are_no_longer_than_a_detour(x64, find):
    """Wherever start and goal leave room for object and robots."""
    rng, tried, clear = np.random.default_rng(1), 0, []
    while tried < 40:
        start, goal = (0.0, 0.0, rng.uniform(-0.3, 0.3)), (*rng.uniform(2.0, 4.0, 2), rng.uniform(-0.2, 0.2))
        places = [tuple(rng.uniform(0.3, 0.8) * np.array(goal[:2]) + rng.uniform(-0.8, 0.8, 2)) for _ in range(2)]
        radii = rng.uniform(0.1, 0.3, 2).tolist()
        try:
            path, shapes, _ = find(places, goal, start=start, radii=radii)
        except InputError:
            continue  # an obstacle overlaps the start
        if min(clearance(jnp.array([start, goal]), shapes, p, r) for p, r in zip(places, radii, strict=True)) < 0.1:
            continue
        tried += 1
        rooms = all_rooms(path.poses, path.offset, jnp.asarray(places), shapes)
        clear.append(float(rooms.min()))
        way = np.linalg.norm(np.diff(path.poses[:, :2], axis=0), axis=1).sum()
        assert way < 1.8 * np.hypot(*goal[:2])
    # Some layouts leave a team that cannot pull no way of its turning radius.
    assert np.mean(np.array(clear) > 0.0) >= 0.95


def test_steps_past_an_obstacle_are_as_long_as_elsewhere(x64, find):
    """Obstacles cost per step: a path that may step over them would."""
    found, _, _ = find([(2.0, 2.0), (2.0, 2.6)])
    change = np.diff(np.asarray(found.poses), axis=0)
    length = np.sqrt(np.sum(change[:, :2] ** 2, axis=1) + (0.625 * change[:, 2]) ** 2)
    assert length.max() < 2.0 * np.median(length)


def test_a_path_may_end_within_the_tolerances_and_not_beyond(x64, find):
    """A wall that leaves the robots no room at the exact goal pushes the end aside."""
    found, _, _ = find([(4.55, 3.3), (20.0, 20.0)])
    miss = np.asarray(found.poses[-1]) - [4.0, 4.0, 0.0]
    assert np.hypot(*miss[:2]) < 0.15 and abs(miss[2]) < 0.3


def test_single_precision_is_finite(find):
    path, _, _ = find([(2.0, 2.0), (1.0, 3.0)])
    numbers = [leaf for leaf in jax.tree.leaves(path) if jnp.issubdtype(leaf.dtype, jnp.floating)]
    assert all(leaf.dtype == jnp.float32 and np.isfinite(leaf).all() for leaf in numbers)
