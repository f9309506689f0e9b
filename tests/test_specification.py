"""Scenario files: everything that can be said is read, everything else is refused by field."""

import copy
import math

import pytest

from jaxlocomanip.checked import InputError
from jaxlocomanip.obstacle_spec import box
from jaxlocomanip.specification import BOX_FACES, SensingSpec, TruthSpec, load_scenario, parse_scenario

MINIMAL = {
    "name": "small",
    "object": {"size": [0.5, 0.4], "mass": 6.0},
    "start": {"pose": [0.0, 0.0, 0.0]},
    "goal": {"pose": [1.0, 0.0, 0.0]},
    "robots": [{"type": "a1", "face": "-x"}],
}
BODY = MINIMAL["object"]
TRIANGLE = [[0, 0], [1, 0], [0, 1]]
WALK = {"kind": "waypoints", "times": [0, 1], "points": [[2, 2], [3, 3]]}
CIRCLE = {"shape": "circle", "radius": 0.3, "position": [3, 3]}


def changed(**groups):
    """The minimal scenario with whole groups replaced; None removes one."""
    data = copy.deepcopy(MINIMAL) | groups
    return {key: value for key, value in data.items() if value is not None}


def refusal(data):
    with pytest.raises(InputError) as caught:
        parse_scenario(data)
    text = str(caught.value)
    assert text.startswith("scenario: ")
    assert "\n" not in text
    return text.removeprefix("scenario: ")


def test_defaults_of_a_minimal_scenario():
    spec = parse_scenario(MINIMAL)
    assert spec.duration == 40.0
    assert spec.truth == TruthSpec()
    assert spec.sensing == SensingSpec()
    assert spec.obstacles == ()
    assert (spec.goal.position_tolerance, spec.goal.heading_tolerance) == (0.15, 0.3)
    assert spec.object.friction is None
    assert spec.object.is_box


def test_every_group_is_read():
    sine = {"kind": "sine", "amplitude": [0.5, 0.0], "period": 4.0}
    spec = parse_scenario(
        changed(
            duration=5,
            object={"footprint": TRIANGLE, "mass": 2, "friction": 0.2, "com": [0.1, 0]},
            truth={"mass": 3, "inertia": 2, "friction": 0.3, "com": [0.2, 0]},
            robots=[{"type": "go1", "face": 2, "offset": 0.1}],
            obstacles=[
                {"shape": "box", "size": [1, 1], "position": [3, 3], "yaw": 0.5, "velocity": [0.1, 0]},
                {"shape": "circle", "radius": 0.3, "position": [2, 2], "motion": sine},
                {
                    "shape": "polygon",
                    "vertices": TRIANGLE,
                    "position": [2, 2],
                    "motion": WALK,
                },
            ],
            sensing={"position_std": 0.01, "command_delay": 0.04},
        )
    )
    assert not spec.object.is_box
    assert spec.truth == TruthSpec(3.0, 2.0, 0.3, (0.2, 0.0))
    assert spec.robots[0].face == 2
    assert spec.obstacles[0].velocity == (0.1, 0.0)
    assert spec.obstacles[1].motion.period == 4.0
    assert spec.obstacles[2].motion.points == ((2.0, 2.0), (3.0, 3.0))
    assert spec.sensing == SensingSpec(position_std=0.01, command_delay=0.04)


def test_box_corners_run_counter_clockwise_like_the_face_names():
    corners = box([2.0, 1.0], "size")
    assert corners == ((-1.0, -0.5), (1.0, -0.5), (1.0, 0.5), (-1.0, 0.5))
    middles = [((a[0] + b[0]) / 2, (a[1] + b[1]) / 2) for a, b in zip(corners, corners[1:] + corners[:1], strict=True)]
    assert dict(zip(BOX_FACES, middles, strict=True)) == {
        "-y": (0.0, -0.5), "+x": (1.0, 0.0), "+y": (0.0, 0.5), "-x": (-1.0, 0.0),
    }  # fmt: skip
    turned = box([2.0, 1.0], "size", math.pi / 2)
    assert turned[0] == pytest.approx((0.5, -1.0))


@pytest.mark.parametrize(
    ("groups", "expected"),
    [
        ({"goal": None}, "scenario: missing key 'goal'"),
        ({"objct": {}}, "scenario: unknown key 'objct'; did you mean 'object'?"),
        ({"name": "a/b"}, "name = 'a/b': must be a text usable as a file name"),
        ({"name": ""}, "name = '': must be"),
        ({"duration": 0}, "duration = 0: must be >= 0.1 and <= 3600"),
        ({"object": BODY | {"mass": -6}}, "object.mass = -6: must be > 0"),
        ({"object": BODY | {"mass": math.inf}}, "object.mass = inf: must be finite"),
        ({"object": {"mass": 1}}, "object: exactly one of size and footprint"),
        ({"object": BODY | {"footprint": TRIANGLE}}, "object: exactly one of size and footprint"),
        ({"object": BODY | {"size": [0.5, 0.0]}}, "object.size[1] = 0.0: must be > 0"),
        (
            {"object": {"mass": 1, "footprint": [[0, 0], [2, 0], [1, 0.2], [0, 1]]}},
            "object.footprint = [[0.0, 0.0], [2.0, 0.0], [1.0, 0.2], [0.0, 1.0]]: must be strictly convex",
        ),
        ({"object": BODY | {"friction": 3}}, "object.friction = 3: must be >= 0 and <= 2"),
        ({"truth": {"mas": 8}}, "truth: unknown key 'mas'; did you mean 'mass'?"),
        ({"start": {"pose": [0.0, math.nan, 0.0]}}, "start.pose[1] = nan: must be finite"),
        ({"goal": {"pose": [0, 0]}}, "goal.pose = [0, 0]: must be 3 numbers"),
        ({"goal": {"pose": [0, 0, 0], "position_tolerance": 0}}, "goal.position_tolerance = 0: must be > 0"),
        ({"robots": []}, "robots: must be a list of at least 1 tables"),
        ({"robots": [{"type": "spot", "face": "-x"}]}, "robots[0].type = 'spot': must be one of aliengo, a1"),
        ({"robots": [{"type": "a1", "face": "-z"}]}, "robots[0].face = '-z': must be one of -y, +x, +y, -x"),
        ({"robots": [{"type": "a1", "face": 4}]}, "robots[0].face = 4: must be an edge index from 0 to 3"),
        ({"robots": [{"type": "a1", "face": True}]}, "robots[0].face = True: must be an edge index"),
        ({"obstacles": [CIRCLE | {"size": [1, 1]}]}, "obstacles[0] (a circle): unknown key 'size'"),
        ({"obstacles": [CIRCLE | {"radius": -1}]}, "obstacles[0].radius = -1: must be > 0"),
        ({"obstacles": [CIRCLE | {"shape": "disc"}]}, "obstacles[0].shape = 'disc': must be one of"),
        ({"obstacles": [CIRCLE, CIRCLE | {"motion": {"kind": "sin"}}]}, "obstacles[1].motion.kind = 'sin'"),
        (
            {"obstacles": [CIRCLE | {"motion": WALK | {"times": [1, 1]}}]},
            "obstacles[0].motion.times = [1.0, 1.0]: must increase",
        ),
        ({"sensing": {"position_std": 1.0}}, "sensing.position_std = 1.0: must be >= 0 and <= 0.1"),
    ],
)
def test_refusals_name_field_value_and_what_is_allowed(groups, expected):
    assert refusal(changed(**groups)).startswith(expected)


def test_faces_of_a_polygon_are_indices():
    text = refusal(changed(object={"footprint": TRIANGLE, "mass": 1.0}))
    assert text == "robots[0].face = '-x': must be an edge index from 0 to 2"


def test_errors_of_files_name_the_file(tmp_path):
    missing, broken, binary = tmp_path / "missing.toml", tmp_path / "broken.toml", tmp_path / "binary.toml"
    broken.write_text("name = \n")
    binary.write_bytes(b"\xff\xfe\x00")
    unreadable, invalid = "cannot be read", "is not valid TOML"
    for path, reason in [
        (missing, unreadable),
        (tmp_path, unreadable),
        (broken, invalid),
        (binary, invalid),
    ]:
        with pytest.raises(InputError, match=reason) as caught:
            load_scenario(path)
        assert str(caught.value).startswith(str(path))


@pytest.mark.parametrize(
    ("groups", "message"),
    [
        ({"object": BODY | {"com": [0.6, 0.0]}}, "object.com = [0.6, 0.0]: must lie within the object's footprint"),
        ({"truth": {"com": [0.0, -5.0]}}, "truth.com = [0.0, -5.0]: must lie within the object's footprint"),
        ({"start": {"pose": [1e6, 0.0, 0.0]}}, "start.pose[0] = 1000000.0: must be >= -100 and <= 100"),
        ({"goal": {"pose": [0.0, 0.0, 1e4]}}, "goal.pose[2] = 10000.0: must be >= -100 and <= 100"),
        (
            {"obstacles": [CIRCLE | {"motion": WALK}]},
            "obstacles[0].position = [3.0, 3.0]: must be the first waypoint, [2.0, 2.0]",
        ),
        (
            {"obstacles": [CIRCLE | {"position": [2, 2], "motion": WALK, "velocity": [0.1, 0.0]}]},
            "obstacles[0].velocity = [0.1, 0.0]: must be left out where waypoints say the motion",
        ),
    ],
)
def test_what_cannot_be_meant_is_refused(groups, message):
    assert message in refusal(changed(**groups))
