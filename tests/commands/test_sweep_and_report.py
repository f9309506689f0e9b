"""`sweep` and `report` on the command line, from a study to recordings."""

import os

import pytest

from jaxlocomanip import cli
from jaxlocomanip.commands import sweep
from jaxlocomanip.sweep.store import read_manifest


@pytest.fixture(autouse=True)
def place(tmp_path, monkeypatch, tiny_study, quick_config):
    """A working directory with a study and settings, and an environment that is put back."""
    monkeypatch.chdir(tmp_path)
    monkeypatch.setattr(os, "environ", os.environ.copy())
    (tmp_path / "tiny.toml").write_text(tiny_study)
    (tmp_path / "quick.toml").write_text(quick_config)
    return tmp_path


def test_from_a_study_to_recordings(capsys, place):
    command = "sweep tiny.toml --count 6 --seed 2 --config quick.toml --without path --out out/a"
    assert cli.main(command.split()) == 0
    out, err = capsys.readouterr()
    assert out.splitlines()[2].split()[:2] == ["all", "6"]
    assert out.splitlines()[3].startswith("6 scenarios out of ")
    assert err.startswith("tiny: 6 scenarios in chunks of 4\n")
    manifest = read_manifest("out/a")
    assert manifest["command"] == command.split()
    assert manifest["settings"]["seed"] == 2 and "plan_path = 0.0" in manifest["settings"]["variants"][0]["config"]

    assert cli.main("report out/a --worst 2 --record worst:1".split()) == 0
    out, err = capsys.readouterr()
    replays = [line for line in out.splitlines() if "jaxlocomanip report out/a --record " in line]
    assert len(replays) == 2
    assert {path.name for path in (place / "out" / "a").iterdir()} == {
        ".lock", "clearance.png", "failures.png", "manifest.json", "results.parquet", "success.png", "worst_1.rrd",
    }  # fmt: skip
    assert (place / "out" / "a" / "worst_1.rrd").read_bytes()[:3] == b"RRF"
    assert "ended otherwise" not in err

    assert cli.main("sweep tiny.toml --count 6 --seed 3 --config quick.toml --out out/a".split()) == 2
    assert "seed = 2 there and 3 here" in capsys.readouterr().err


def test_a_report_of_no_sweep_and_of_no_such_lane_is_refused(capsys, place):
    assert cli.main(["report", "nowhere"]) == 2
    assert "nowhere/manifest.json: cannot be read" in capsys.readouterr().err


@pytest.mark.parametrize(("missing", "command", "expected"), [
    ("pyarrow", "sweep tiny.toml --out x", 'sweeps need the sweep extra: pip install "\\.\\[sweep\\]" in .*y\n'),
    ("pyarrow", "report x", "sweeps need the sweep extra"),
    ("rerun", "report x --record worst:1", 'recording needs the view extra: pip install "\\.\\[view\\]" in .*y\n'),
    ("ray", "sweep tiny.toml --out x --workers ray", 'needs the ray extra: pip install "\\.\\[ray\\]"'),
])  # fmt: skip
def test_missing_extras_are_named(capsys, monkeypatch, missing, command, expected):
    import importlib.util
    import re

    find_spec = importlib.util.find_spec
    monkeypatch.setattr(importlib.util, "find_spec", lambda name, *r: None if name == missing else find_spec(name, *r))
    assert cli.main(command.split()) == 2
    assert re.search(expected, capsys.readouterr().err)


@pytest.mark.parametrize(("text", "count"), [(None, None), ("ray", 0), ("ray:3", 3)])
def test_workers_are_counted(monkeypatch, text, count):
    import importlib.util

    monkeypatch.setattr(importlib.util, "find_spec", lambda *_: object())
    assert sweep._workers(text) == count
