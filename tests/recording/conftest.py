"""A made-up episode: every array of the true shapes, the motion chosen by hand, nothing simulated."""

from __future__ import annotations

import dataclasses

import jax
import numpy as np
import pytest

from jaxlocomanip import closed_loop
from jaxlocomanip.build import build
from jaxlocomanip.planner.config import PlannerConfig
from jaxlocomanip.specification import parse_scenario

TICKS = 120
DATA = {
    "name": "made_up",
    "duration": 2.0,  # shorter than the log: its last 20 rows are frozen
    "object": {"size": [0.8, 0.5], "height": 0.4, "mass": 6.0},
    "truth": {"mass": 8.0, "friction": 0.4},
    "start": {"pose": [0.0, 0.0, 0.0]},
    "goal": {"pose": [2.0, 0.5, 0.2]},
    "robots": [{"type": "aliengo", "face": "-x"}, {"type": "go1", "face": "-y"}],
    "obstacles": [
        {"shape": "box", "size": [0.5, 0.5], "position": [1.0, 1.5]},
        {"shape": "circle", "radius": 0.3, "position": [2.0, -1.5], "velocity": [0.1, 0.0]},
    ],
}


def _made_up():
    scenario = build(parse_scenario(DATA))
    config, key = PlannerConfig(), jax.random.key(0)
    world = closed_loop.load_world("planar", None, False)
    shapes = jax.eval_shape(lambda s: closed_loop.episode(s, config, key, world, TICKS, True), scenario)
    result = jax.tree.map(lambda leaf: np.zeros(leaf.shape, leaf.dtype), shapes)
    time = 0.02 * np.arange(TICKS)
    progress = np.minimum(time / 2.0, 1.0)
    pose = progress[:, None] * np.array([2.0, 0.5, 0.2])
    offset = np.zeros((TICKS, 2))
    view = dataclasses.replace(
        result.log.view,
        pose=pose,
        offset=offset,
        force=np.stack([30.0 + 10.0 * np.sin(time), 20.0 + 0.0 * time], axis=1),
        robots=np.asarray(jax.vmap(scenario.team.robot_poses)(pose, offset)),
    )
    log = dataclasses.replace(
        result.log,
        time=time,
        view=view,
        path_time=1.0 * np.arange(len(result.log.path)),
        obstacles=np.asarray(jax.vmap(scenario.obstacles.at)(time)),
        plan=np.repeat(pose[:, None], result.log.plan.shape[1], axis=1),
        parameters=np.tile([7.0, 1.0, 0.0, 0.0, 25.0, 5.0], (TICKS, 1)) * (1.0 + 0.01 * time[:, None]),
    )
    return scenario, dataclasses.replace(result, log=log)


@pytest.fixture(scope="session")
def made_up():
    """Scenario and result."""
    return _made_up()
