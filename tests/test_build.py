"""From a checked scenario to arrays: geometry, moments, padding, and what does not fit together."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from jaxlocomanip import library
from jaxlocomanip.build import build, build_on_host
from jaxlocomanip.build_team import robot_rectangles
from jaxlocomanip.checked import InputError
from jaxlocomanip.padding import stack
from jaxlocomanip.planar.dynamics import GRAVITY
from jaxlocomanip.planar.geometry import rectangle
from jaxlocomanip.specification import parse_scenario

MINIMAL = {
    "name": "small",
    "object": {"size": [0.5, 0.4], "mass": 6.0},
    "start": {"pose": [0.0, 0.0, 0.0]},
    "goal": {"pose": [1.0, 0.0, 0.0]},
    "robots": [{"type": "a1", "face": "-x"}],
}


def made(**groups):
    return build(parse_scenario(MINIMAL | groups))


def refusal(**groups):
    with pytest.raises(InputError) as caught:
        made(**groups)
    assert "\n" not in str(caught.value)
    return str(caught.value)


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


@pytest.mark.parametrize("name", library.names())
def test_on_the_host_the_arrays_are_the_same(name):
    spec = library.load(name)
    pairs = zip(jax.tree.leaves(build(spec, 3)), jax.tree.leaves(build_on_host(spec, 3)), strict=True)
    for device, host in pairs:
        assert isinstance(host, np.ndarray) and isinstance(device, jax.Array)
        assert host.dtype == device.dtype and np.array_equal(host, device)


@pytest.mark.usefixtures("x64")
def test_robots_stand_where_the_arrays_say():
    spec = parse_scenario(MINIMAL | {"robots": [{"type": "a1", "face": "-y", "offset": 0.1}]})
    team, pose = build(spec).team, jnp.array([1.0, 2.0, 0.5])
    expected = rectangle(team.robot_poses(pose, team.offset)[0], team.half_length[0], team.half_width[0])
    assert robot_rectangles(spec, pose, [0.1])[0] == pytest.approx(np.asarray(expected), abs=1e-12)


def test_robots_across_a_short_edge_may_not_overlap():
    half, cut = 0.25, 0.02
    low, high = half - cut, half
    chamfered = [
        [-low, -high], [low, -high], [high, -low], [high, low], [low, high], [-low, high], [-high, low], [-high, -low],
    ]  # fmt: skip
    robots = [{"type": "a1", "face": 0, "offset": -0.15}, {"type": "a1", "face": 2, "offset": 0.15}]
    body = {"footprint": chamfered, "mass": 6.0}
    with pytest.raises(InputError, match=r"robots\[0\] and robots\[1\]: overlap by 0\.0[0-9]+ m"):
        made(object=body, robots=robots)
    made(object=body, robots=[one | {"offset": 0.0} for one in robots])
