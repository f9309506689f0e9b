"""Figures of a sweep are drawn for one planner and several, with and without obstacles."""

import io

import numpy as np
import pytest
from pyarrow import parquet

from jaxlocomanip.recording import sweep_figures
from jaxlocomanip.recording.sweep_figures import draw_sweep
from jaxlocomanip.sweep.report import Results
from jaxlocomanip.sweep.store import to_parquet


def results_of(columns):
    return Results.of(parquet.read_table(io.BytesIO(to_parquet(columns))))


@pytest.mark.parametrize("variants", [(), ("full", "blind", "straight", "paper")])
def test_three_figures_are_left(made_up_columns, tmp_path, variants):
    results = results_of(made_up_columns(8, variants, collided=np.arange(8) == 2))
    files = draw_sweep(tmp_path, results, "tiny")
    assert [path.name for path in files] == ["success.png", "clearance.png", "failures.png"]
    assert all(path.read_bytes()[:4] == b"\x89PNG" for path in files)
    assert {path.name for path in tmp_path.iterdir()} == {path.name for path in files}


def test_nothing_to_hit_and_one_scenario_are_fine(made_up_columns, tmp_path):
    columns = made_up_columns(1)
    for name in columns:
        if name.startswith("obstacle_") and isinstance(columns[name][0], list):
            columns[name] = [[]]
    columns["min_object_clearance_m"] = columns["min_robot_clearance_m"] = [None]
    draw_sweep(tmp_path, results_of(columns), "tiny")


def test_shares_are_counted_by_bin():
    share, every = sweep_figures._shares(
        np.array([0.1, 0.2, 0.9]),
        np.array([0.1, 0.1, 0.9]),
        np.array([True, False, True]),
        (np.array([0.0, 0.5, 1.0]), np.array([0.0, 0.5, 1.0])),
    )
    assert every.tolist() == [[2, 0], [0, 1]]
    assert share[0, 0] == 0.5 and share[1, 1] == 1.0 and np.isnan(share[0, 1])


def test_few_values_get_a_bin_each():
    edges = sweep_figures._edges(np.array([0.5, 1.0, 2.0, 1.0]), 6)
    assert edges == pytest.approx([0.25, 0.75, 1.5, 2.5])
    assert len(sweep_figures._edges(np.linspace(0.0, 1.0, 50), 6)) == 7
    assert len(sweep_figures._edges(np.array([3.0]), 6)) == 2


def test_failures_are_shown_where_the_obstacle_stands(made_up_columns):
    columns = made_up_columns(10, collided=np.arange(10) < 5)
    failed = [i < 5 for i in range(10)]
    for i in range(10):
        bearing = columns["bearing_rad"][i]
        lateral = 0.3 if failed[i] else -0.3
        ahead = 0.45 * columns["distance_m"][i]
        columns["obstacle_x_m"][i] = [np.cos(bearing) * ahead - np.sin(bearing) * lateral]
        columns["obstacle_y_m"][i] = [np.sin(bearing) * ahead + np.cos(bearing) * lateral]
    share = sweep_figures._failures(results_of(columns))
    assert sorted(share[np.isfinite(share)].tolist()) == [0.0, 1.0]
