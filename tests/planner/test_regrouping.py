"""Walking to other faces: when a team that has come to rest is asked to, and what it forgets when it has set off."""

import dataclasses

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from jaxlocomanip.loop import task_of
from jaxlocomanip.planner import path, reference, regrouping, state
from jaxlocomanip.planner.config import Horizon, PlannerConfig
from jaxlocomanip.planner.path import Aim
from jaxlocomanip.planner.regrouping import SHY
from jaxlocomanip.planner.state import Measurement

CONFIG = PlannerConfig(horizon=Horizon(steps=5))
NEXT = 1
"""formation that the path leads to; robots at -x and -y walk over by the side of +x"""
IN_THE_WAY, BESIDE = (0.9, -0.3), (-0.2, 0.9)
asked = jax.jit(regrouping.regrouping)
forgotten = jax.jit(regrouping.regrouped)


@pytest.fixture
def rest(make_scenario):
    """A function: the state, measurement and task of a team that has come to rest where it shall take other faces."""

    def make(place=BESIDE, exist=True, wanted=NEXT, speed=0.0, turning=0.0, resting=True, contact=(True, True)):
        obstacle = {"shape": "box", "size": [0.6, 0.6], "position": list(place)}
        scenario = make_scenario(change_faces=True, obstacles=[obstacle])
        task = task_of(scenario)
        task = dataclasses.replace(task, shapes=dataclasses.replace(task.shapes, obstacle_mask=jnp.full(1, exist)))
        formation = jnp.zeros((), jnp.int32)
        seen = Measurement(
            scenario.start, scenario.team.offset, scenario.obstacles.position, jnp.asarray(contact), formation
        )
        before = state.start(task, seen, CONFIG)
        aim = Aim(dataclasses.replace(scenario.goal, pose=scenario.start), jnp.asarray(wanted), jnp.asarray(5.0))
        there = dataclasses.replace(before.path, aim=aim, cost=jnp.asarray(2.0))
        progress = dataclasses.replace(before.progress, resting=jnp.asarray(resting))
        twist = jnp.array([0.6 * speed, 0.8 * speed, turning])
        moving = dataclasses.replace(before.object, twist=twist)
        return dataclasses.replace(before, path=there, progress=progress, object=moving), seen, task

    return make


def same(a, b):
    return all(np.array_equal(x, y) for x, y in zip(jax.tree.leaves(a), jax.tree.leaves(b), strict=True))


def test_a_team_at_rest_with_room_is_asked_to_walk(rest):
    before, seen, task = rest()
    after = asked(before, seen, task, CONFIG)
    assert int(after.command.formation) == NEXT
    assert int(after.formation) == 0, "it has not gone yet"
    command = dataclasses.replace(after.command, formation=before.command.formation)
    assert same(dataclasses.replace(after, command=command), before), "all else is as before"


def test_a_team_without_room_stays_and_looks_for_another_way(rest):
    before, seen, task = rest(place=IN_THE_WAY)
    after = asked(before, seen, task, CONFIG)
    assert int(after.command.formation) == 0
    assert not after.progress.resting and float(after.path.cost) == pytest.approx(path.UNPLANNED)
    assert float(after.berth) == pytest.approx(SHY)
    once_more = dataclasses.replace(after, path=before.path, progress=before.progress)  # at rest at a place as tight
    again = asked(once_more, seen, task, CONFIG)
    assert float(again.berth) == pytest.approx(2.0 * SHY)


def test_an_obstacle_that_only_fills_up_the_arrays_is_in_nobodys_way(rest):
    before, seen, task = rest(place=IN_THE_WAY, exist=False)
    assert int(asked(before, seen, task, CONFIG).command.formation) == NEXT


@pytest.mark.parametrize("place", [BESIDE, IN_THE_WAY])
@pytest.mark.parametrize(
    "unfit",
    [
        {"resting": False},
        {"wanted": 0},
        {"contact": (True, False)},
        {"speed": 1.1 * reference.STILL[0]},
        {"turning": -1.1 * reference.STILL[1]},
    ],
    ids=["on its way", "at the goal", "a robot away", "sliding", "turning"],
)
def test_nobody_is_asked_before_all_is_at_rest_at_such_a_place(rest, unfit, place):
    before, seen, task = rest(place, **unfit)
    assert same(asked(before, seen, task, CONFIG), before)


def test_an_object_that_hardly_moves_stands(rest):
    before, seen, task = rest(speed=0.9 * reference.STILL[0], turning=-0.9 * reference.STILL[1])
    assert int(asked(before, seen, task, CONFIG).command.formation) == NEXT


def test_lanes_are_asked_each_by_itself(rest):
    lanes = [rest(), rest(IN_THE_WAY), rest(resting=False), rest(IN_THE_WAY, exist=False)]
    together = jax.jit(jax.vmap(regrouping.regrouping, (0, 0, 0, None)))(
        *jax.tree.map(lambda *leaves: jnp.stack(leaves), *lanes), CONFIG
    )
    assert together.command.formation.tolist() == [NEXT, 0, 0, NEXT]
    for k, lane in enumerate(lanes):
        assert same(jax.tree.map(lambda leaf, k=k: leaf[k], together), asked(*lane, CONFIG))


@pytest.fixture
def left(rest):
    """State before, measurement and state after of a team that pushed and slid, and has begun to walk."""
    before, seen, task = rest()
    before = dataclasses.replace(
        before,
        object=dataclasses.replace(before.object, pose=jnp.array([0.5, 0.25, 0.1])),
        progress=dataclasses.replace(before.progress, projected=jnp.asarray(1.0), reference=jnp.asarray(1.25)),
        force=jnp.array([20.0, 30.0]),
        berth=jnp.asarray(2.0 * SHY),
        proven=jnp.asarray(17.0),
        walks=jnp.asarray(2),
        command=dataclasses.replace(before.command, force=jnp.array([20.0, 30.0]), twist=jnp.array([0.1, 0.2, 0.0])),
    )
    noise = jnp.array([0.01, -0.01, 0.02])
    walking = dataclasses.replace(
        seen, pose=before.object.pose + noise, offset=jnp.array([0.05, -0.05]), formation=jnp.asarray(NEXT)
    )
    return before, walking, task, forgotten(before, walking, task, CONFIG)


def test_who_walks_has_no_path_and_pushes_nothing(left):
    before, walking, task, after = left
    pose = before.object.pose  # as estimated, not as measured
    np.testing.assert_array_equal(after.path.poses, np.tile(pose, (path.POINTS, 1)))
    assert float(after.path.cost) == pytest.approx(path.UNPLANNED) and float(after.path.length) == 0.0
    np.testing.assert_array_equal(after.path.aim.goal.pose, task.goal.pose)
    assert int(after.path.aim.formation) == NEXT and float(after.path.aim.beyond) == 0.0
    assert same(after.progress, reference.start())
    np.testing.assert_array_equal(after.force, 0.0)
    np.testing.assert_array_equal(after.command.force, 0.0)
    np.testing.assert_array_equal(after.solver.plan.us, 0.0)
    at_rest = np.concatenate([pose, np.zeros(3), walking.offset])
    np.testing.assert_array_equal(after.solver.plan.xs, np.tile(at_rest, (CONFIG.horizon.steps + 1, 1)))


def test_who_walks_is_counted_and_in_the_new_formation(left):
    before, walking, _, after = left
    assert int(after.formation) == int(after.command.formation) == NEXT
    np.testing.assert_array_equal(after.offset, walking.offset)
    assert int(after.walks) == int(before.walks) + 1
    assert float(after.berth) == 0.0, "there was room"


def test_what_was_learnt_of_object_floor_and_obstacles_is_kept(left):
    before, _, _, after = left
    for name in ("object", "obstacles", "parameters", "proven", "breakaway", "kept", "origin"):
        assert same(getattr(after, name), getattr(before, name)), name
