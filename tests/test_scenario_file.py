"""Scenarios written as TOML read back equal."""

import tomllib

import pytest

from jaxlocomanip import library
from jaxlocomanip.sampling.sampler import sample
from jaxlocomanip.scenario_file import scenario_to_toml
from jaxlocomanip.specification import parse_scenario


def again(spec):
    return parse_scenario(tomllib.loads(scenario_to_toml(spec)))


@pytest.mark.parametrize("name", library.names())
def test_the_library_reads_back(name):
    spec = library.find(name)
    assert again(spec) == spec


@pytest.mark.parametrize("study", ["standard", "moving"])
def test_random_scenarios_read_back(study):
    for index in range(8):
        spec = sample(study, 3, index)
        assert again(spec) == spec


def test_every_kind_of_shape_and_motion():
    triangle = [[0.0, 0.0], [0.6, 0.0], [0.0, 0.6]]
    walk = {"kind": "waypoints", "times": [0.0, 2.0], "points": [[3.0, 0.0], [3.0, 1.0]]}
    spec = parse_scenario(
        {
            "name": 'the "kinds" of °',
            "object": {"footprint": triangle, "mass": 3.0, "friction": 0.2, "com": [0.1, 0.1]},
            "start": {"pose": [0.0, 0.0, 0.1]},
            "goal": {"pose": [2.0, 0.0, 0.0], "heading_tolerance": 0.2},
            "robots": [{"type": "a1", "face": 2, "offset": -0.05}],
            "obstacles": [
                {"shape": "polygon", "position": [3.0, 0.0], "vertices": triangle, "motion": walk},
                {"shape": "circle", "position": [0.0, 4.0], "radius": 0.3, "velocity": [0.1, 0.0]},
                {"shape": "box", "position": [0.0, -4.0], "size": [0.2, 0.7], "yaw": 0.3},
            ],
        }
    )
    assert again(spec) == spec
