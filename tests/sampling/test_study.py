"""Study files: what they may say, and those that come with the package."""

import json
import pickle
import re

import pytest

from jaxlocomanip.checked import InputError
from jaxlocomanip.sampling import study
from jaxlocomanip.sampling.distributions import Choice, Constant, Integer, Uniform
from jaxlocomanip.sampling.study import describe, find_study, parse_study

every_name = pytest.mark.parametrize("name", study.names())


def test_the_studies_are_there():
    expected = {
        "ablations", "layouts", "mass_friction", "moving", "moving_speed", "presets", "standard", "starts",
        "team_size", "turn",
    }  # fmt: skip
    assert set(study.names()) == expected


@every_name
def test_every_study_is_correct_and_bears_its_files_name(name):
    found = find_study(name)
    assert found.name == name
    assert 20 < len(describe(name)) < 130
    json.dumps(dict(found.data))
    again = pickle.loads(pickle.dumps(found))
    assert (again.name, again.count, again.variants, len(again.points)) == (
        found.name,
        found.count,
        found.variants,
        len(found.points),
    )


def test_standard_is_what_the_planner_is_judged_on():
    given = find_study("standard").parameters
    expected = {
        "duration": Constant(60.0),
        "object.size": Constant((0.5, 0.5)),
        "object.mass": Constant(6.0),
        "truth.mass_ratio": Uniform(0.5, 2.0),
        "truth.friction": Uniform(0.15, 0.6),
        "truth.com_offset": Uniform(-0.2, 0.2),
        "goal.distance": Uniform(4.0, 7.0),
        "goal.bearing": Uniform(0.0, 1.0),
        "goal.heading": Uniform(-0.5, 0.5),
        "team.size": Constant(2),
        "team.types": Choice(("aliengo", "a1", "go1")),
        "obstacles.count": Integer(2, 4),
        "obstacles.shape": Choice(("box", "circle")),
        "obstacles.half_size": Uniform(0.2, 0.5),
        "obstacles.along": Uniform(0.0, 1.0),
        "obstacles.lateral": Uniform(-1.5, 1.5),
        "motion.count": Constant(0),
        "sensing.position_std": Constant(0.005),
        "sensing.heading_std": Constant(0.01),
        "sensing.command_delay": Constant(0.02),
    }
    assert {name: given[name] for name in expected} == expected


def test_moving_and_turn_differ_from_standard_in_what_they_say():
    base, moving, turn = (find_study(name).parameters for name in ("standard", "moving", "turn"))

    def changed(other):
        return {name for name, one in other.items() if one != base[name]}

    motion = {"count", "kind", "speed", "heading", "amplitude", "meeting"}
    assert changed(moving) == {f"motion.{name}" for name in motion}
    assert (moving["motion.count"], moving["motion.speed"]) == (Integer(1, 3), Uniform(0.05, 0.5))
    assert changed(turn) == {"goal.heading", "team.size"}
    assert (turn["goal.heading"], turn["team.size"]) == (Uniform(-3.1416, 3.1416), Integer(3, 4))


def test_ablations_switch_off_one_thing_each():
    variants = {variant.name: (variant.without, dict(variant.settings)) for variant in find_study("ablations").variants}
    assert variants.pop("full") == ((), {})
    assert variants.pop("single start") == ((), {"reference.second_start": 0.0})
    assert {names for names, _ in variants.values()} == {
        ("adaptation",), ("robot-cbf",), ("object-cbf",), ("clf",), ("path",), ("faces",), ("filter",),
    }  # fmt: skip


def test_a_grid_visits_all_combinations_and_lanes_go_round():
    text = """
    name = "grid"
    [[axes]]
    parameter = "truth.mass_ratio"
    values = [1.0, 2.0]
    [[axes]]
    parameter = "truth.friction"
    values = [0.1, 0.2, 0.3]
    """
    grid = parse_study(text)
    pairs = [(p.values["truth.mass_ratio"].at(0.5), p.values["truth.friction"].at(0.5)) for p in grid.points]
    assert pairs == [(m, f) for m in (1.0, 2.0) for f in (0.1, 0.2, 0.3)]
    assert grid.point(7) is grid.points[1]
    assert grid.distribution("truth.friction", 7) == Constant(0.2)
    assert grid.distribution("duration", 7) == Constant(60.0)


def test_points_of_a_list_have_names_and_may_be_random():
    text = """
    name = "list"
    [[points]]
    name = "heavy"
    set = { "truth.mass_ratio" = { uniform = [1.5, 2.0] } }
    [[points]]
    name = "plain"
    set = {}
    """
    points = parse_study(text).points
    assert [point.name for point in points] == ["heavy", "plain"]
    assert points[0].values == {"truth.mass_ratio": Uniform(1.5, 2.0)}


@pytest.mark.parametrize(
    ("text", "expected"),
    [
        ("", "study: missing key 'name'"),
        ('name = "a/b"', "name = 'a/b': must be a text usable as a file name"),
        ('name = "a"\ncoun = 3', "study: unknown key 'coun'; did you mean 'count'?"),
        ('name = "a"\ncount = 0', "count = 0: must be a whole number >= 1"),
        ('name = "a"\nworld = "planr"', "world = 'planr': must be one of planar, quadruped; did you mean 'planar'?"),
        ('name = "a"\nextends = "standrd"', "extends = 'standrd': must be one of .*; did you mean 'standard'?"),
        ('name = "a"\n[truth]\nmass_rato = 3', "truth: unknown key 'mass_rato'; did you mean 'mass_ratio'?"),
        ('name = "a"\n[truth]\nfriction = 3', "truth.friction = 3: must be >= 0 and <= 2"),
        ('name = "a"\n[obstacles]\ncount = { integer = [2, 99] }', r"obstacles.count.integer\[1\] = 99: must be a"),
        ('name = "a"\n[team]\ntypes = { choice = ["spot"] }', r"team.types.choice\[0\] = 'spot': must be one of"),
        ('name = "a"\n[team]\nfaces = ["-x", "-z"]', r"team.faces\[1\] = '-z': must be one of -y, \+x, \+y, -x"),
        ('name = "a"\n[team]\nfaces = "any"', "team.faces = 'any': must be 'consecutive' or a list"),
        ('name = "a"\n[obstacles]\nfixed = [{ shape = "box" }]', r"obstacles.fixed\[0\]: missing key 'along'"),
        ('name = "a"\naxes = 3', r"axes = 3: must be a list of tables, \[\[axes\]\]"),
        ('name = "a"\n[[axes]]\nparameter = "x"\nvalues = [1]', r"axes\[0\].parameter = 'x': unknown parameter"),
        ('name = "a"\n[[axes]]\nparameter = "truth.friction"\nvalues = []', r"axes\[0\].values = \[\]: must be a list"),
        (
            'name = "a"\n' + 2 * '[[axes]]\nparameter = "truth.friction"\nvalues = [0.1]\n',
            "axes: 'truth.friction' is given twice",
        ),
        (
            'name = "a"\n[[points]]\nname = "p"\nset = { "truth.fricton" = 1 }',
            r"points\[0\].set: unknown key 'truth.fricton'; did you mean 'truth.friction'\?",
        ),
        (
            'name = "a"\n[[points]]\nname = "p"\nset = {}\n[[axes]]\nparameter = "duration"\nvalues = [1]',
            "study: only one of axes",
        ),
        ('name = "a"\n[[variants]]\nname = "v"\nwithout = "clf"', r"variants\[0\].without = 'clf': must be a list"),
        ('name = "a"\n[[variants]]\nconfig = "v"', r"variants\[0\]: missing key 'name'"),
        ("name = ", "is not valid TOML"),
    ],
)  # fmt: skip
def test_bad_studies_are_refused(text, expected):
    with pytest.raises(InputError) as caught:
        parse_study(text, "bad.toml")
    assert re.match(f"bad.toml: {expected}", str(caught.value)), caught.value


def test_studies_are_found_by_name_and_file(tmp_path):
    path = tmp_path / "mine.toml"
    path.write_text('name = "mine"\nextends = "moving"\n[truth]\nfriction = 0.2\n')
    mine = find_study(str(path))
    assert mine.parameters["truth.friction"] == Constant(0.2)
    assert mine.parameters["motion.count"] == Integer(1, 3)
    assert mine.parameters["truth.mass_ratio"] == Uniform(0.5, 2.0)
    with pytest.raises(InputError, match="study = 'standrd': must be a file or one of .*; did you mean 'standard'?"):
        find_study("standrd")
    with pytest.raises(InputError, match="missing.toml: cannot be read"):
        find_study(str(tmp_path / "missing.toml"))
