"""Scenarios solvable by construction: random pushes first, then obstacles beside what they swept.

They are never held to be impossible, and never rejected at all where the obstacles keep some distance.
"""

import math

import numpy as np
import pytest

from jaxlocomanip.build_team import inward_normals, robot_rectangles
from jaxlocomanip.footprint import footprint_moments, placed, polygon_gap
from jaxlocomanip.sampling.clearance import floor_of
from jaxlocomanip.sampling.enclosure import enclosed_goal, enclosed_start
from jaxlocomanip.sampling.passage import obstruction, way_within
from jaxlocomanip.sampling.pushing import offset_limits, pushing
from jaxlocomanip.specification import BOX_FACES, parse_scenario

STEP = 0.01
"""m, way of the object between two poses"""


def pushed_path(spec, rng, length):
    """Poses [n, 3] and offsets [n, N_r] of a quasi-static motion under random pushes, changed at random."""
    polygon = np.array(spec.object.footprint)
    com, ratio = np.array(spec.truth.com), footprint_moments(polygon).mean_radius ** 2
    faces = [BOX_FACES.index(robot.face) for robot in spec.robots]
    normals = inward_normals(polygon)[faces]
    tangents = np.stack([-normals[:, 1], normals[:, 0]], axis=1)
    middles = (polygon[faces] + np.roll(polygon, -1, axis=0)[faces]) / 2.0
    limits = offset_limits(spec)
    pose = np.array(spec.start)
    offsets, wanted = np.array([robot.offset for robot in spec.robots]), np.zeros(len(faces))
    poses, taken, forces = [pose.copy()], [offsets.copy()], np.ones(len(faces))
    while len(poses) < length / STEP:
        if rng.random() < 0.1:
            # Often one robot alone, or all at one end of their faces: those are the tightest turns.
            forces = rng.random(len(faces)) * (rng.random(len(faces)) < 0.6)
            wanted = limits * rng.choice([-1.0, 1.0, rng.uniform(-1.0, 1.0)])
        offsets = offsets + np.clip(wanted - offsets, -2.0 * STEP, 2.0 * STEP)
        force = forces @ normals
        arms = middles + offsets[:, None] * tangents - com
        moment = forces @ (arms[:, 0] * normals[:, 1] - arms[:, 1] * normals[:, 0])
        speed = max(np.hypot(*force), 0.3 * abs(moment) / ratio)
        if speed < 1e-3:
            forces = rng.random(len(faces))
            continue
        turn = STEP / speed * moment / ratio
        center = placed(pose, com[None])[0]
        center = center + placed((0.0, 0.0, pose[2] + 0.5 * turn), STEP / speed * force[None])[0]
        heading = pose[2] + turn
        pose = np.array([*(center - placed((0.0, 0.0, heading), com[None])[0]), heading])
        poses.append(pose)
        taken.append(offsets.copy())
    return np.array(poses), np.array(taken)


def swept(spec, poses, offsets):
    """[n, 4, 2] all the places of the object and the robots."""
    bodies = [placed(poses, np.array(spec.object.footprint)[None])]
    return np.concatenate([*bodies, *[robot_rectangles(spec, q, d) for q, d in zip(poses, offsets, strict=True)]])


def beside(rng, places, poses, gaps):
    """An obstacle that keeps a distance between two from everything swept, pushed towards it from afar."""
    yaw, sides = rng.uniform(-math.pi, math.pi), rng.uniform(0.1, 0.8, 2)
    circle = rng.random() < 0.3
    corners = (
        np.zeros((1, 2))
        if circle
        else placed((0.0, 0.0, yaw), np.array([[-1, -1], [1, -1], [1, 1], [-1, 1]]) * sides / 2.0)
    )
    radius = 0.5 * float(sides[0]) if circle else 0.0
    middle = poses[rng.choice([0, len(poses) - 1, rng.integers(len(poses))]), :2]
    angle, gap = rng.uniform(-math.pi, math.pi), rng.uniform(*gaps)
    way = np.array([math.cos(angle), math.sin(angle)])
    far = 8.0
    # Advanced by its distance each time, it never passes what it is to keep away from.
    for _ in range(60):
        nearest = float((polygon_gap(places, (middle + far * way + corners)[None], radius) - gap).min())
        far -= 0.99 * nearest
        if nearest < 1e-4:
            break
    assert abs(nearest) < 1e-3
    table = {"shape": "circle", "radius": radius} if circle else {"shape": "box", "size": sides.tolist(), "yaw": yaw}
    return table | {"position": (middle + (far + 1e-3) * way).tolist()}


def solvable(seed, gaps):
    """A scenario with a known solution, and obstacles that keep a distance between two, m, from what it sweeps."""
    rng = np.random.default_rng(seed)
    count = int(rng.integers(1, 5))
    first = int(rng.integers(4))
    size = rng.uniform(0.35, 0.9, 2) if rng.random() < 0.5 else np.array([0.5, 0.5])
    tables = {
        "name": "solvable",
        "object": {"size": size.tolist(), "mass": 6.0},
        "truth": {"com": (rng.uniform(-0.1, 0.1, 2) * size).tolist()},
        "start": {"pose": [*rng.uniform(-1.0, 1.0, 2), rng.uniform(-math.pi, math.pi)]},
        "goal": {"pose": [0.0, 0.0, 0.0], "position_tolerance": 0.02, "heading_tolerance": 0.02},
        "robots": [
            {"type": str(rng.choice(["aliengo", "a1", "go1"])), "face": BOX_FACES[(first + i) % 4]}
            for i in range(count)
        ],
    }
    spec = parse_scenario(tables)
    poses, offsets = pushed_path(spec, rng, rng.uniform(1.0, 3.5))
    places = swept(spec, poses, offsets)
    tables["goal"]["pose"] = poses[-1].tolist()
    tables["obstacles"] = [beside(rng, places, poses, gaps) for _ in range(int(rng.integers(4, 12)))]
    return parse_scenario(tables)


@pytest.mark.parametrize("block", range(10))
def test_what_can_be_pushed_is_not_held_to_be_impossible(block):
    for seed in range(20 * block, 20 * block + 20):
        spec = solvable(seed, (0.01, 0.02))
        floor, able = floor_of(spec), pushing(spec)
        assert way_within(spec, floor, able), seed
        assert not enclosed_start(spec, floor, able) and not enclosed_goal(spec, floor, able), seed
        assert obstruction(spec) in (None, "narrow"), seed


@pytest.mark.parametrize("block", range(10))
def test_what_can_be_pushed_with_room_is_not_rejected(block):
    for seed in range(10 * block, 10 * block + 10):
        assert obstruction(solvable(seed, (0.08, 0.1))) is None, seed
