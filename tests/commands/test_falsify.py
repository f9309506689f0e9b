"""`falsify` leaves scenarios and a summary, also where it is stopped."""

import dataclasses
import json
import os

import pytest

from jaxlocomanip import cli, falsification
from jaxlocomanip.falsification import Search
from jaxlocomanip.specification import load_scenario
from jaxlocomanip.trials import Trials


def test_the_command_leaves_scenarios(breaking, no_episodes, tmp_path, monkeypatch, capsys):
    file = tmp_path / "breaking.toml"
    file.write_text(breaking)
    monkeypatch.setattr(os, "environ", os.environ.copy())
    out = tmp_path / "out"
    sizes = ["--screened", "5", "--aimed", "3", "--lanes", "2", "--rounds", "1"]
    assert cli.main(["falsify", str(file), "--out", str(out), *sizes]) == 0
    summary = json.loads((out / "worst.json").read_text())
    assert [row["file"] for row in summary["worst"]] == ["worst-00.toml", "worst-01.toml"]
    for row in summary["worst"]:
        spec = load_scenario(out / row["file"])
        assert spec.name == row["scenario"]
        place = dataclasses.make_dataclass("Place", ["spec"])(spec)
        assert no_episodes.clearance(place) == pytest.approx(row["clearance"])
    assert "of the 2 scenarios kept collided with an obstacle, in " in capsys.readouterr().out
    (out / "worst-07.toml").write_text("of a longer search before")
    (out / "worst.rrd").write_text("of a search before")
    for own in ("worst-own.toml", "worst-00-robust.toml"):
        (out / own).write_text("of the user")

    assert cli.main(["falsify", str(file), "--out", str(out), "--random", *sizes]) == 0
    text = capsys.readouterr().out.splitlines()[-2]
    summary = json.loads((out / "worst.json").read_text())
    counts = f"{summary['collisions']} of 22 episodes collided with an obstacle"
    assert text == f"{counts}, in {summary['touches']} robots touched each other"
    left = {path.name for path in out.iterdir()}
    assert left == {"worst-00.toml", "worst-01.toml", "worst.json", "worst-own.toml", "worst-00-robust.toml"}
    assert (summary["counted"], summary["episodes"], len(summary["worst"])) == (22, 22, 2)


def test_a_stopped_search_leaves_what_it_found(breaking, no_episodes, tmp_path, monkeypatch, capsys):
    def stopped(self, places):
        raise KeyboardInterrupt

    monkeypatch.setattr(Trials, "gradients", stopped)
    monkeypatch.setattr(Search, "drawn", 1)  # quicker
    monkeypatch.setattr(os, "environ", os.environ.copy())
    (tmp_path / "breaking.toml").write_text(breaking)
    sizes = ["--screened", "3", "--aimed", "2", "--lanes", "2"]
    command = ["falsify", str(tmp_path / "breaking.toml"), "--out", str(tmp_path / "out"), *sizes]
    assert cli.main(command) == cli.INTERRUPTED
    assert "whatever was finished is kept" in capsys.readouterr().err
    assert json.loads((tmp_path / "out" / "worst.json").read_text())["episodes"] == 11
    assert load_scenario(tmp_path / "out" / "worst-01.toml")


def test_the_command_draws_more_than_it_begins_with(breaking, tmp_path, monkeypatch):
    searches = []

    def noted(study, config, seed, search, **_):
        searches.append(search)
        raise KeyboardInterrupt

    monkeypatch.setattr(falsification, "falsify", noted)
    monkeypatch.setattr(os, "environ", os.environ.copy())
    (tmp_path / "breaking.toml").write_text(breaking)
    for count in ("16", "200"):
        command = ["falsify", str(tmp_path / "breaking.toml"), "--out", str(tmp_path), "--screened", count]
        assert cli.main(command) == cli.INTERRUPTED
    assert [(search.drawn, search.screened) for search in searches] == [(160, 16), (2000, 200)]
