"""Chunks: one compilation, lanes that do not depend on their chunk, and several devices."""

import dataclasses
import os
import subprocess
import sys

import jax
import numpy as np
import pytest

from jaxlocomanip import batch
from jaxlocomanip.batch import Runner, Shape, run
from jaxlocomanip.checked import InputError
from jaxlocomanip.closed_loop import Result
from jaxlocomanip.config_file import config_from_table
from jaxlocomanip.outcome import Outcome
from jaxlocomanip.padding import Padding
from jaxlocomanip.sampling.sampler import draw
from jaxlocomanip.sampling.study import parse_study

COUNT = 10
SHAPE = Shape(lanes=4, duration=0.4, padding=Padding(obstacles=2, corners=4, marks=1, vertices=4, discs=1))


@pytest.fixture(scope="module")
def config():
    return config_from_table({"horizon": {"steps": 5}})


@pytest.fixture(scope="module")
def scenarios(tiny_study):
    study = parse_study(tiny_study)
    return [draw(study, 0, lane).scenario for lane in range(COUNT)]


@pytest.fixture(scope="module")
def runner():
    return Runner(devices=jax.local_devices()[:1])


@pytest.fixture(scope="module")
def outcome(runner, scenarios, config):
    """Of all scenarios in chunks of four, and what it took."""
    parts = [runner(scenarios[i : i + 4], config, 0, SHAPE) for i in range(0, COUNT, 4)]
    return jax.tree.map(lambda *leaves: np.concatenate(leaves), *parts)


def fields(outcome):
    return {f.name: np.asarray(getattr(outcome, f.name)) for f in dataclasses.fields(outcome)}


def assert_close(a, b, tolerance):
    for name, value in fields(a).items():
        other = fields(b)[name]
        assert np.allclose(value, other, rtol=tolerance, atol=tolerance, equal_nan=True), name


def test_what_was_prepared_is_not_compiled_again(runner, scenarios, config, outcome):
    runner.prepare(scenarios[:1], config, SHAPE)
    assert len(runner.compilations) == 1


def test_all_chunks_share_one_compilation(runner, outcome):
    assert len(runner.compilations) == 1
    assert runner.compilations[0].seconds > 0.0
    for name, value in fields(outcome).items():
        assert isinstance(value, np.ndarray) and value.shape[0] == COUNT, name
    assert (outcome.ticks == 20).all() and (outcome.nonfinite == 0).all()
    assert (outcome.path_length_m > 0.0).any()


def test_a_lane_is_the_same_in_any_chunk_and_order(runner, outcome, scenarios, config):
    mixed = [scenarios[lane] for lane in (9, 3, 0)]
    again = runner(mixed, config, 0, SHAPE)
    assert_close(again, jax.tree.map(lambda leaf: leaf[[9, 3, 0]], outcome), 1e-6)


def test_other_settings_need_no_other_compilation(runner, outcome, scenarios, config):
    heavier = dataclasses.replace(config, weights=dataclasses.replace(config.weights, offset=3.0))
    runner(scenarios[:4], heavier, 0, SHAPE)
    assert len(runner.compilations) == 1


def test_noise_follows_the_seed(runner, outcome, scenarios, config):
    other = runner(scenarios[:4], config, 1, SHAPE)
    assert (other.estimates != outcome.estimates[:4]).any()


def test_any_number_of_scenarios_runs_in_order(outcome, scenarios, config, runner, monkeypatch):
    monkeypatch.setattr("jaxlocomanip.batch.Runner", lambda *_: runner)
    monkeypatch.setattr("jaxlocomanip.batch.Padding.of", lambda _: SHAPE.padding)
    seen = []
    whole = run(scenarios, config, chunk=4, progress=lambda done, every: seen.append((done, every)))
    assert seen == [(4, 10), (8, 10), (10, 10)]
    assert_close(whole, outcome, 0.0)


@pytest.mark.parametrize(
    ("change", "expected"),
    [
        ({"lanes": 2}, "scenarios: 4 do not fit into a chunk of 2"),
        ({"duration": 0.2}, "duration = 0.4 s: must be <= 0.2 s"),
        ({"padding": Padding(obstacles=1, vertices=4)}, "padding.obstacles = 1: must be >= 2"),
    ],
)
def test_what_does_not_fit_is_refused(runner, scenarios, config, change, expected):
    largest = sorted(scenarios, key=lambda s: -int(s.obstacles.mask.sum()))[:4]
    with pytest.raises(InputError, match=expected):
        runner(largest, config, 0, dataclasses.replace(SHAPE, **change))


def test_nothing_to_run_and_unknown_worlds_are_refused(scenarios):
    with pytest.raises(InputError, match="at least one"):
        run([])
    with pytest.raises(InputError, match="did you mean 'planar'"):
        Runner("planr")


TWO_DEVICES = """
import sys, jax, numpy as np
from jaxlocomanip.batch import Runner, Shape
from jaxlocomanip.config_file import config_from_table
from jaxlocomanip.sampling.sampler import draw
from jaxlocomanip.sampling.study import parse_study
from jaxlocomanip.padding import Padding

assert len(jax.devices()) == 2
study = parse_study(open(sys.argv[1]).read())
scenarios = [draw(study, 0, lane).scenario for lane in range(3)]
shape = Shape(4, 0.4, Padding(obstacles=2, corners=4, marks=1, vertices=4, discs=1))
runner = Runner()
outcome = runner(scenarios, config_from_table({"horizon": {"steps": 5}}), 0, shape)
assert len(runner.devices) == 2 and len(runner.compilations) == 1
np.savez(sys.argv[2], **{name: getattr(outcome, name) for name in outcome.__dataclass_fields__})
"""


def test_two_devices_give_the_same_rows(outcome, tiny_study, tmp_path):
    (tmp_path / "tiny.toml").write_text(tiny_study)
    environment = os.environ | {"XLA_FLAGS": "--xla_force_host_platform_device_count=2", "JAX_PLATFORMS": "cpu"}
    command = [sys.executable, "-c", TWO_DEVICES, str(tmp_path / "tiny.toml"), str(tmp_path / "rows.npz")]
    subprocess.run(command, check=True, env=environment, timeout=500)
    rows = np.load(tmp_path / "rows.npz")
    for name, value in fields(outcome).items():
        assert rows[name].shape == value[:3].shape
        assert np.allclose(rows[name], value[:3], rtol=1e-3, atol=1e-3, equal_nan=True), name


def test_worlds_outside_of_jax_take_the_lanes_one_by_one(scenarios, config, monkeypatch):
    """All in one shape, so that the planner's half of the loop compiles once."""
    shapes, real = set(), np.zeros((), np.float32)

    def compiled(lane, settings, world, *, record):
        assert (settings, world.traceable, record) == (config, False, False)
        shapes.add(tuple(leaf.shape for leaf in jax.tree.leaves(lane)))
        index = int(lane.index)
        values = {name: real + index for name in Outcome.__dataclass_fields__}
        return lambda seed: Result(Outcome(**values), None)

    pytest.importorskip("mujoco")
    monkeypatch.setattr(batch, "compiled", compiled)
    outcome = Runner("quadruped", "c")(scenarios[4:7], config, 0, SHAPE)
    assert outcome.path_length_m.tolist() == [4.0, 5.0, 6.0]
    assert len(shapes) == 1
