"""The named scenarios load, fit together, and are what they say."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from jaxlocomanip import library
from jaxlocomanip.build import build
from jaxlocomanip.checked import InputError
from jaxlocomanip.packaged import Files

every_name = pytest.mark.parametrize("name", library.names())


def test_the_experiments_are_there():
    expected = {"adaptive", "four_robots", "hardware", "people", "robot_cbf", "start_left", "start_right"}
    assert expected <= set(library.names())


@every_name
def test_every_scenario_builds_and_bears_its_files_name(name):
    spec = library.load(name)
    assert spec.name == name
    build(spec)


@every_name
def test_every_scenario_is_described_in_one_line(name):
    assert 20 < len(library.describe(name)) < 120


def test_adaptive_is_the_papers_experiment():
    spec = library.load("adaptive")
    assert (spec.object.mass, spec.truth.mass, spec.truth.friction, spec.object.friction) == (
        6.0,
        8.0,
        0.4,
        None,
    )
    assert (spec.start, spec.goal.pose) == ((0.0, 0.0, 0.0), (5.0, 5.0, 0.0))
    assert [(r.type, r.face) for r in spec.robots] == [("aliengo", "-x"), ("aliengo", "-y")]
    assert [o.position for o in spec.obstacles] == [(3.5, 1.5), (2.0, 2.0)]


def test_left_and_right_are_mirror_images():
    left, right = library.load("start_left"), library.load("start_right")
    assert left.start[:2] == right.start[1::-1]
    assert {o.position for o in left.obstacles} == {o.position[::-1] for o in right.obstacles}
    assert (left.object, left.truth, left.goal) == (right.object, right.truth, right.goal)


@every_name
def test_nobody_walks_faster_than_a_person(name):
    obstacles = build(library.load(name)).obstacles
    ways = np.diff(np.asarray(jax.vmap(obstacles.at)(jnp.linspace(0.0, 40.0, 401))), axis=0)
    assert np.linalg.norm(ways, axis=-1).max() / 0.1 < 0.81


def test_find_takes_names_and_files(tmp_path):
    assert library.find("adaptive") == library.load("adaptive")
    path = tmp_path / "mine"
    path.write_text(Files("scenario", "scenarios").text("people"))
    assert library.find(str(path)) == library.load("people")


def test_find_hints_at_the_nearest_name(tmp_path):
    with pytest.raises(InputError, match="scenario = 'adaptve': .*; did you mean 'adaptive'?"):
        library.find("adaptve")
    with pytest.raises(InputError, match="missing.toml: cannot be read"):
        library.find(str(tmp_path / "missing.toml"))
    with pytest.raises(InputError, match="did you mean 'hardware'?"):
        library.load("hardwear")
