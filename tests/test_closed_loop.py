"""Planner and world together: lanes do not depend on their batch, and one that breaks harms nobody."""

import dataclasses
import logging

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from jaxlocomanip.checked import InputError
from jaxlocomanip.closed_loop import simulate
from jaxlocomanip.padding import stack
from jaxlocomanip.planner.config import Horizon, PlannerConfig

CONFIG = PlannerConfig(horizon=Horizon(steps=10))
TICKS = 150
NOISE = {"position_std": 0.002, "heading_std": 0.002, "obstacle_std": 0.01}
OBSTACLES = [
    {"shape": "box", "size": [0.5, 0.5], "position": [1.9, 1.2]},
    {"shape": "circle", "radius": 0.25, "position": [0.2, 2.6], "velocity": [0.1, -0.1]},
]


def lane(tree, k):
    """One lane of a batch, with the padding of the batch."""
    return jax.tree.map(lambda leaf: leaf[k], tree)


def leaves(tree):
    return [np.asarray(leaf) for leaf in jax.tree.leaves(tree)]


def assert_equal(a, b):
    assert all(np.array_equal(x, y, equal_nan=True) for x, y in zip(leaves(a), leaves(b), strict=True))


@pytest.fixture(scope="module")
def scenarios(make_scenario):
    """A function: three scenarios with no, one and two obstacles, padded to one shape."""

    def make():
        truths = [{"friction": 0.3}, {"mass": 8.0, "friction": 0.4}, {"mass": 5.0, "friction": 0.25}]
        return stack(
            [make_scenario(index=k + 7, truth=truths[k], obstacles=OBSTACLES[:k], sensing=NOISE) for k in range(3)]
        )

    return make


@pytest.fixture(scope="module")
def batch(scenarios, double):
    """Scenarios and their result as one batch, in double precision."""
    with double():
        made = scenarios()
        return made, jax.tree.map(np.asarray, simulate(made, CONFIG))


def test_robots_walk_with_the_object_that_is_pushed_not_with_the_plan(batch):
    """Pushes that are too weak to move an object at rest ask nobody to walk, whatever the plan wants."""
    made, result = batch
    log, normal = result.log, np.asarray(made.team.normal)
    push = np.linalg.norm(np.einsum("btr,brx->btx", log.command.force, normal), axis=-1)
    still = np.abs(log.view.twist).max(axis=-1) < 1e-3
    weak = still & (push < 0.5 * log.parameters[..., 4]) & ~log.command.resting
    planned = np.linalg.norm(log.plan[:, :, 2, :2] - log.plan[:, :, 1, :2], axis=-1) / CONFIG.horizon.dt
    assert (planned[weak] > 0.1).sum() > 10
    assert np.abs(log.command.twist[weak]).max() < 0.05


def test_the_team_gets_under_way(batch):
    _, result = batch
    moved = np.linalg.norm(result.log.view.pose[:, -1, :2], axis=1)
    assert (moved > 0.3).all()
    assert result.log.view.pose.shape == (3, TICKS, 3)
    assert (result.outcome.ticks == TICKS).all() and (result.outcome.nonfinite == 0).all()
    assert not np.asarray(result.outcome.collided).any()
    assert not any(np.isnan(leaf).any() for leaf in leaves(result.log))


def test_log_and_outcome_agree(batch):
    _, result = batch
    log, outcome = result.log, result.outcome
    assert np.allclose(log.time, 0.02 * np.arange(TICKS), atol=1e-12)
    way = np.linalg.norm(np.diff(np.asarray(log.view.pose)[:, :, :2], axis=1), axis=2).sum(axis=1)
    assert (np.asarray(outcome.path_length_m) >= way - 1e-9).all()
    assert np.allclose(outcome.path_length_m, way, atol=0.02)  # the last tick is in the outcome only
    assert (np.asarray(outcome.max_force_n) >= np.asarray(log.view.force).max(axis=(1, 2)) - 1e-9).all()
    assert (
        np.asarray(outcome.min_robot_clearance_m) <= np.asarray(log.clearances.robots)[:, 1:].min(axis=1) + 1e-9
    ).all()
    assert outcome.min_object_clearance_m[0] > 100.0  # nothing to hit


def test_a_lane_alone_is_the_lane_in_the_batch(batch, double):
    made, result = batch
    with double():
        for k in range(3):
            alone = simulate(lane(made, k), CONFIG)
            assert np.allclose(alone.log.view.pose, result.log.view.pose[k], rtol=0.0, atol=1e-9)
            assert np.allclose(alone.log.view.robots, result.log.view.robots[k], rtol=0.0, atol=1e-9)
            assert alone.outcome.ticks == result.outcome.ticks[k]


def test_broken_and_short_lanes_freeze_and_leave_others_alone(batch, double):
    made, result = batch
    with double():
        broken = dataclasses.replace(made.truth, mass=made.truth.mass.at[1].set(jnp.nan))
        other = dataclasses.replace(made, truth=broken, duration=made.duration.at[2].set(1.5))
        after = simulate(other, CONFIG)
    assert_equal(lane(after, 0), lane(result, 0))

    poses = np.asarray(after.log.view.pose)
    assert (poses[1] == np.asarray(made.start[1])).all()
    assert after.outcome.nonfinite[1] == 1 and after.outcome.ticks[1] == 0
    assert all(np.isfinite(leaf).all() for leaf in leaves(lane(after.log.view, 1)))

    last = round(1.5 / 0.02)
    assert after.outcome.ticks[2] == last and after.outcome.nonfinite[2] == 0
    rows = lambda tree, n: jax.tree.map(lambda leaf: leaf[:n], lane(tree, 2))  # noqa: E731
    assert_equal(rows(after.log.view, last + 1), rows(result.log.view, last + 1))
    assert (poses[2, last:] == poses[2, last]).all()
    assert not (np.asarray(result.log.view.pose)[2, last:] == poses[2, last]).all()


def test_command_delay_shifts_the_reaction(batch, double):
    made, _ = batch
    with double():
        one = [lane(made, 1)] * 3
        late = stack(one)
        sensing = dataclasses.replace(late.sensing, command_delay=jnp.array([0.0, 0.04, 0.1]))
        log = simulate(dataclasses.replace(late, sensing=sensing), CONFIG).log
    command, force = np.asarray(log.command.force), np.asarray(log.view.force)
    assert command[0, 0].max() > 0.0
    assert (command[:, 0] == command[0, 0]).all()  # nothing has happened yet
    for k, ticks in enumerate((0, 2, 5)):
        assert (force[k, : ticks + 1] == 0.0).all()
        assert np.allclose(force[k, ticks + 1], force[0, 1], rtol=1e-12)


def test_noise_belongs_to_the_index_and_not_to_the_place_in_the_batch(batch, double):
    made, result = batch
    with double():
        twins = stack([lane(made, 1)] * 3)
        twins = dataclasses.replace(twins, index=jnp.array([8, 99, 8], twins.index.dtype))
        log = simulate(twins, CONFIG).log
        other_seed = simulate(twins, CONFIG, seed=1).log
    poses = np.asarray(log.estimate)
    assert int(made.index[1]) == 8
    assert np.allclose(poses[0], np.asarray(result.log.estimate)[1], rtol=0.0, atol=1e-9)
    assert np.allclose(poses[2], poses[0], rtol=0.0, atol=1e-9)
    assert np.abs(poses[1] - poses[0])[:50].max() > 1e-4
    assert np.abs(np.asarray(other_seed.estimate)[0] - poses[0])[:50].max() > 1e-4


def test_equal_shapes_compile_once(batch, double, caplog):
    made, _ = batch
    with double(), caplog.at_level(logging.DEBUG, logger="jax"):
        heavier = dataclasses.replace(made, truth=dataclasses.replace(made.truth, mass=1.1 * made.truth.mass))
        softer = dataclasses.replace(CONFIG, weights=dataclasses.replace(CONFIG.weights, offset=3.0))
        with jax.log_compiles(True):
            simulate(heavier, softer)
    assert not [r.getMessage() for r in caplog.records if "_batch" in r.getMessage()]


def test_unknown_world_is_refused(batch):
    with pytest.raises(InputError, match="planar"):
        simulate(batch[0], CONFIG, world="plannar")


@pytest.mark.slow
def test_single_precision_has_no_nan(scenarios):
    result = simulate(lane(scenarios(), 2), CONFIG)
    assert all(leaf.dtype in (np.float32, np.int32, np.bool_) for leaf in leaves(result.log))
    assert not any(np.isnan(leaf).any() for leaf in leaves(result.log))
    assert result.outcome.nonfinite == 0 and result.outcome.ticks == TICKS
    assert np.linalg.norm(result.log.view.pose[-1, :2]) > 0.3


# Many random scenarios


def random_scenarios(make_scenario, count, duration):
    """Scenarios with random masses, frictions, goals and up to three obstacles, one of which may move.

    The goal is free: the path to a blocked one is no continuous function of where it starts.
    """
    made, rng = [], np.random.default_rng(0)
    while len(made) < count:
        goal = [*rng.uniform(2.5, 4.0, 2), rng.uniform(-0.2, 0.2)]
        obstacles = []
        for _ in range(rng.integers(0, 4)):
            place = rng.uniform(0.3, 0.8) * np.array(goal[:2]) + rng.uniform(-0.8, 0.8, 2)
            if np.linalg.norm(place - goal[:2]) > 1.4:
                obstacles.append({"shape": "circle", "radius": rng.uniform(0.1, 0.3), "position": place.tolist()})
        if obstacles and rng.uniform() < 0.5:
            obstacles[0]["velocity"] = rng.uniform(-0.1, 0.1, 2).tolist()
        try:
            scenario = make_scenario(
                index=len(made),
                duration=duration,
                truth={"mass": rng.uniform(3.0, 12.0), "friction": rng.uniform(0.15, 0.6)},
                goal={"pose": goal},
                obstacles=obstacles,
                sensing=NOISE,
            )
        except InputError:
            continue  # an obstacle overlaps the start
        made.append(scenario)
    return made


@pytest.mark.slow
def test_many_lanes_alone_are_the_lanes_of_the_batch(make_scenario, double):
    with double():
        made = stack(random_scenarios(make_scenario, 64, 4.0))
        together = simulate(made, CONFIG).log.view.pose
        for k in range(64):
            alone = simulate(lane(made, k), CONFIG).log.view.pose
            assert np.allclose(alone, together[k], rtol=0.0, atol=1e-6), k


@pytest.mark.slow
def test_padding_does_not_matter(make_scenario, double):
    with double():
        made = random_scenarios(make_scenario, 8, 3.0)
        together = simulate(stack(made), CONFIG).log.view.pose
        for k in (i for i in range(8) if made[i].obstacles.mask.shape[0] < 3):
            alone = simulate(made[k], CONFIG).log.view.pose
            assert np.allclose(alone, together[k], rtol=0.0, atol=1e-6), k


@pytest.mark.slow
def test_single_precision_has_no_nan_over_many_scenarios(make_scenario):
    result = simulate(stack(random_scenarios(make_scenario, 64, 20.0)), record=False)
    finite = [np.isfinite(leaf).all() for leaf in leaves(dataclasses.replace(result.outcome, reach_time_s=None))]
    assert all(finite)
    assert (result.outcome.nonfinite == 0).all()
    assert (result.outcome.ticks == 1000).all()


@pytest.mark.slow
def test_lanes_that_rest_are_skipped_without_a_difference(make_scenario):
    """One lane is at its goal from the start, the other on its way: skipping changes neither."""
    near = make_scenario(duration=2.0, goal={"pose": [0.02, 0.0, 0.0]})
    pair = stack([near, make_scenario(index=1, duration=2.0)])
    asking = dataclasses.replace(CONFIG, horizon=dataclasses.replace(CONFIG.horizon, rest_skips=False))
    skipped, all_planned = (simulate(pair, config) for config in (CONFIG, asking))
    assert np.asarray(skipped.log.command.resting)[:, -1].tolist() == [True, False]
    for name in ("pose", "twist", "offset", "force"):
        np.testing.assert_allclose(getattr(skipped.log.view, name), getattr(all_planned.log.view, name), atol=1e-5)
    assert (np.asarray(skipped.log.command.force)[0] == 0.0).all()
