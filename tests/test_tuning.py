"""Tuning on a made-up loss: both methods find its minimum, checkpoints, held-out choice; and once in earnest."""

import dataclasses
import json
import math
import os
import re
import tomllib

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from jaxlocomanip import cli, tuning
from jaxlocomanip.checked import InputError
from jaxlocomanip.config_file import config_from_table, config_to_toml, load_config
from jaxlocomanip.gradients import SoftOutcome
from jaxlocomanip.objective import WORST, Losses, Objective, loss, trimmed_mean
from jaxlocomanip.padding import stack
from jaxlocomanip.planner.config import Horizon, PlannerConfig
from jaxlocomanip.tuning import Settings, tune

NAMES = ("weights.force", "weights.offset")
TARGET = np.array([-0.7, 0.4])
"""in the order of the configuration: offset, force"""


class Bowl:
    """Losses with their least value where the logarithms are at TARGET, noisy by the scenario's index."""

    count = 2

    def __init__(self, *given):
        del given

    def each(self, center, scenarios):
        return np.sum((center - TARGET) ** 2) + 0.1 * np.sin(7.0 * np.asarray(scenarios.index))

    def of(self, settings, scenarios):
        return np.stack([self.each(one, scenarios).mean() for one in settings])

    def mean(self, scenarios, center=None):
        return float(self.each(np.zeros(2) if center is None else center, scenarios).mean())

    def slopes(self, center, scenarios):
        return self.mean(scenarios, center), 2.0 * (center - TARGET), 0


@pytest.fixture
def bowl(monkeypatch):
    monkeypatch.setattr(tuning, "Losses", Bowl)


@pytest.fixture(scope="module")
def sets(make_scenario):
    """Training and held-out scenarios."""
    lanes = [make_scenario(index) for index in range(8)]
    return stack(lanes[:5]), stack(lanes[5:])


GRADIENT = Settings(NAMES, steps=40, batch=2, rate=0.1)
ENTROPY = Settings(NAMES, method="cem", steps=30, batch=2)


@pytest.mark.parametrize("plan", [GRADIENT, ENTROPY], ids=lambda plan: plan.method)
def test_the_minimum_is_found(bowl, sets, plan):
    start = PlannerConfig()
    tuned = tune(start, *sets, 10, plan)
    assert tuned.config.weights.force == pytest.approx(start.weights.force * math.exp(0.4), rel=0.05)
    assert tuned.config.weights.offset == pytest.approx(start.weights.offset * math.exp(-0.7), rel=0.05)
    assert tuned.config.weights.twist == start.weights.twist
    assert tuned.loss == pytest.approx(min(row["held_out"] for row in tuned.history if "held_out" in row))
    assert tuned.history[-1]["episodes"] == plan.steps * plan.episodes + (1 + plan.steps // plan.validate) * 3
    # What comes out is a file for --config.
    assert config_from_table(tomllib.loads(config_to_toml(tuned.config))) == tuned.config


@pytest.mark.parametrize("plan", [GRADIENT, ENTROPY], ids=lambda plan: plan.method)
def test_a_stopped_run_goes_on_as_if_it_had_not_been(bowl, sets, plan, tmp_path):
    file = tmp_path / "tune.json"
    whole = tune(PlannerConfig(), *sets, 10, dataclasses.replace(plan, steps=10))
    tune(PlannerConfig(), *sets, 10, dataclasses.replace(plan, steps=5), checkpoint=file)
    assert [path.name for path in tmp_path.iterdir()] == ["tune.json"]
    again = tune(PlannerConfig(), *sets, 10, dataclasses.replace(plan, steps=10), checkpoint=file)
    assert again == whole


def test_stopping_between_two_looks_changes_nothing(bowl, sets, tmp_path):
    """What is returned then has been looked at once more, but the run that goes on does not know of it."""
    file, plan = tmp_path / "tune.json", GRADIENT
    whole = tune(PlannerConfig(), *sets, 10, dataclasses.replace(plan, steps=10))
    part = tune(PlannerConfig(), *sets, 10, dataclasses.replace(plan, steps=7), checkpoint=file)
    assert "held_out" in part.history[-1]
    assert tune(PlannerConfig(), *sets, 10, dataclasses.replace(plan, steps=10), checkpoint=file) == whole


def test_checkpoints_of_other_runs_are_refused(bowl, sets, tmp_path):
    file, plan = tmp_path / "tune.json", Settings(NAMES, steps=2, batch=2)
    tune(PlannerConfig(), *sets, 10, plan, checkpoint=file)
    for change, text in (
        ({"settings": dataclasses.replace(plan, rate=0.3)}, "other settings"),
        ({"ticks": 11}, "another ticks"),
        ({"objective": Objective(time=2.0)}, "another objective"),
        ({"train": sets[1]}, "another training scenarios"),
        ({"held_out": sets[0]}, "another held-out scenarios"),
        ({"settings": dataclasses.replace(plan, steps=1)}, "has 2 steps already, more than 1"),
    ):
        given = {"train": sets[0], "held_out": sets[1], "ticks": 10, "settings": plan} | change
        with pytest.raises(InputError, match=text):
            tune(PlannerConfig(), checkpoint=file, **given)
    file.write_text(json.dumps({"about": 3}))
    with pytest.raises(InputError, match="cannot be read as a checkpoint"):
        tune(PlannerConfig(), *sets, 10, plan, checkpoint=file)


def test_settings_that_only_fit_the_training_scenarios_are_not_kept(bowl, sets, monkeypatch):
    def other_way(self, center, scenarios):
        return self.mean(scenarios, center), -2.0 * (center - TARGET), 0

    monkeypatch.setattr(Bowl, "slopes", other_way)
    tuned = tune(PlannerConfig(), *sets, 10, Settings(NAMES, steps=10, batch=2))
    assert tuned.config.weights.force == pytest.approx(PlannerConfig().weights.force)
    assert tuned.loss == tuned.history[0]["held_out"]


def test_a_stopped_command_leaves_the_best_so_far(bowl, tiny_study, tmp_path, monkeypatch):
    slopes, calls = Bowl.slopes, []

    def stopped(self, center, scenarios):
        calls.append(center)
        if len(calls) == 7:
            raise KeyboardInterrupt
        return slopes(self, center, scenarios)

    monkeypatch.setattr(Bowl, "slopes", stopped)
    monkeypatch.setattr(os, "environ", os.environ.copy())
    (tmp_path / "tiny.toml").write_text(tiny_study)
    sizes = ["--train", "3", "--held-out", "2", "--batch", "2", "--tune", NAMES[0], "--tune", NAMES[1]]
    command = ["tune", str(tmp_path / "tiny.toml"), "--out", str(tmp_path / "out"), *sizes]
    assert cli.main(command) == cli.INTERRUPTED
    assert load_config(tmp_path / "out" / "tuned.toml").weights.force > PlannerConfig().weights.force


def test_the_command_leaves_a_file_for_config(bowl, tiny_study, tmp_path, monkeypatch, capsys):
    study, out = tmp_path / "tiny.toml", tmp_path / "out"
    study.write_text(tiny_study)
    monkeypatch.setattr(os, "environ", os.environ.copy())
    sizes = ["--train", "3", "--held-out", "2", "--batch", "2", "--steps", "6"]
    command = ["tune", str(study), "--out", str(out), *sizes, "--tune", NAMES[0], "--tune", NAMES[1]]
    assert cli.main(command) == 0
    assert load_config(out / "tuned.toml").weights.force > PlannerConfig().weights.force
    assert "weights.force: 0.004 -> " in capsys.readouterr().out
    # Once more: nothing is left to do.
    assert cli.main(command) == 0
    assert "step" not in capsys.readouterr().err


def test_held_out_scenarios_share_no_draw_with_training(bowl, tiny_study, tmp_path, monkeypatch):
    """All points of a study have the same draws, so the next lane may differ from the last in one number only."""
    study, seen = tmp_path / "tiny.toml", []
    study.write_text(tiny_study + '\n[[axes]]\nparameter = "truth.friction"\nvalues = [0.2, 0.3, 0.4]\n')
    monkeypatch.setattr(os, "environ", os.environ.copy())
    monkeypatch.setattr(tuning, "tune", lambda config, *sets, **_: seen.extend(sets) or pytest.fail("seen"))
    sizes = ["--train", "4", "--held-out", "2", "--batch", "2"]
    with pytest.raises(pytest.fail.Exception):
        cli.main(["tune", str(study), "--out", str(tmp_path / "out"), *sizes])
    assert seen[0].index.tolist() == [0, 1, 2, 3] and seen[1].index.tolist() == [6, 7]


@pytest.mark.parametrize("command", ["tune", "falsify"])
@pytest.mark.parametrize(
    ("line", "text"),
    [
        ('world = "quadruped"\n', "world = 'quadruped': must be planar for this command"),
        ('[[variants]]\nname = "a"\n', "has variants, which this command does not try"),
    ],
)
def test_what_a_study_asks_for_is_not_passed_over(tiny_study, tmp_path, monkeypatch, capsys, command, line, text):
    study = tmp_path / "tiny.toml"
    study.write_text(line + tiny_study if "world" in line else tiny_study + line)
    monkeypatch.setattr(os, "environ", os.environ.copy())
    assert cli.main([command, str(study), "--out", str(tmp_path / "out")]) == 2
    assert text in capsys.readouterr().err


@pytest.mark.parametrize(
    ("arguments", "text"),
    [
        (["--method", "newton"], "method = 'newton': must be one of gradient, cem"),
        (["--rate", "0"], "argument --rate: '0' must be a number > 0 and <= 1"),
        (["--rate", "fast"], "argument --rate: 'fast' must be a number > 0 and <= 1"),
        (["--tune", "weight"], "tune = 'weight': no setting has this name; did you mean 'weights'?"),
        (["--batch", "9", "--train", "8"], "batch = 9: must be >= 1 and <= the 8 training scenarios"),
    ],
)
def test_the_command_refuses(tiny_study, tmp_path, monkeypatch, capsys, arguments, text):
    study = tmp_path / "tiny.toml"
    study.write_text(tiny_study)
    monkeypatch.setattr(os, "environ", os.environ.copy())
    monkeypatch.setattr(tuning, "Losses", lambda *_: pytest.fail("compiled before refusing"))
    assert cli.main(["tune", str(study), "--out", str(tmp_path / "out"), *arguments]) == 2
    assert text in capsys.readouterr().err


def test_bad_settings_are_refused(sets):
    with pytest.raises(InputError, match="batch = 6: must be >= 1 and <= the 5 training scenarios"):
        tune(PlannerConfig(), *sets, 10, Settings(NAMES, batch=6))
    with pytest.raises(InputError, match="method = 'sgd'"):
        tune(PlannerConfig(), *sets, 10, Settings(NAMES, method="sgd"))
    for change, text in (
        ({"validate": 0}, "validate = 0: must be a whole number >= 1"),
        ({"elite": 17}, "elite = 17: must be a whole number >= 1 and <= 16"),
        ({"steps": 2.5}, "steps = 2.5: must be a whole number"),
        ({"rate": 0.0}, "rate = 0.0: must be > 0"),
        ({"memory": math.inf}, "memory = inf: must be finite"),
        ({"seed": -1}, "seed = -1: must be a whole number >= 0"),
    ):
        with pytest.raises(InputError, match=re.escape(text)):
            tune(PlannerConfig(), *sets, 10, Settings(NAMES, **change))
    with pytest.raises(InputError, match="held_out: must have at least one scenario"):
        tune(PlannerConfig(), sets[0], jax.tree.map(lambda leaf: leaf[:0], sets[1]), 10, Settings(NAMES, batch=2))


def outcome(**changes):
    values = {
        "path_error_m2": 0.01,
        "effort_n2s": 1e3,
        "clearance_m": 0.3,
        "team_clearance_m": 0.2,
        "time_s": 1.5,
        "off_goal": 4.0,
        "goal_error_m2": 0.01,
        "heading_error_rad2": 0.01,
        "alive": True,
    }
    return SoftOutcome(**jax.tree.map(jnp.asarray, values | changes))


def test_the_loss_knows_what_is_better(make_scenario):
    scenario = make_scenario()

    def of(**changes):
        return float(loss(outcome(**changes), scenario, Objective()))

    assert of() < of(goal_error_m2=0.1) < of(goal_error_m2=1.0)
    assert of() < of(heading_error_rad2=0.5)
    assert of() < of(time_s=3.0)
    assert of() < of(off_goal=5.0)
    assert of() < of(effort_n2s=1e4)
    # Ten centimetres of missing clearance outweigh arriving.
    assert of(clearance_m=-0.1) > of(goal_error_m2=0.2)
    assert of(team_clearance_m=-0.1) == pytest.approx(of(clearance_m=-0.1), rel=0.01)
    assert of(clearance_m=1.0) == pytest.approx(of(clearance_m=2.0), rel=1e-4)
    # Nothing that an episode did before its numbers were lost makes up for that.
    assert of(alive=False) == WORST > of(clearance_m=-1.0, goal_error_m2=100.0)


def test_single_lanes_do_not_decide():
    rows = np.array([[1.0, -1.0], [2.0, -1e30], [3.0, -2.0], [1e30, -3.0]])
    assert trimmed_mean(rows) == pytest.approx([2.5, -2.5])
    assert trimmed_mean(rows[:2]) == pytest.approx(rows[:2].mean(axis=0))
    assert trimmed_mean(rows[:0]) == pytest.approx([0.0, 0.0])


@pytest.mark.slow
@pytest.mark.timeout(1800)
def test_gradients_of_settings_in_earnest(make_scenario):
    """The mean loss falls against the gradient."""
    box = [{"shape": "box", "size": [0.5, 0.5], "position": [1.0, 0.1]}]
    config = PlannerConfig(horizon=Horizon(steps=5))
    scenarios = stack([make_scenario(index, obstacles=box, duration=1.0) for index in range(2)])
    knobs = tuning.knobs_of(config, NAMES)
    losses = Losses(jax.tree.map(jnp.asarray, config), knobs, Objective(), 50, 2, math.inf)
    value, slope, lost = losses.slopes(np.zeros(2), scenarios)
    assert value == pytest.approx(losses.mean(scenarios), rel=1e-4)
    assert 0.0 < np.linalg.norm(slope) and value < WORST and lost == 0
    way = 0.1 * slope / np.linalg.norm(slope)
    assert losses.mean(scenarios, -way) < losses.mean(scenarios, way)
