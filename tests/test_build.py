"""From a checked scenario to arrays: geometry, moments, padding, and what does not fit together."""

import math

import jax.numpy as jnp
import numpy as np
import pytest

from jaxlocomanip.build import build, covering_discs, footprint_moments
from jaxlocomanip.checked import InputError
from jaxlocomanip.planar.dynamics import GRAVITY
from jaxlocomanip.scenario import stack
from jaxlocomanip.specification import parse_scenario

MINIMAL = {
    "name": "small",
    "object": {"size": [0.5, 0.4], "mass": 6.0},
    "start": {"pose": [0.0, 0.0, 0.0]},
    "goal": {"pose": [1.0, 0.0, 0.0]},
    "robots": [{"type": "a1", "face": "-x"}],
}
SQUARE = np.array([[-0.25, -0.25], [0.25, -0.25], [0.25, 0.25], [-0.25, 0.25]])


def made(**groups):
    return build(parse_scenario(MINIMAL | groups))


def refusal(**groups):
    with pytest.raises(InputError) as caught:
        made(**groups)
    assert "\n" not in str(caught.value)
    return str(caught.value)


def test_moments_of_a_square():
    moments = footprint_moments(SQUARE)
    assert moments.centroid == pytest.approx(np.zeros(2), abs=1e-12)
    assert moments.radius_of_gyration**2 == pytest.approx(0.5**2 / 6, rel=1e-3)
    # mean distance from the centre of a square of side a: a (sqrt 2 + asinh 1) / 6
    assert moments.mean_radius == pytest.approx(0.5 * (math.sqrt(2) + math.asinh(1)) / 6, rel=1e-3)


def test_moments_of_a_triangle_off_the_origin():
    moments = footprint_moments(np.array([[1.0, 1.0], [4.0, 1.0], [1.0, 4.0]]))
    assert moments.centroid == pytest.approx([2.0, 2.0], abs=0.02)


@pytest.mark.parametrize("size", [(0.5, 0.5), (0.5, 0.6), (1.5, 0.5), (0.3, 2.0)])
def test_discs_cover_the_footprint(size):
    polygon = np.array([[-1, -1], [1, -1], [1, 1], [-1, 1]]) * np.array(size) / 2
    centers, radii = covering_discs(polygon)
    inside = np.random.default_rng(0).uniform(-0.5, 0.5, (2000, 2)) * size
    gaps = np.linalg.norm(inside[:, None] - centers[None], axis=2) - radii
    assert gaps.min(axis=1).max() <= 1e-9


def test_truth_is_the_belief_where_nothing_is_said():
    scenario = made(object={"size": [0.5, 0.5], "mass": 6.0, "friction": 0.3})
    assert scenario.truth.mass == 6.0
    assert scenario.truth.inertia == scenario.object.body.inertia
    assert scenario.truth.friction_force == pytest.approx(0.3 * 6.0 * GRAVITY, rel=1e-6)
    assert bool(scenario.object.friction_known)


def test_unknown_friction_is_marked_and_only_in_the_belief():
    scenario = made(truth={"mass": 8.0, "friction": 0.4})
    assert not bool(scenario.object.friction_known)
    assert scenario.object.body.friction_force == 0.0
    assert scenario.truth.friction_force == pytest.approx(0.4 * 8.0 * GRAVITY, rel=1e-6)


def test_robots_face_into_the_object():
    robots = [{"type": "aliengo", "face": f} for f in ("-x", "-y", "+x", "+y")]
    team = made(object={"size": [1.0, 1.0], "mass": 6.0}, robots=robots).team
    assert np.asarray(team.normal) == pytest.approx(np.array([[1, 0], [0, 1], [-1, 0], [0, -1]]), abs=1e-6)
    assert np.asarray(team.origin) == pytest.approx(-0.5 * np.asarray(team.normal), abs=1e-6)
    poses = np.asarray(team.robot_poses(jnp.zeros(3), team.offset))
    assert poses[:, :2] == pytest.approx(-(0.5 + np.asarray(team.reach))[:, None] * np.asarray(team.normal), abs=1e-6)


def test_obstacle_motions():
    walk = {"kind": "waypoints", "times": [1, 3], "points": [[2, 2], [2, 4]]}
    sine = {"kind": "sine", "amplitude": [0.5, 0.0], "period": 4.0}
    circle = {"shape": "circle", "radius": 0.2}
    obstacles = made(
        obstacles=[
            circle | {"position": [2, 2], "motion": walk},
            circle | {"position": [5, 5], "motion": sine},
            circle | {"position": [8, 8], "velocity": [0.1, 0.0]},
            circle | {"position": [9, 9]},
        ]
    ).obstacles
    assert np.asarray(obstacles.dynamic).tolist() == [True, True, True, False]
    expected = {
        0.0: [[2, 2], [5, 5], [8, 8]],
        1.0: [[2, 2], [5.5, 5], [8.1, 8]],
        2.0: [[2, 3], [5, 5], [8.2, 8]],
    }
    for time, positions in expected.items():
        moved = np.asarray(obstacles.at(jnp.asarray(time)))[:3]
        assert moved == pytest.approx(np.array(positions, dtype=float), abs=1e-5)


def test_no_obstacles_become_one_absent_one():
    obstacles = made().obstacles
    assert obstacles.mask.shape == (1,)
    assert not bool(obstacles.mask[0])


def test_scenarios_of_different_layouts_stack():
    batch = stack([made(), made(obstacles=[{"shape": "circle", "radius": 0.2, "position": [3, k]} for k in (0, 2)])])
    assert np.asarray(batch.obstacles.mask).tolist() == [[False, False], [True, True]]
    with pytest.raises(InputError, match="teams of one size"):
        stack([made(), made(robots=[{"type": "a1", "face": f} for f in ("-x", "+x")])])
    with pytest.raises(InputError, match="at least one"):
        stack([])


@pytest.mark.parametrize(
    ("groups", "expected"),
    [
        (
            {"robots": [{"type": "a1", "face": "-x", "offset": 0.2}]},
            "robots[0].offset = 0.2: must be within +-0.17 m on face '-x'",
        ),
        (
            {"robots": [{"type": "a1", "face": "-x"}, {"type": "a1", "face": "-x", "offset": 0.1}]},
            "robots[0] and robots[1]: overlap by 0.222 m",
        ),
        (
            {"obstacles": [{"shape": "circle", "radius": 0.3, "position": [0.5, 0.0]}]},
            "obstacles[0].position = [0.5, 0.0]: overlaps the object at the start by 0.050 m",
        ),
        (
            {"obstacles": [{"shape": "box", "size": [0.2, 0.2], "position": [-0.6, 0.0]}]},
            "obstacles[0].position = [-0.6, 0.0]: overlaps robots[0] at the start",
        ),
        (
            {
                "goal": {"pose": [3.0, 3.0, 0.0]},
                "obstacles": [{"shape": "circle", "radius": 0.3, "position": [3.0, 3.2]}],
            },
            "goal.pose = [3.0, 3.0, 0.0]: obstacles[0] overlaps the object there by 0.300 m (at most",
        ),
        (
            {"object": {"size": [0.5, 0.4], "mass": 6.0, "com": [0.2, 0.0], "inertia": 0.2}},
            "object.inertia = 0.2: must be > mass |com|^2 = 0.24",
        ),
        (
            {"truth": {"inertia": 0.01, "com": [0.1, 0.0]}},
            "truth.inertia = 0.01: must be > mass |com|^2 = 0.06",
        ),
    ],
    ids=["offset", "robots", "object", "robot", "goal", "inertia", "true inertia"],
)
def test_what_does_not_fit_together_is_refused(groups, expected):
    assert refusal(**groups).startswith(expected)
