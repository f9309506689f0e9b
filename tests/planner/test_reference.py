"""Progress along the path and the reference over the horizon."""

import dataclasses

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from jaxlocomanip.planner import reference
from jaxlocomanip.planner.config import PlannerConfig
from jaxlocomanip.planner.path import POINTS, pace, straight_poses
from jaxlocomanip.planner.shapes import shapes_of

TICK = 0.02
SETTINGS = PlannerConfig().reference
TURN_RADIUS = SETTINGS.speed / SETTINGS.turn_rate
TOLERANCE = jnp.array([0.15, 0.3])
GOAL = [3.0, 4.0, 1.0]
MOVING, STANDING = jnp.array([0.3, 0.0, 0.0]), jnp.zeros(3)
advance = jax.jit(reference.advance)
targets = jax.jit(reference.targets)


def straight(scenario, start, goal):
    poses = straight_poses(start, goal, POINTS)
    return pace(poses, shapes_of(scenario), scenario.object.body, TURN_RADIUS)


@pytest.fixture
def path(make_scenario):
    scenario = make_scenario(goal={"pose": GOAL})
    return straight(scenario, scenario.start, scenario.goal.pose)


def run(path, poses, twist=MOVING, left=None):
    """Progress [T] while the object is at `poses` [T, 3], and was `left` m before the end of the path."""
    progress, rows = reference.start(), []
    if left is not None:
        progress = dataclasses.replace(progress, projected=path.length - left)
    for pose in poses:
        progress = advance(progress, path, jnp.asarray(pose), twist, jnp.asarray(GOAL), TOLERANCE, TICK, SETTINGS)
        rows.append([float(progress.projected), float(progress.reference), bool(progress.resting)])
    return np.array(rows)


def test_reference_leads_a_stuck_object_by_a_bounded_distance(x64, path):
    rows = run(path, np.zeros((100, 3)))
    assert rows[0, 1] == pytest.approx(SETTINGS.speed * TICK)
    assert (rows[:, 0] == 0.0).all()
    assert rows[-1, 1] == pytest.approx(SETTINGS.lead)
    assert (np.diff(rows[:, 1]) >= 0.0).all()


def test_progress_is_monotone_and_ends_at_the_goal(x64, path):
    rng = np.random.default_rng(0)
    along = np.clip(np.linspace(0.0, 1.1, 700), 0.0, 1.0)[:, None]
    poses = along * np.array(GOAL) + 0.05 * rng.normal(size=(700, 3)) * (along < 1.0)
    rows = run(path, poses)
    assert (np.diff(rows[:, 0]) >= 0.0).all() and (np.diff(rows[:, 1]) >= 0.0).all()
    assert (rows[:, 1] >= rows[:, 0]).all()
    spacing = float(path.length) / 127.0
    assert (rows[:, 1] - rows[:, 0] <= SETTINGS.lead + 1e-9).all()
    assert rows[-1, 0] == pytest.approx(float(path.length), abs=spacing)
    assert rows[-1, 1] == pytest.approx(float(path.length), abs=1e-9)
    assert not rows[0, 2] and rows[-1, 2]


def test_progress_follows_a_pushed_object_at_its_own_speed(x64, path):
    """An object ahead of the reference takes the reference with it."""
    total = float(path.length)
    poses = np.linspace(0.0, 0.8, 50)[:, None] * np.array(GOAL)
    rows = run(path, poses)
    assert rows[-1, 0] == pytest.approx(0.8 * total, abs=total / 127.0)
    assert rows[-1, 1] >= rows[-1, 0]


def test_rests_with_hysteresis(x64, path):
    def at(distance):
        return np.array(GOAL) - [distance, 0.0, 0.0]

    inner, outer = SETTINGS.arrive * 0.15, SETTINGS.leave * 0.15
    between = 0.5 * (inner + outer)
    distances = [1.1 * outer, between, 0.9 * inner, between, 1.1 * outer, between]
    rows = run(path, [at(d) for d in distances], left=0.2)
    assert rows[:, 2].tolist() == [False, False, True, True, False, False]


def test_an_object_that_stands_within_the_tolerances_has_arrived(x64, path):
    """While it moves it may still come nearer; standing, the next approach may end worse."""
    near = np.array(GOAL) - [0.5 * (SETTINGS.arrive + SETTINGS.leave) * 0.15, 0.0, 0.0]
    beyond = np.array(GOAL) - [1.1 * SETTINGS.leave * 0.15, 0.0, 0.0]
    assert not run(path, [near], left=0.2)[-1, 2]
    assert run(path, [near], STANDING, left=0.2)[-1, 2]
    assert not run(path, [beyond], STANDING, left=0.2)[-1, 2]


def test_an_object_that_gets_worse_or_would_go_around_has_arrived(x64, path):
    near = np.array(GOAL) - [0.5 * (SETTINGS.arrive + SETTINGS.leave) * 0.15, 0.0, 0.0]
    beyond = np.array(GOAL) - [1.1 * SETTINGS.leave * 0.15, 0.0, 0.0]
    assert run(path, [near], -MOVING, left=0.2)[-1, 2]
    assert run(path, [near], left=2.0)[-1, 2]
    assert not run(path, [beyond], -MOVING, left=2.0)[-1, 2]


def test_a_team_is_stuck_after_searches_in_a_row_without_progress(x64, path):
    progress = reference.start()
    for count in range(1, reference.PATIENCE):
        assert reference.stalls(progress, SETTINGS) == count
        progress = reference.restart(progress, path, SETTINGS)
    assert reference.stalls(progress, SETTINGS) == reference.PATIENCE
    assert reference.stalls(dataclasses.replace(progress, projected=jnp.asarray(0.5)), SETTINGS) == 0
    assert reference.stalls(dataclasses.replace(progress, resting=jnp.asarray(True)), SETTINGS) == 0


def test_a_team_on_its_way_to_the_object_is_not_stuck(x64, path):
    progress = reference.start()
    for _ in range(2 * reference.PATIENCE):
        progress = reference.restart(reference.apart(progress), path, SETTINGS)
        assert reference.stalls(progress, SETTINGS) < reference.PATIENCE
    progress = reference.apart(progress)
    assert [int(v) for v in (progress.projected, progress.reference, progress.stalled)] == [0, 0, 0]
    assert reference.stalls(progress, SETTINGS) == 1


def test_targets_run_along_the_path_and_come_to_rest_at_the_goal(x64, path):
    times = jnp.arange(0.0, 40.0, 0.1)
    made = targets(reference.start(), path, times, SETTINGS)
    assert np.allclose(made.pose[0], [0.0, 0.0, 0.0], atol=1e-9)
    assert np.allclose(made.pose[-1], GOAL, atol=1e-6)
    assert np.abs(made.twist[-1]).max() < 1e-6
    assert np.abs(made.force[-1]).max() < 1e-3
    speed = np.sqrt(
        np.sum(np.asarray(made.twist[:, :2]) ** 2, axis=1) + (TURN_RADIUS * np.asarray(made.twist[:, 2])) ** 2
    )
    assert speed[0] == pytest.approx(SETTINGS.speed, rel=1e-3)
    assert speed.max() <= SETTINGS.speed * (1.0 + 1e-3)
    assert (np.diff(speed) <= 1e-3).all()


def test_targets_move_as_their_twist_says(x64, path):
    """The twist is the time derivative of the pose, also through the exponential approach."""
    h = 1e-4
    times = jnp.asarray(np.linspace(0.5, 12.0, 60))
    low, here, high = (targets(reference.start(), path, times + d, SETTINGS) for d in (-h, 0.0, h))
    difference = (high.pose - low.pose) / (2.0 * h)
    assert np.allclose(here.twist, difference, rtol=0.0, atol=2e-3)


def test_a_new_path_keeps_the_lead(x64, path):
    progress = dataclasses.replace(reference.start(), projected=jnp.asarray(1.0), reference=jnp.asarray(1.2))
    renewed = reference.restart(progress, path, SETTINGS)
    assert renewed.projected == 0.0
    assert renewed.reference == pytest.approx(0.2)


def test_straight_path_is_straight_and_turns_the_shorter_way(x64, make_scenario):
    scenario = make_scenario()
    start, goal = jnp.array([0.0, 0.0, 3.0]), jnp.array([2.0, 1.0, -3.0])
    line = straight(scenario, start, goal)
    poses = np.asarray(line.poses)
    assert np.allclose(poses[0], start, atol=1e-9)
    assert np.allclose(poses[-1, :2], goal[:2], atol=1e-9)
    assert poses[-1, 2] == pytest.approx(2.0 * np.pi - 3.0)
    assert np.abs(poses[:, 0] - 2.0 * poses[:, 1]).max() < 1e-9
    length = np.hypot(np.hypot(2.0, 1.0), TURN_RADIUS * (2.0 * np.pi - 6.0))
    assert line.length == pytest.approx(length, rel=1e-3)
    steps = np.diff(np.asarray(line.arc))
    assert np.allclose(steps, steps[0], rtol=1e-9)
