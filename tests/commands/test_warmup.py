"""`warmup` compiles what `simulate` and `sweep` will run, and runs nothing."""

import os

import pytest

from jaxlocomanip import batch, cli, closed_loop


@pytest.fixture(autouse=True)
def compiled(tmp_path, monkeypatch, tiny_study, quick_config):
    """What would have been compiled, in a working directory with a study and settings."""
    monkeypatch.chdir(tmp_path)
    monkeypatch.setattr(os, "environ", os.environ.copy())
    (tmp_path / "tiny.toml").write_text(tiny_study)
    (tmp_path / "quick.toml").write_text(quick_config)
    asked = []

    def alone(scenario, config, world, *, backend, record):
        asked.append(("alone", config.horizon.steps, world, backend, record))

    def chunk(self, scenarios, config, shape):
        asked.append(("chunk", config.horizon.steps, len(scenarios), shape.lanes))

    monkeypatch.setattr(closed_loop, "compiled", alone)
    monkeypatch.setattr(batch.Runner, "prepare", chunk)
    return asked


def test_scenarios_and_studies_are_compiled_and_listed(capsys, compiled):
    command = "warmup adaptive --study tiny.toml --config quick.toml --chunk 3"
    assert cli.main(command.split()) == 0
    assert compiled == [("alone", 5, "planar", None, True), ("chunk", 5, 1, 3)]
    head, first, second, kept = capsys.readouterr().out.splitlines()
    assert head.split() == ["program", "compiled", "in"]
    assert first.startswith("simulate adaptive") and second.startswith("sweep tiny, 2 robots, 3 lanes")
    assert first.endswith(" s") and kept.startswith("kept in ")


def test_by_default_it_is_what_a_beginner_runs_first(capsys, compiled):
    assert cli.main(["warmup"]) == 0
    kinds = [kind for kind, *_ in compiled]
    assert kinds[0] == "alone" and set(kinds[1:]) == {"chunk"}
    assert "sweep standard" in capsys.readouterr().out


@pytest.mark.parametrize("arguments", ["nosuch", "--study nosuch", "adaptive --world moon", "--chunk 0"])
def test_bad_input_is_refused_before_anything_is_compiled(capsys, compiled, arguments):
    assert cli.main(["warmup", *arguments.split()]) == 2
    assert capsys.readouterr().err.startswith("error: ") and not compiled
