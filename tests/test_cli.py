"""The command line: refusals before any compilation, what it leaves behind, and how it is stopped."""

import importlib.util
import json
import os
import re
import subprocess
import sys

import numpy as np
import pytest

from jaxlocomanip import cli, closed_loop, library
from jaxlocomanip.commands import simulate
from jaxlocomanip.config_file import FEATURES, load_config, without
from jaxlocomanip.outcome import CLEAR, Outcome
from jaxlocomanip.planner.presets import preset
from jaxlocomanip.sampling import study

SCENARIO = """
name = "small"
duration = 0.4
[object]
size = [0.5, 0.5]
mass = 6.0
[truth]
friction = 0.1
[start]
pose = [0.0, 0.0, 0.0]
[goal]
pose = [1.0, 1.0, 0.0]
[[robots]]
type = "a1"
face = "-x"
[[robots]]
type = "a1"
face = "-y"
[[obstacles]]
shape = "box"
size = [0.5, 0.5]
position = [3.0, 0.0]
"""
DENTED = "footprint = [[0.0, 0.0], [1.0, 0.0], [0.1, 0.1], [0.0, 1.0]]"


@pytest.fixture(autouse=True)
def place(tmp_path, monkeypatch):
    """An empty working directory, and an environment that is put back."""
    monkeypatch.chdir(tmp_path)
    monkeypatch.setattr(os, "environ", os.environ.copy())
    return tmp_path


@pytest.fixture
def no_compilation(monkeypatch):
    """Refusals have to come before anything is compiled."""
    monkeypatch.setattr(closed_loop, "compiled", lambda *_, **__: pytest.fail("compiled before refusing"))


def refusal(capsys, *arguments):
    """The one line with which the command line refuses, without its prefix."""
    assert cli.main(list(arguments)) == 2
    out, err = capsys.readouterr()
    assert out == ""
    assert re.fullmatch(r"error: [^\n]+\n", err), err
    return err.removeprefix("error: ").rstrip()


@pytest.mark.usefixtures("no_compilation")
@pytest.mark.parametrize(
    ("old", "new", "expected"),
    [
        ("mass = 6.0", "mass = -6.0", "object.mass = -6.0: must be > 0"),
        ("size = [0.5, 0.5]\nmass", f"{DENTED}\nmass", "object.footprint = [[0.0, 0.0], [1.0, 0.0]"),
        ('face = "-x"', 'face = "-z"', "robots[0].face = '-z': must be one of -y, +x, +y, -x"),
        ("[3.0, 0.0]", "[0.4, 0.0]", "obstacles[0].position = [0.4, 0.0]: overlaps the object at the start"),
        ('type = "a1"', 'type = "spot"', "robots[0].type = 'spot': must be one of aliengo, a1, go1"),
        ("mass =", "mas =", "object: unknown key 'mas'; did you mean 'mass'?"),
        ("pose = [0.0, 0.0, 0.0]", "pose = [0.0, nan, 0.0]", "start.pose[1] = nan: must be finite"),
        ("duration = 0.4", "duration = ", "is not valid TOML"),
    ],
    ids=["mass", "footprint", "face", "overlap", "robot type", "misspelt key", "NaN pose", "corrupt TOML"],
)  # fmt: skip
def test_bad_scenarios_are_refused_in_one_line(capsys, place, old, new, expected):
    assert old in SCENARIO
    (place / "bad.toml").write_text(SCENARIO.replace(old, new, 1))
    text = refusal(capsys, "simulate", "adaptive", "bad.toml")
    assert text.startswith(("bad.toml: ", "small: "))
    assert text.split(": ", 1)[1].startswith(expected)
    assert [path.name for path in place.iterdir()] == ["bad.toml"]


@pytest.mark.usefixtures("no_compilation")
@pytest.mark.parametrize(
    ("arguments", "expected"),
    [
        ("simulate adaptve", "scenario = 'adaptve': must be a file or one of .*; did you mean 'adaptive'\\?"),
        ("simulate missing.toml", "missing.toml: cannot be read \\(No such file or directory\\)"),
        ("simulate adaptive adaptive", "scenario 'adaptive': given twice, or two files have this name"),
        ("simulate adaptive --world planr", "world = 'planr': must be .*; did you mean 'planar'\\?"),
        ("simulate adaptive --config papr", "config = 'papr': must be .*; did you mean 'paper'\\?"),
        ("simulate adaptive --config c.toml", "c.toml: cannot be read"),
        ("simulate adaptive --without robot_cbf", "without = 'robot_cbf': .*; did you mean 'robot-cbf'\\?"),
        ("simulate adaptive --seed -1", "argument --seed: '-1' must be a whole number from 0 to 4294967295"),
        ("simulate adaptive --seed 1.5", "argument --seed: '1.5' must be a whole number"),
        ("simulate adaptive --out file", "file: cannot be used as output directory \\(it is a file\\)"),
        ("simulate adaptive --out file/below", "file/below: cannot be used as output directory"),
        ("simulate adaptive --out /proc", "/proc: cannot be used as output directory"),
        ("simulate adaptive --recrd", "unrecognized arguments: --recrd"),
        ("simulate", "the following arguments are required: SCENARIO"),
        ("simulat adaptive", "argument COMMAND: invalid choice: 'simulat'"),
        ("sweep standrd --out x", "study = 'standrd': must be a file or one of .*; did you mean 'standard'\\?"),
        ("sweep missing.toml --out x", "missing.toml: cannot be read \\(No such file or directory\\)"),
        ("sweep standard", "the following arguments are required: --out"),
        ("sweep standard --out x --count 0", "argument --count: '0' must be a whole number from 1 to 10000000"),
        ("sweep standard --out x --world planr", "world = 'planr': must be .*; did you mean 'planar'\\?"),
        ("sweep standard --out x --config papr", "config = 'papr': must be .*; did you mean 'paper'\\?"),
        ("sweep standard --out x --without path --without cfl", "without = 'cfl': .*; did you mean 'clf'\\?"),
        ("sweep standard --out x --workers dask", "workers = 'dask': must be ray, or ray:N with N from 1 to 10000"),
        ("sweep standard --out x --workers ray:0", "workers = 'ray:0': must be ray, or ray:N"),
        ("sweep standard --out file", "file: cannot be used as output directory \\(it is a file\\)"),
        ("report x", "x/manifest.json: cannot be read .*; is x the --out of a sweep\\?"),
        ("falsify standard --out x --lanes 20", "argument --lanes: 20 must not exceed --screened, which is 16"),
        ("falsify standard --out x --screened 7", "argument --aimed: 8 must not exceed --screened, which is 7"),
        ("report x --worst 0", "argument --worst: '0' must be a whole number from 1"),
        ("", "the following arguments are required: COMMAND"),
    ],
)  # fmt: skip
def test_bad_arguments_are_refused_in_one_line(capsys, place, arguments, expected):
    (place / "file").touch()
    assert re.match(expected, refusal(capsys, *arguments.split()))
    assert [path.name for path in place.iterdir()] == ["file"]


@pytest.mark.usefixtures("no_compilation")
def test_bad_settings_are_refused_in_one_line(capsys, place):
    (place / "c.toml").write_text("[horizon]\nsteps = 1\n")
    text = refusal(capsys, "simulate", "adaptive", "--config", "c.toml")
    assert text.startswith("c.toml: horizon.steps = 1: must be a whole number >= 2")


@pytest.fixture
def no_viewers(monkeypatch):
    """An installation without the view extra."""
    find_spec = importlib.util.find_spec

    def find(name, *rest):
        return None if name in ("rerun", "matplotlib") else find_spec(name, *rest)

    monkeypatch.setattr(importlib.util, "find_spec", find)


@pytest.mark.usefixtures("no_compilation", "no_viewers")
def test_recording_needs_the_view_extra(capsys):
    for command, hint in (("simulate adaptive", ", or pass --no-record"), ("falsify standard --out x --record 1", "")):
        text = refusal(capsys, *command.split())
        assert text.startswith('recording needs the view extra: pip install ".[view]" in ')
        assert text.endswith(f"repository{hint}")


def made_up_outcome(**changes):
    values = dict.fromkeys(Outcome.__dataclass_fields__, np.float32(0.1))
    counts = {"ticks": 20, "nonfinite": 0, "converged": 19}
    flags = dict.fromkeys(("reached", "collided", "run_over", "fell"), np.bool_(False))
    nothing = {"reach_time_s": np.float32(np.nan), "min_team_clearance_m": np.float32(CLEAR)}
    psi = np.array([8.0, 1.0, 0.8, -0.4, 30.0, 3.0], np.float32)
    return Outcome(**(values | counts | flags | nothing | {"estimates": psi} | changes))


@pytest.mark.usefixtures("no_viewers")
def test_an_interrupted_run_keeps_the_finished_scenarios(capsys, place, monkeypatch):
    runs = []

    def compiled(*_, **options):
        assert options == {"backend": None, "record": False}
        if runs:
            raise KeyboardInterrupt
        runs.append(1)
        return lambda seed: closed_loop.Result(made_up_outcome(), None)

    monkeypatch.setattr(closed_loop, "compiled", compiled)
    assert cli.main(["simulate", "adaptive", "people", "--no-record"]) == cli.INTERRUPTED
    records = json.loads((place / "out" / "outcome.json").read_text())
    assert [record["name"] for record in records] == ["adaptive"]
    assert "interrupted" in capsys.readouterr().err


def test_one_short_run_leaves_everything(capsys, place):
    (place / "small.toml").write_text(SCENARIO)
    (place / "mine.toml").write_text('preset = "robust"\n[reference]\nspeed = 0.4\n')
    command = "simulate small.toml --config mine.toml --without clf --without path --seed 3 --out a/b"
    assert cli.main(command.split()) == 0
    out, err = capsys.readouterr()
    assert re.fullmatch(
        r"\[1/1\] small: compiling\.\.\. [\d.]+ s, running\.\.\. [\d.]+ s: not reached \(.* off\)\n", err
    )
    assert out.splitlines()[2].split()[:3] == ["small", "no", "-"]

    folder = place / "a" / "b"
    assert {path.name for path in folder.iterdir()} == {
        "config.toml", "outcome.json", "small.png", "small.rrd",
    }  # fmt: skip
    assert (folder / "small.rrd").read_bytes()[:3] == b"RRF"
    assert (folder / "small.png").read_bytes()[:4] == b"\x89PNG"
    assert load_config(folder / "config.toml") == without(load_config("mine.toml"), ["clf", "path"])

    (record,) = json.loads((folder / "outcome.json").read_text())
    given = {"name": "small", "world": "planar", "config": "mine.toml", "without": ["clf", "path"], "seed": 3}
    assert {key: record[key] for key in given} == given
    assert (record["reached"], record["reach_time_s"], record["collided"]) == (False, None, False)
    assert record["solver"]["ticks"] == 20
    assert record["solver"]["nonfinite"] == 0
    assert 0.5 <= record["solver"]["converged_fraction"] <= 1.0
    assert 0.0 < record["max_force_n"] < 50.0
    assert 1.0 < record["final_position_error_m"] <= 1.42
    assert record["estimates"].keys() == {
        "mass_kg", "inertia_kgm2", "com_m", "friction_force_n", "friction_moment_nm",
    }  # fmt: skip
    assert record["compile_s"] > 0.0 and record["run_s"] > 0.0


def test_list_names_every_scenario_and_study(capsys):
    assert cli.main(["list"]) == 0
    lines = capsys.readouterr().out.splitlines()
    groups = [[*library.names()], [*study.names()]]
    assert [line.split()[0] for line in lines] == ["scenarios", *groups[0], "studies", *groups[1]]


def test_help_names_every_world_feature_and_preset(capsys):
    with pytest.raises(SystemExit) as caught:
        cli.main(["simulate", "--help"])
    assert caught.value.code == 0
    text = capsys.readouterr().out
    assert all(name in text for name in [*closed_loop.WORLDS, *FEATURES, "robust", "paper"])


def test_help_and_most_refusals_do_not_wait_for_jax():
    code = (
        "import sys; from jaxlocomanip import cli; cli.main(['list']); cli.main(['simulate', 'adaptve']); "
        "cli.main(['sweep', 'standrd', '--out', 'x']); cli.main(['report', 'x', '--worst', '0']); "
        "sys.exit('jax' in sys.modules)"
    )
    assert subprocess.run([sys.executable, "-c", code], capture_output=True, check=False).returncode == 0


def test_the_environment_of_the_user_stays(place, monkeypatch):
    cache = {"XDG_CACHE_HOME": str(place)}
    monkeypatch.setattr(os, "environ", dict(cache))
    cli._set_environment()
    assert os.environ == cache | {
        "PJRT_NPROC": "16",
        "XLA_FLAGS": f"--xla_force_host_platform_device_count={os.cpu_count()}",
        "JAX_COMPILATION_CACHE_DIR": str(place / "jaxlocomanip" / "xla"),
        "JAX_PERSISTENT_CACHE_MIN_COMPILE_TIME_SECS": "0",
    }
    own = {
        "PJRT_NPROC": "4",
        "XLA_FLAGS": "--xla_cpu_enable_fast_math=false",
        "JAX_COMPILATION_CACHE_DIR": "",
        "JAX_PERSISTENT_CACHE_MIN_COMPILE_TIME_SECS": "9",
    }
    monkeypatch.setattr(os, "environ", dict(own))
    cli._set_environment()
    assert os.environ == own


def test_experiments_run_every_part_into_its_own_directory(monkeypatch):
    calls = []
    monkeypatch.setattr(cli, "main", lambda arguments: calls.append(arguments) or len(calls) - 1)
    monkeypatch.setattr(sys, "argv", ["script", "--out", "there"])
    runs = {"a": ["adaptive"], "b": ["adaptive", "--without", "clf"], "c": ["people"]}
    assert cli.experiment("what it shows", "out", runs) == 1
    planar = ["--world", "planar", "--out"]
    assert calls == [
        ["simulate", "adaptive", *planar, os.path.join("there", "a")],
        ["simulate", "adaptive", "--without", "clf", *planar, os.path.join("there", "b")],
    ]


def test_presets_are_written_as_they_are(place, monkeypatch):
    monkeypatch.setattr(
        closed_loop, "compiled", lambda *_, **__: lambda seed: closed_loop.Result(made_up_outcome(), None)
    )
    monkeypatch.setattr(simulate, "_show", lambda *_: None)
    assert cli.main(["simulate", "adaptive", "--config", "paper"]) == 0
    assert load_config(place / "out" / "config.toml") == preset("paper")
