"""A made-up episode: every array of the true shapes, the motion chosen by hand, nothing simulated."""

from __future__ import annotations

import dataclasses

import jax
import numpy as np
import pytest

from jaxlocomanip import closed_loop
from jaxlocomanip.build import build
from jaxlocomanip.planner.config import PlannerConfig
from jaxlocomanip.recording.history import rotated
from jaxlocomanip.recording.quadruped import parts
from jaxlocomanip.specification import parse_scenario
from jaxlocomanip.worlds.interface import Bodies

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


def quaternion_of(rotation):
    """[4] w, x, y, z of a rotation matrix [3, 3] by less than half a turn."""
    w = 0.5 * np.sqrt(1.0 + np.trace(rotation))
    x, y, z = rotation[2, 1] - rotation[1, 2], rotation[0, 2] - rotation[2, 0], rotation[1, 0] - rotation[0, 1]
    return np.array([w, x / (4 * w), y / (4 * w), z / (4 * w)])


def product(a, b):
    """Product of quaternions [..., 4]."""
    vector = a[..., :1] * b[..., 1:] + b[..., :1] * a[..., 1:] + np.cross(a[..., 1:], b[..., 1:])
    return np.concatenate(
        [a[..., :1] * b[..., :1] - np.sum(a[..., 1:] * b[..., 1:], axis=-1, keepdims=True), vector], -1
    )


def _walking(scenario, result):
    """The made-up episode with bodies: standing robots that glide along, and an object that tilts by 0.1 rad."""
    view = result.log.view
    yaw, zero = view.pose[:, 2], np.zeros(TICKS)
    turn = np.stack([np.cos(0.5 * yaw), zero, zero, np.sin(0.5 * yaw)], axis=1)
    tilt = np.tile([np.cos(0.05), np.sin(0.05), 0.0, 0.0], (TICKS, 1))
    position, quaternion = [np.pad(view.pose[:, :2], ((0, 0), (0, 1)))], [product(turn, tilt)]
    for i, kind in enumerate(("aliengo", "go1")):
        heading = view.robots[:, i, 2]
        turn = np.stack([np.cos(0.5 * heading), zero, zero, np.sin(0.5 * heading)], axis=1)
        for part in parts(kind, (0, 0, 0)):
            position.append(np.pad(view.robots[:, i, :2], ((0, 0), (0, 1))) + rotated(turn, part.origin))
            quaternion.append(product(turn, quaternion_of(part.rotation)))
    # Diagonal by diagonal, half a period each: FR and RL, then FL and RR.
    first = (np.arange(TICKS) // 10 % 2 == 0)[:, None, None]
    loaded = np.where(first, np.array([True, False, False, True]), np.array([False, True, True, False]))
    force = np.where(loaded[..., None], np.array([5.0, 0.0, 100.0]), 0.0) * np.ones((1, 2, 1, 1))
    points = np.pad(np.asarray(scenario.team.origin), ((0, 0), (0, 1)), constant_values=0.3)
    contact = np.pad(view.pose[:, None, :2], ((0, 0), (0, 0), (0, 1))) + points
    bodies = Bodies(np.stack(position, 1), np.stack(quaternion, 1), force, contact)
    command = dataclasses.replace(result.log.command, force=np.full((TICKS, 2), 25.0))
    log = dataclasses.replace(result.log, view=dataclasses.replace(view, bodies=bodies), command=command)
    return scenario, dataclasses.replace(result, log=log)


@pytest.fixture(scope="session")
def walking(made_up):
    """Scenario and result as of a world with bodies."""
    return _walking(*made_up)
