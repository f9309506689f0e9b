"""Planner settings as files: an exact round trip, refusals by field, ablations that change nothing else."""

import dataclasses
import math
import re
import tomllib
from typing import get_type_hints

import jax
import jax.numpy as jnp
import pytest

from jaxlocomanip.checked import InputError
from jaxlocomanip.config_file import (
    FEATURES,
    RANGES,
    config_from_table,
    config_to_toml,
    load_config,
    named_config,
    with_settings,
    without,
)
from jaxlocomanip.planner import config as planner_config
from jaxlocomanip.planner.config import PlannerConfig
from jaxlocomanip.planner.presets import PRESETS, preset

every_preset = pytest.mark.parametrize("name", PRESETS)


def leaf_paths(config):
    """Every number of a configuration by its path."""
    pairs = {}

    def visit(node, where):
        for field in dataclasses.fields(node):
            value, path = getattr(node, field.name), [*where, field.name]
            if dataclasses.is_dataclass(value):
                visit(value, path)
            else:
                pairs[".".join(path)] = value

    visit(config, [])
    return pairs


@every_preset
def test_presets_survive_the_round_trip(name, tmp_path):
    path = tmp_path / "config.toml"
    path.write_text(config_to_toml(preset(name)))
    again = load_config(path)
    assert again == preset(name)
    assert config_to_toml(again) == config_to_toml(preset(name))


@every_preset
def test_the_round_trip_shares_the_compilation(name):
    again = config_from_table(tomllib.loads(config_to_toml(preset(name))))
    assert jax.tree.structure(again) == jax.tree.structure(preset(name))


def test_awkward_numbers_survive_the_round_trip():
    config = PlannerConfig()
    reference = dataclasses.replace(config.reference, speed=0.1 + 0.2, lead=1e6 / 3, settle=1e-2 / 3)
    config = dataclasses.replace(config, reference=reference)
    assert config_from_table(tomllib.loads(config_to_toml(config))) == config


def test_tuned_settings_may_be_arrays():
    config = PlannerConfig()
    weights = dataclasses.replace(config.weights, force=jnp.asarray(0.25), pose=tuple(jnp.ones(3)))
    again = config_from_table(tomllib.loads(config_to_toml(dataclasses.replace(config, weights=weights))))
    assert (again.weights.force, again.weights.pose) == (0.25, (1.0, 1.0, 1.0))


def test_what_is_left_out_comes_from_the_preset():
    table = {"horizon": {"steps": 10}, "constraints": {"force": {"weight": 1}}}
    for name in PRESETS:
        config, base = config_from_table({"preset": name, **table}), preset(name)
        differing = {k for k, v in leaf_paths(config).items() if v != leaf_paths(base)[k]}
        assert differing == {"horizon.steps", "constraints.force.weight"}
    assert config_from_table({}) == PlannerConfig()


@pytest.mark.parametrize(
    ("table", "expected"),
    [
        ({"preset": "rubust"}, "preset = 'rubust': must be one of robust, paper; did you mean 'robust'?"),
        ({"weigths": {}}, "config: unknown key 'weigths'; did you mean 'weights'?"),
        ({"horizon": {"step": 3}}, "horizon: unknown key 'step'; did you mean 'steps'?"),
        ({"horizon": 3}, "horizon = 3: must be a table"),
        ({"horizon": {"steps": 1}}, "horizon.steps = 1: must be a whole number >= 2"),
        ({"horizon": {"steps": 20.0}}, "horizon.steps = 20.0: must be a whole number"),
        ({"horizon": {"steps": True}}, "horizon.steps = True: must be a whole number"),
        ({"horizon": {"sqp_iterations": 0}}, "horizon.sqp_iterations = 0: must be a whole number >= 1"),
        ({"horizon": {"tick": 0.0}}, "horizon.tick = 0.0: must be >= 0.001"),
        ({"horizon": {"dt": "0.1"}}, "horizon.dt = '0.1': must be a number"),
        ({"weights": {"pose": [1.0, 2.0]}}, "weights.pose = [1.0, 2.0]: must be 3 numbers"),
        ({"weights": {"pose": [1.0, -2.0, 0.0]}}, "weights.pose[1] = -2.0: must be >= 0"),
        ({"weights": {"force": math.nan}}, "weights.force = nan: must be finite"),
        ({"weights": {"force": 1e30}}, "weights.force = 1e+30: must be >= 0 and <= 1e+09"),
        ({"constraints": {"clf": {"switch": 0.0}}}, "constraints.clf.switch = 0.0: must be >= 1e-06"),
        ({"constraints": {"clf": {"weight": -1}}}, "constraints.clf.weight = -1: must be >= 0"),
        ({"constraints": {"clf": 0.5}}, "constraints.clf = 0.5: must be a table"),
        ({"reference": {"speed": 0}}, "reference.speed = 0: must be >= 0.001"),
        ({"reference": {"arrive": 0.97}}, "reference.arrive = 0.97: must be <= reference.leave = 0.95"),
        ({"protection": {"robots": 2}}, "protection.robots = 2: must be >= 0 and <= 1"),
    ],
)
def test_refusals_name_field_value_and_what_is_allowed(table, expected):
    with pytest.raises(InputError) as caught:
        config_from_table(table, "my.toml")
    assert str(caught.value).startswith(f"my.toml: {expected}")
    assert "\n" not in str(caught.value)


def test_ranges_and_features_name_existing_settings():
    for key in RANGES:
        group, field = key.split(".")
        assert field in get_type_hints(getattr(planner_config, group)), key
    for settings in FEATURES.values():
        assert settings.keys() <= leaf_paths(PlannerConfig()).keys()


@pytest.mark.parametrize("feature", FEATURES)
@every_preset
def test_without_changes_its_settings_and_nothing_else(name, feature):
    before, after = leaf_paths(preset(name)), leaf_paths(without(preset(name), [feature]))
    for path, value in after.items():
        if path in FEATURES[feature]:
            values = value if isinstance(value, tuple) else (value,)
            assert set(values) == {FEATURES[feature][path]}
        else:
            assert value == before[path]


def test_without_combines_and_refuses():
    config = without(PlannerConfig(), ["clf", "path"])
    assert (config.constraints.clf.weight, config.reference.plan_path) == (0.0, 0.0)
    assert without(PlannerConfig(), []) == PlannerConfig()
    with pytest.raises(InputError, match="without = 'pth': must be one of .*; did you mean 'path'?"):
        without(PlannerConfig(), ["pth"])


def test_named_configurations_are_presets_and_files(tmp_path):
    path = tmp_path / "mine.toml"
    path.write_text('preset = "paper"\n')
    assert named_config("robust") == preset("robust")
    assert named_config(str(path)) == preset("paper")
    with pytest.raises(
        InputError, match="config = 'papr': must be a file or one of robust, paper; did you mean 'paper'"
    ):
        named_config("papr")


def test_single_settings_are_replaced_by_their_names():
    config = with_settings(preset("robust"), {"reference.speed": 0.4, "constraints.robot_cbf.weight": 1})
    assert (config.reference.speed, config.constraints.robot_cbf.weight) == (0.4, 1.0)
    assert with_settings(
        config, {"reference.speed": 0.5, "constraints.robot_cbf.weight": preset("robust").constraints.robot_cbf.weight}
    ) == preset("robust")
    assert with_settings(config, {"horizon.rest_skips": False}).horizon.rest_skips is False
    for name, value in {"sped": 1.0, "reference.sped": 1.0, "reference": 1.0, "horizon.rest_skips": 1}.items():
        with pytest.raises(InputError):
            with_settings(config, {name: value})


@pytest.mark.parametrize(
    ("group", "name", "value", "limit"),
    [
        ("reference", "clearance", 0.0, "reference.clearance = 0.0: must be >= 0.1"),
        ("reference", "walk_fraction", 0.0, "reference.walk_fraction = 0.0: must be >= 0.001"),
        ("reference", "arrive", 1.0, "reference.arrive = 1: must be <= reference.leave = 0.95"),
        (
            "constraints",
            "force",
            {"reach": 0.5},
            "constraints.force.reach = 0.5: must be > constraints.force.switch = 1",
        ),
    ],
)
def test_settings_with_which_nothing_would_move_are_refused(group, name, value, limit):
    with pytest.raises(InputError, match=re.escape(limit)):
        config_from_table({group: {name: value}})
    with pytest.raises(InputError, match=re.escape(limit)):
        with_settings(PlannerConfig(), {f"{group}.{name}": value})
