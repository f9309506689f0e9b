"""The scripts and declarations in `sweeps/`."""

import runpy
import sys
from pathlib import Path

import pytest

from jaxlocomanip import cli
from jaxlocomanip.sampling.sampler import draw
from jaxlocomanip.sampling.study import find_study, names

FOLDER = Path(__file__).parents[1] / "sweeps"
SCRIPTS = sorted(FOLDER.glob("*.py"))


def test_every_study_has_a_script():
    assert sorted(path.stem.partition("_")[2] for path in SCRIPTS) == list(names())


@pytest.mark.parametrize("path", SCRIPTS, ids=lambda path: path.stem)
def test_scripts_sweep_and_report(path, monkeypatch):
    calls = []
    monkeypatch.setattr(cli, "main", lambda arguments: calls.append(arguments) or 0)
    monkeypatch.setattr(sys, "argv", ["script", "--out", "there", "--count", "8"])
    with pytest.raises(SystemExit) as caught:
        runpy.run_path(str(path), run_name="__main__")
    name = path.stem.partition("_")[2]
    assert caught.value.code == 0
    assert calls == [["sweep", name, "--out", "there", "--count", "8"], ["report", "there"]]


def test_a_failed_sweep_is_not_reported(monkeypatch):
    calls = []
    monkeypatch.setattr(cli, "main", lambda arguments: calls.append(arguments) or 2)
    monkeypatch.setattr(sys, "argv", ["script"])
    assert cli.study("what it shows", "standard", "out/x") == 2
    assert calls == [["sweep", "standard", "--out", "out/x"]]


@pytest.mark.parametrize("path", sorted(FOLDER.glob("*.toml")), ids=lambda path: path.stem)
def test_declarations_are_correct_and_feasible(path):
    study = find_study(str(path))
    assert study.name == path.stem
    for lane in range(6):
        draw(study, 0, lane)
