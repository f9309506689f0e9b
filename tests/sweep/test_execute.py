"""Sweeps end to end: killed and gone on with, the rows are those of an uninterrupted run."""

import json
import os
import signal
import subprocess
import sys
import time

import jax
import pytest

from jaxlocomanip.batch import Runner
from jaxlocomanip.config_file import config_from_table
from jaxlocomanip.planner.config import PlannerConfig
from jaxlocomanip.sampling.study import parse_study
from jaxlocomanip.sweep import execute as module
from jaxlocomanip.sweep.execute import Progress, duration, execute
from jaxlocomanip.sweep.plan import plan_sweep
from jaxlocomanip.sweep.store import read_results

VARIANTS = '\n[[variants]]\nname = "full"\n[[variants]]\nname = "blind"\nwithout = ["adaptation"]\n'


@pytest.fixture(scope="module")
def files(tmp_path_factory, tiny_study, quick_config):
    folder = tmp_path_factory.mktemp("study")
    (folder / "tiny.toml").write_text(tiny_study + VARIANTS)
    (folder / "quick.toml").write_text(quick_config)
    return folder


@pytest.fixture(scope="module")
def plan(tiny_study):
    return plan_sweep(parse_study(tiny_study + VARIANTS), config_from_table({"horizon": {"steps": 5}}))


@pytest.fixture(scope="module")
def runner():
    return Runner(devices=jax.local_devices()[:1])


@pytest.fixture(scope="module")
def whole(plan, runner, files):
    """The directory of an uninterrupted sweep, and what it said."""
    said = []
    execute(plan, str(files / "whole"), runner, ["sweep", "tiny.toml"], said.append)
    return files / "whole", "".join(said)


def test_one_row_for_every_scenario_and_planner(whole):
    table = read_results(whole[0])
    assert table["variant"].to_pylist() == ["full"] * 10 + ["blind"] * 10
    assert table["lane"].to_pylist() == 2 * list(range(10))
    masses = table["mass_kg"].to_pylist()
    assert masses[:10] == masses[10:]
    assert table["estimated_friction_n"].to_pylist()[:10] != table["estimated_friction_n"].to_pylist()[10:]
    assert table["ticks"].to_pylist() == [20] * 20


def test_the_manifest_says_how_to_repeat_it(whole):
    manifest = json.loads((whole[0] / "manifest.json").read_text())
    assert manifest["complete"] and manifest["lanes"] == 10
    assert manifest["command"] == ["sweep", "tiny.toml"]
    assert manifest["device"] == {"kind": jax.devices()[0].device_kind, "count": 1}
    settings = manifest["settings"]
    assert (settings["seed"], settings["dtype"], settings["platform"]) == (0, "float32", "cpu")
    assert {"jax", "jaxlib", "numpy", "jaxlocomanip", "python"} == settings["versions"].keys()
    table = read_results(whole[0])
    rejected = {name: sum(table[f"rejected_{name}"].to_pylist()[:10]) for name in manifest["rejected"]}
    assert manifest["rejected"] == rejected


def test_progress_is_told(whole):
    lines = whole[1].splitlines()
    assert lines[0] == "tiny: 10 scenarios x 2 planners in chunks of 4"
    assert lines[1].startswith("compiled in ")
    assert [line.split()[0] for line in lines[2:]] == ["4/20", "8/20", "12/20", "16/20", "18/20", "20/20"]
    assert all("scenarios/s, " in line and line.endswith("left") for line in lines[2:])


def test_a_finished_sweep_is_not_run_again(whole, plan):
    before = (whole[0] / "results.parquet").stat().st_mtime_ns

    class Idle(Runner):
        def __call__(self, *_):
            pytest.fail("ran again")

    execute(plan, str(whole[0]), Idle(devices=jax.local_devices()[:1]), [], lambda _: None)
    assert (whole[0] / "results.parquet").stat().st_mtime_ns == before


def test_an_interrupted_sweep_goes_on(whole, plan, runner, tmp_path, monkeypatch):
    """Interrupted after each of its pieces in turn."""
    real, calls = module.run_unit, []

    def once(*arguments):
        if len(calls) % 2:
            calls.append("interrupted")
            raise KeyboardInterrupt
        calls.append("run")
        return real(*arguments)

    monkeypatch.setattr(module, "run_unit", once)
    for _ in range(5):
        with pytest.raises(KeyboardInterrupt):
            execute(plan, str(tmp_path / "out"), runner, [], lambda _: None)
    said = []
    execute(plan, str(tmp_path / "out"), runner, [], said.append)
    assert calls.count("run") == 6
    assert said[1] == "going on after 18 of 20 scenarios\n"
    assert read_results(tmp_path / "out").equals(read_results(whole[0]))


def test_a_killed_sweep_goes_on(whole, files, tmp_path):
    """SIGKILL leaves the process no time for anything; the same command does the rest."""
    paths = [str(files / "tiny.toml"), "--config", str(files / "quick.toml"), "--out", str(tmp_path / "out")]
    command = [sys.executable, "-m", "jaxlocomanip.cli", "sweep", *paths]
    environment = os.environ | {"XLA_FLAGS": ""}
    process = subprocess.Popen(command, env=environment, stderr=subprocess.DEVNULL)
    chunks = tmp_path / "out" / "chunks"
    deadline = time.monotonic() + 300.0
    while not (chunks.exists() and any(chunks.glob("[!.]*.parquet"))):
        assert process.poll() is None and time.monotonic() < deadline
        time.sleep(0.005)
    process.send_signal(signal.SIGKILL)
    process.wait()
    done = subprocess.run(command, env=environment, capture_output=True, text=True, check=True, timeout=500)
    assert "going on after " in done.stderr or "20/20" not in done.stderr
    assert read_results(tmp_path / "out").equals(read_results(whole[0]))
    refused = subprocess.run([*command, "--seed", "1"], env=environment, capture_output=True, text=True, check=False)
    assert refused.returncode == 2 and "seed = 0 there and 1 here" in refused.stderr


def test_speed_counts_what_this_run_did(monkeypatch):
    now = [0.0]
    monkeypatch.setattr(time, "perf_counter", lambda: now[0])
    progress = Progress(total=100, done=40, started=0.0)
    assert progress.line() == "40/100 scenarios, 0.00 scenarios/s, - left"
    now[0], progress.done = 10.0, 60
    assert progress.line() == "60/100 scenarios, 2.00 scenarios/s, 20 s left"


@pytest.mark.parametrize(("seconds", "text"), [(12.4, "12 s"), (600.0, "10 min"), (9000.0, "2.5 h")])
def test_time_spans_for_people(seconds, text):
    assert duration(seconds) == text


@pytest.mark.slow
@pytest.mark.parametrize("name", ["moving", "turn"])
def test_sweeps_of_the_studies_meet_no_bad_numbers(name, tmp_path, runner):
    """Random scenarios with moving obstacles and with both sizes of team, for 8 s each."""
    text = f'name = "short"\nextends = "{name}"\nduration = 8.0\n'
    plan = plan_sweep(parse_study(text), PlannerConfig(), count=32, chunk=16)
    execute(plan, str(tmp_path / name), runner, [], lambda _: None)
    table = read_results(tmp_path / name)
    assert table["lane"].to_pylist() == list(range(32))
    assert set(table["nonfinite"].to_pylist()) == {0}
    assert set(table["ticks"].to_pylist()) == {400}
