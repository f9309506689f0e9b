"""The notebooks run from beginning to end, on smaller numbers than they state; their assertions are the tests."""

import re
from pathlib import Path

import pytest

FOLDER = Path(__file__).parents[1] / "notebooks"
QUICK = {
    "01_plan_one_scenario": {"SECONDS": 0.4, "STAGES": 5},
    "02_a_thousand_scenarios": {"COUNT": 6, "CHUNK": 4, "SECONDS": 0.4, "STAGES": 5},
    "03_gradients_through_a_plan": {"STAGES": 8},
    "04_tuning": {"STAGES": 5, "SECONDS": 0.4, "TRAIN, HELD_OUT, BATCH": (2, 2, 2), "STEPS": 2},
    "05_breaking_the_planner": {"STAGES": 5, "SECONDS": 0.4, "SCREENED, AIMED, LANES, ROUNDS": (4, 2, 2, 1)},
    "06_quadrupeds": {"SECONDS": 0.4, "STAGES": 5},
}
"""What replaces the cell of parameters."""
SLOW = {"04_tuning", "05_breaking_the_planner"}
"""Reverse differentiation of the whole loop compiles for minutes."""
CELL = re.compile(r'^# %% tags=\["parameters"\]\n(.*?)(?=^# %%)', re.MULTILINE | re.DOTALL)


def source(name):
    return (FOLDER / f"{name}.py").read_text(encoding="utf-8")


def test_every_notebook_is_here():
    assert sorted(path.stem for path in FOLDER.iterdir()) == sorted(QUICK)


@pytest.mark.parametrize("name", QUICK)
def test_they_are_notebooks_with_one_cell_of_parameters(name):
    text = source(name)
    assert "format_name: percent" in text.split("# ---")[1]
    assert text.split("# ---\n")[2].startswith("\n# %% [markdown]\n# # ")
    (cell,) = CELL.findall(text)
    assert re.findall(r"^(.+?) = ", cell, re.MULTILINE) == list(QUICK[name])


@pytest.mark.timeout(1800)
@pytest.mark.parametrize(
    "name", [pytest.param(name, marks=[pytest.mark.slow] if name in SLOW else []) for name in QUICK]
)
def test_they_run(name, monkeypatch, tmp_path):
    matplotlib = pytest.importorskip("matplotlib")
    matplotlib.use("Agg")
    from matplotlib import pyplot

    # Nobody looks; a picture that stays open would be kept.
    monkeypatch.setattr(pyplot, "show", lambda: pyplot.close("all"))
    monkeypatch.setattr("tempfile.tempdir", str(tmp_path))
    values = "".join(f"{names} = {value!r}\n" for names, value in QUICK[name].items())
    text = CELL.sub(lambda _: values, source(name))
    exec(compile(text, f"{name}.py", "exec"), {"__name__": "__main__"})
    pyplot.close("all")
