"""The search on a made-up clearance, whose least value is known; and once in earnest."""

import dataclasses
import json
import math
import os
import re

import jax
import numpy as np
import pytest

from jaxlocomanip import cli, falsification, random_worst, trials
from jaxlocomanip.aiming import Motion, straight_motion
from jaxlocomanip.build import build, start_gaps
from jaxlocomanip.checked import InputError
from jaxlocomanip.closed_loop import simulate
from jaxlocomanip.falsification import Search, falsify
from jaxlocomanip.planner.config import Horizon, PlannerConfig
from jaxlocomanip.random_worst import sample_worst
from jaxlocomanip.sampling.feasibility import judged
from jaxlocomanip.sampling.study import parse_study
from jaxlocomanip.specification import load_scenario
from jaxlocomanip.trials import Found, Trials
from jaxlocomanip.variation import Bounds, vary

STUDY = """
name = "breaking"
extends = "standard"
duration = 1.0
[goal]
distance = { uniform = [1.0, 2.0] }
heading = 0.0
[obstacles]
count = 2
along = { uniform = [0.3, 0.8] }
half_size = 0.2
"""
SMALL = Search(drawn=6, screened=6, aimed=(2, 2), lanes=3, rounds=3, steps=(0.1, 0.4))
CLOSE = 0.1
"""m, made-up clearance below which robots touch each other"""


@pytest.fixture(scope="module")
def study():
    return parse_study(STUDY)


def made_up(place):
    """Least for the heaviest object on the roughest floor."""
    mass, friction = place.spec.truth.mass, place.spec.truth.friction
    return 0.5 - 0.05 * mass - 0.5 * friction


def stood(place):
    """Nothing moves."""
    obstacles = np.asarray(place.scenario.obstacles.position)
    return Motion(np.tile(place.scenario.start, (2, 1)), np.tile(obstacles, (2, 1, 1)))


@pytest.fixture
def no_episodes(monkeypatch):
    """Counts what would have been run."""
    counts = {"episodes": 0, "gradients": 0}

    def run(self, places):
        counts["episodes"] += len(places)
        pairs = [(place, made_up(place)) for place in places]
        return [(one, Found(one.spec, one.seed, c, c - CLOSE, False, True, stood(one))) for one, c in pairs]

    def gradients(self, places):
        counts["gradients"] += len(places)
        slopes = [np.zeros(len(place.coordinates)) for place in places]
        for slope in slopes:
            slope[:2] = -0.2, -0.1
        return slopes

    monkeypatch.setattr(Trials, "run", run)
    monkeypatch.setattr(Trials, "gradients", gradients)
    return counts


def test_steps_go_down_to_the_bounds(study, no_episodes):
    config = PlannerConfig()
    begun = sample_worst(study, config, SMALL.screened, keep=SMALL.screened)
    found = falsify(study, config, search=SMALL)
    assert found.worst[0].clearance < begun.worst[0].clearance
    assert [one.clearance for one in found.worst] == sorted(one.clearance for one in found.worst)
    assert len({one.spec.name for one in found.worst}) == SMALL.lanes
    assert found.collisions == sum(one.clearance < 0.0 for one in found.worst)
    assert found.counted == SMALL.lanes
    for one in found.worst:
        assert 3.0 <= one.spec.truth.mass <= 12.0 and 0.15 <= one.spec.truth.friction <= 0.6
        assert not isinstance(judged(one.spec, 0), str)
        assert start_gaps(one.spec).min() >= Bounds().start_room


def test_the_budget_is_what_it_costs(study, no_episodes):
    found = falsify(study, PlannerConfig(), search=SMALL)
    random, tried = SMALL.screened, sum(SMALL.aimed) + SMALL.rounds * SMALL.lanes * len(SMALL.steps)
    assert no_episodes["episodes"] == random + tried
    assert no_episodes["gradients"] == SMALL.rounds * SMALL.lanes
    assert (
        found.episodes == SMALL.episodes == math.ceil(random + tried + SMALL.gradient_cost * no_episodes["gradients"])
    )


def test_random_sampling_begins_with_the_same_scenarios(study, no_episodes):
    few = sample_worst(study, PlannerConfig(), 4, keep=4)
    more = sample_worst(study, PlannerConfig(), 8, keep=8)
    assert {one.spec for one in few.worst} < {one.spec for one in more.worst}
    other = sample_worst(study, PlannerConfig(), 4, seed=1, keep=4)
    assert not {one.spec for one in few.worst} & {one.spec for one in other.worst}


def test_collisions_are_counted_among_all_random_scenarios(study, no_episodes):
    every, few = (sample_worst(study, PlannerConfig(), 20, keep=n) for n in (20, 2))
    collided, touched = (sum(one.clearance < limit for one in every.worst) for limit in (0.0, CLOSE))
    assert 2 < collided < touched <= 20
    assert every.touches == few.touches == touched
    assert (every.collisions, every.counted) == (few.collisions, few.counted) == (collided, 20)
    assert few.worst == every.worst[:2]


def test_what_is_there_after_every_stage_is_kept(study, no_episodes):
    stages = []
    found = falsify(study, PlannerConfig(), search=SMALL, kept=stages.append)
    assert [one.episodes for one in stages] == [6, 8, 10, 21, 31, 42]
    assert all(len(one.worst) == SMALL.lanes for one in stages)
    least = [one.worst[0].clearance for one in stages]
    assert least == sorted(least, reverse=True)
    assert stages[-1] == found
    batches = []
    sample_worst(study, PlannerConfig(), 20, keep=3, kept=batches.append)
    assert [(one.episodes, len(one.worst)) for one in batches] == [(8, 3), (16, 3), (20, 3)]


def test_without_gradients_directions_are_random(study, no_episodes, monkeypatch):
    monkeypatch.setattr(Trials, "gradients", lambda self, places: [np.zeros(len(p.coordinates)) for p in places])
    begun = sample_worst(study, PlannerConfig(), SMALL.screened, keep=SMALL.lanes)
    found, again = (falsify(study, PlannerConfig(), search=SMALL) for _ in range(2))
    assert found == again
    assert found.worst[0].clearance < begun.worst[0].clearance
    assert all(a.clearance <= b.clearance for a, b in zip(found.worst, begun.worst, strict=True))


def test_bad_searches_are_refused(study):
    with pytest.raises(InputError, match=r"search.lanes = 9: must be >= 1 and <= search.screened = 8"):
        falsify(study, PlannerConfig(), search=Search(screened=8, lanes=9, aimed=()))


@pytest.mark.parametrize(
    ("change", "text"),
    [
        ({"rounds": -1}, "search.rounds = -1: must be a whole number >= 0"),
        ({"steps": ()}, "search.steps = (): must have at least one length"),
        ({"steps": (0.1, -0.1)}, "search.steps[1] = -0.1: must be > 0 and <= 2"),
        ({"window": 0}, "search.window = 0: must be a whole number >= 1"),
        ({"spread": float("nan")}, "search.spread = nan: must be finite"),
        ({"memory": 0.0}, "search.memory = 0.0: must be > 0"),
        ({"gradient_cost": -1.0}, "search.gradient_cost = -1.0: must be > 0"),
    ],
)
def test_bad_numbers_are_refused(study, change, text):
    with pytest.raises(InputError, match=re.escape(text)):
        falsify(study, PlannerConfig(), search=Search(**change))


@pytest.mark.parametrize(
    ("change", "text"),
    [
        ({"episodes": 0}, "episodes = 0: must be a whole number >= 1"),
        ({"keep": 0}, "keep = 0: must be a whole number >= 1"),
        ({"seed": -1}, "seed = -1: must be a whole number >= 0"),
        ({"bounds": Bounds(friction=(0.5, 0.2))}, "bounds.friction[1] = 0.2: must be >= 0.5"),
    ],
)
def test_bad_random_samples_are_refused(study, change, text):
    with pytest.raises(InputError, match=re.escape(text)):
        sample_worst(study, PlannerConfig(), **({"episodes": 8} | change))


def test_more_begun_than_drawn_are_refused(study):
    with pytest.raises(InputError, match=r"search.drawn = 4: must be >= search.screened = 16"):
        falsify(study, PlannerConfig(), search=Search(drawn=4))


def test_more_aims_than_scenarios_are_refused(study):
    with pytest.raises(InputError, match=r"search.aimed = 9: must be >= 1 and <= search.screened = 8"):
        falsify(study, PlannerConfig(), search=Search(screened=8, aimed=(9,)))


def test_aims_put_an_obstacle_in_the_way(study, no_episodes, monkeypatch):
    """Of a made-up clearance that is the distance of the first obstacle, where only aims are tried."""

    def clearance(place):
        return float(np.linalg.norm(np.array(place.spec.obstacles[0].position) - stood(place).pose[0, :2]))

    monkeypatch.setitem(globals(), "made_up", clearance)
    search = dataclasses.replace(SMALL, drawn=8, screened=8, aimed=(8,), rounds=0, lanes=8)
    begun = sample_worst(study, PlannerConfig(), 8, keep=8)
    found = falsify(study, PlannerConfig(), search=search)
    assert np.mean([one.clearance for one in found.worst]) < np.mean([one.clearance for one in begun.worst]) - 0.05


def test_scenarios_that_promise_most_are_begun_with(study, no_episodes, monkeypatch):
    """Of a made-up clearance that is the least distance of an obstacle to the straight way."""

    def clearance(place):
        way = straight_motion(place.scenario, 0.5)
        return float(np.linalg.norm(way.obstacles - way.pose[:, None, :2], axis=-1).min())

    monkeypatch.setitem(globals(), "made_up", clearance)
    search = dataclasses.replace(SMALL, aimed=(), rounds=0, lanes=6)
    same, many = (falsify(study, PlannerConfig(), search=dataclasses.replace(search, drawn=n)) for n in (6, 40))
    begun = sample_worst(study, PlannerConfig(), 6, keep=6)
    means = [np.mean([one.clearance for one in found.worst]) for found in (begun, same, many)]
    assert means[0] > max(means[1:]) + 0.05
    assert many.episodes == same.episodes == 6


def test_studies_without_scenarios_within_the_bounds_are_refused(study, monkeypatch):
    monkeypatch.setattr(random_worst, "place_at", lambda *_: None)
    with pytest.raises(InputError, match="breaking: hardly any of its scenarios"):
        sample_worst(study, PlannerConfig(), 1)


def test_the_command_leaves_scenarios(no_episodes, tmp_path, monkeypatch, capsys):
    file = tmp_path / "breaking.toml"
    file.write_text(STUDY)
    monkeypatch.setattr(os, "environ", os.environ.copy())
    out = tmp_path / "out"
    sizes = ["--screened", "5", "--aimed", "3", "--lanes", "2", "--rounds", "1"]
    assert cli.main(["falsify", str(file), "--out", str(out), *sizes]) == 0
    summary = json.loads((out / "worst.json").read_text())
    assert [row["file"] for row in summary["worst"]] == ["worst-00.toml", "worst-01.toml"]
    for row in summary["worst"]:
        spec = load_scenario(out / row["file"])
        assert spec.name == row["scenario"]
        assert made_up(dataclasses.make_dataclass("Place", ["spec"])(spec)) == pytest.approx(row["clearance"])
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


def test_a_stopped_search_leaves_what_it_found(no_episodes, tmp_path, monkeypatch, capsys):
    def stopped(self, places):
        raise KeyboardInterrupt

    monkeypatch.setattr(Trials, "gradients", stopped)
    monkeypatch.setattr(Search, "drawn", 1)  # quicker
    monkeypatch.setattr(os, "environ", os.environ.copy())
    (tmp_path / "breaking.toml").write_text(STUDY)
    sizes = ["--screened", "3", "--aimed", "2", "--lanes", "2"]
    command = ["falsify", str(tmp_path / "breaking.toml"), "--out", str(tmp_path / "out"), *sizes]
    assert cli.main(command) == cli.INTERRUPTED
    assert "whatever was finished is kept" in capsys.readouterr().err
    assert json.loads((tmp_path / "out" / "worst.json").read_text())["episodes"] == 11
    assert load_scenario(tmp_path / "out" / "worst-01.toml")


def test_the_command_draws_more_than_it_begins_with(tmp_path, monkeypatch):
    searches = []

    def noted(study, config, seed, search, **_):
        searches.append(search)
        raise KeyboardInterrupt

    monkeypatch.setattr(falsification, "falsify", noted)
    monkeypatch.setattr(os, "environ", os.environ.copy())
    (tmp_path / "breaking.toml").write_text(STUDY)
    for count in ("16", "200"):
        command = ["falsify", str(tmp_path / "breaking.toml"), "--out", str(tmp_path), "--screened", count]
        assert cli.main(command) == cli.INTERRUPTED
    assert [(search.drawn, search.screened) for search in searches] == [(160, 16), (2000, 200)]


@pytest.mark.slow
@pytest.mark.timeout(1800)
def test_in_earnest(study):
    """What is found is an episode that `simulate` runs."""
    config = PlannerConfig(horizon=Horizon(steps=5))
    found = falsify(study, config, seed=1, search=Search(screened=4, aimed=(2,), lanes=2, rounds=1))
    (worst, _) = found.worst
    again = simulate(build(worst.spec), config, seed=worst.seed, record=False).outcome
    clearance = min(float(again.min_object_clearance_m), float(again.min_robot_clearance_m))
    # Rounding differs outside of a batch.
    assert clearance == pytest.approx(worst.clearance, abs=0.01)
    begun = sample_worst(study, config, 4, seed=1, keep=2)
    assert all(a.clearance <= b.clearance for a, b in zip(found.worst, begun.worst, strict=True))


def test_gradients_are_those_of_their_places(study, monkeypatch):
    """Three places in batches of two; `test_approach` holds gradients against differences."""
    box = Bounds()
    places = list(random_worst.random_places(study, 1, 3, box))

    def slopes(coordinates, scenarios, config, seeds, bounds, memory, *, ticks, window):
        assert (ticks, window) == (50, 5) and float(memory) == pytest.approx(0.1)
        moved = jax.vmap(vary, (0, 0, None))(scenarios, coordinates, bounds)
        return np.array(coordinates) * np.array(moved.truth.mass)[:, None] + np.array(seeds, float)[:, None]

    monkeypatch.setattr(trials, "_slopes", slopes)
    rows = Trials(study, PlannerConfig(), box, 2, 5, 0.1).gradients(places)
    for row, place in zip(rows, places, strict=True):
        assert row == pytest.approx(place.coordinates * place.spec.truth.mass + place.seed, rel=1e-6)

    def broken(coordinates, *_, **__):
        values = np.array(coordinates)
        values[0, 0] = np.nan
        return values

    monkeypatch.setattr(trials, "_slopes", broken)
    rows = Trials(study, PlannerConfig(), box, 2, 5, 0.1).gradients(places)
    assert [bool(row.any()) for row in rows] == [False, True, False]
