"""What a sweep will do: planners, chunks of one team size, and one shape for all of them."""

import json
import pickle

import pytest

from jaxlocomanip.checked import InputError
from jaxlocomanip.config_file import config_from_table, config_to_toml, without
from jaxlocomanip.padding import Padding, stack_on_host
from jaxlocomanip.planner.config import PlannerConfig
from jaxlocomanip.planner.presets import preset
from jaxlocomanip.sampling import study
from jaxlocomanip.sampling.layout import team_size
from jaxlocomanip.sampling.sampler import draw
from jaxlocomanip.sampling.study import find_study, parse_study
from jaxlocomanip.sweep.plan import plan_sweep, settings_of

ROBUST = PlannerConfig()


def test_every_lane_is_in_one_chunk_with_teams_of_one_size():
    turn = find_study("turn")
    plan = plan_sweep(turn, ROBUST, count=50, chunk=8)
    assert plan.lanes == 50 and plan.shape.lanes == 8
    assert sorted(lane for chunk in plan.chunks for lane in chunk.lanes) == list(range(50))
    assert [chunk.number for chunk in plan.chunks] == list(range(len(plan.chunks)))
    for chunk in plan.chunks:
        assert 1 <= len(chunk.lanes) <= 8
        assert len({team_size(turn, 0, lane) for lane in chunk.lanes}) == 1
    assert sum(len(chunk.lanes) < 8 for chunk in plan.chunks) <= 2


def test_counts_are_draws_at_each_point():
    plan = plan_sweep(find_study("mass_friction"), ROBUST, count=2)
    assert plan.lanes == 2 * 42
    assert plan_sweep(find_study("standard"), ROBUST, count=3).shape.lanes == 3


@pytest.mark.parametrize("name", study.names())
def test_the_shape_of_a_study_holds_its_scenarios(name):
    found = find_study(name)
    plan = plan_sweep(found, ROBUST, count=1)
    lanes = [draw(found, 0, lane) for lane in range(min(len(found.points), 12))]
    for size in {len(lane.spec.robots) for lane in lanes}:
        stack_on_host([lane.scenario for lane in lanes if len(lane.spec.robots) == size], plan.shape.padding)
    assert plan.shape.duration == max(lane.spec.duration for lane in lanes) == 60.0


def test_padding_follows_points_sizes_and_ranges():
    text = """
    name = "a"
    duration = { uniform = [10.0, 20.0] }
    [object]
    size = { choice = [[0.5, 0.5], [2.0, 0.5]] }
    [obstacles]
    count = { integer = [0, 3] }
    [[points]]
    name = "fixed"
    [points.set]
    "obstacles.count" = 1
    "obstacles.fixed" = [
      { shape = "circle", along = 0.5, lateral = 2.0, half_size = [0.2, 0.2] },
      { shape = "circle", along = 0.5, lateral = 3.0, half_size = [0.2, 0.2] },
      { shape = "circle", along = 0.5, lateral = 4.0, half_size = [0.2, 0.2] },
    ]
    [[points]]
    name = "random"
    set = {}
    """
    shape = plan_sweep(parse_study(text), ROBUST).shape
    assert shape.padding == Padding(obstacles=4, corners=4, marks=1, vertices=4, discs=4)
    assert shape.duration == pytest.approx(20.0, abs=1e-6)


def test_variants_are_planners():
    plan = plan_sweep(find_study("ablations"), ROBUST, without=["filter"])
    configs = {planner.name: planner.config for planner in plan.planners}
    assert configs["full"] == without(ROBUST, ["filter"])
    assert configs["no clf"] == without(ROBUST, ["filter", "clf"])
    assert configs["single start"].reference.second_start == 0.0
    assert {planner.name: planner.config for planner in plan_sweep(find_study("presets"), ROBUST).planners} == {
        "robust": ROBUST,
        "paper": preset("paper"),
    }
    assert len(list(plan.units())) == len(plan.chunks) * 9


def test_settings_say_everything_and_survive_json():
    plan = plan_sweep(find_study("ablations"), config_from_table({"horizon": {"steps": 5}}), seed=3, count=7)
    settings = json.loads(json.dumps(settings_of(plan)))
    assert (settings["name"], settings["seed"], settings["count"], settings["chunk"]) == ("ablations", 3, 7, 7)
    assert settings["variants"][0] == {"name": "full", "config": config_to_toml(plan.planners[0].config)}
    assert settings["study"]["truth"]["friction"] == {"uniform": [0.15, 0.6]}
    assert settings_of(pickle.loads(pickle.dumps(plan))) == settings_of(plan)


@pytest.mark.parametrize(
    ("variant", "expected"),
    [
        ('config = "papr"', "variant 'v': config = 'papr': .*; did you mean 'paper'"),
        ('without = ["cfl"]', "variant 'v': without = 'cfl': .*; did you mean 'clf'"),
        ('settings = { "reference.sped" = 1.0 }', "variant 'v': reference: unknown key 'sped'; did you mean 'speed'"),
        ('settings = { "reference.speed" = -1.0 }', "variant 'v': reference.speed = -1.0: must be >= 0.001"),
    ],
)
def test_bad_variants_are_refused_before_anything_runs(variant, expected):
    with pytest.raises(InputError, match=expected):
        plan_sweep(parse_study(f'name = "a"\n[[variants]]\nname = "v"\n{variant}'), ROBUST)


def test_too_many_scenarios_are_refused():
    with pytest.raises(InputError, match="count = 1000000: must give 1 to 10000000 scenarios"):
        plan_sweep(find_study("mass_friction"), ROBUST, count=1_000_000)
