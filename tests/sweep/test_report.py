"""What a report says: rates by planner and point, the worst scenarios first, and how to replay them."""

import io
import shlex

import numpy as np
import pytest
from pyarrow import parquet

from jaxlocomanip.checked import InputError
from jaxlocomanip.sweep import report
from jaxlocomanip.sweep.report import Results
from jaxlocomanip.sweep.store import to_parquet


def results_of(columns):
    return Results.of(parquet.read_table(io.BytesIO(to_parquet(columns))))


@pytest.fixture
def results(made_up_columns):
    """Ten lanes: 2 collided by 0.3 m, 3 collided by 0.1 m and was run over, 5 fell, 6 not reached, 7 non-finite."""
    lanes = np.arange(10)
    clearance = np.where(lanes == 2, -0.3, np.where(lanes == 3, -0.1, 0.2 + 0.01 * lanes))
    return results_of(
        made_up_columns(
            10,
            ("full", "blind"),
            reached=lanes != 6,
            collided=np.isin(lanes, (2, 3)),
            run_over=lanes == 3,
            fell=lanes == 5,
            nonfinite=np.where(lanes == 7, 3, 0),
            min_object_clearance_m=clearance.astype(np.float32),
        )
    )


def test_the_worst_come_first(results):
    full = results.of_variant("full")
    assert report.worst(full, 8)["lane"].tolist() == [7, 5, 2, 3, 6, 0, 1, 4]


def test_rows_of_all_planners_are_ranked_together(results):
    first = report.worst(results, 4)
    assert first["lane"].tolist() == [7, 7, 5, 5]


def test_the_table_has_a_row_for_each_planner(results):
    lines = report.summary_table(results).splitlines()
    assert [line.split()[0] for line in lines[2:]] == ["full", "blind"]
    row = lines[2]
    assert "50.0 [18.7, 81.3]" in row  # success
    assert "90.0 [55.5, 99.7]" in row and "20.0 [2.5, 55.6]" in row and "10.0 [0.3, 44.5]" in row


def test_points_with_names_have_their_own_rows(made_up_columns):
    columns = made_up_columns(4)
    columns["point_name"] = ["gate", "gate", "wall", "wall"]
    lines = report.summary_table(results_of(columns)).splitlines()
    assert [line.split()[:2] for line in lines[2:]] == [["all", "4"], ["gate", "2"], ["wall", "2"]]


def test_replays_are_commands(results):
    table = report.worst_table(report.worst(results, 3), "out/a")
    assert table.splitlines()[1].endswith("jaxlocomanip report out/a --record 7@full")
    assert [line.split()[2] for line in table.splitlines()[1:]] == ["non-finite", "non-finite", "fell"]
    assert "run over" in report.worst_table(report.worst(results.of_variant("blind"), 4), "d")


def test_replays_of_names_with_spaces_are_commands(made_up_columns):
    rows = results_of(made_up_columns(1, ("no adaptation",)))
    replay = report.worst_table(rows, "my sweeps/a").splitlines()[1].partition("jaxlocomanip ")[2]
    command, directory, option, which = shlex.split(replay)
    assert (command, directory, option, which) == ("report", "my sweeps/a", "--record", "0@no adaptation")
    assert report.chosen_rows(rows, which)["variant"].tolist() == ["no adaptation"]


def test_rows_to_record_are_chosen(results):
    assert report.chosen_rows(results, "worst:2")["lane"].tolist() == [7, 7]
    chosen = report.chosen_rows(results, "3,6@blind")
    assert list(zip(chosen["lane"], chosen["variant"], strict=True)) == [(3, "full"), (6, "blind")]


@pytest.mark.parametrize(
    ("text", "expected"),
    [
        ("worst", "record = 'worst': must be worst:N, or lanes"),
        ("worst:0", "record = 'worst:0': must be worst:N with N from 1"),
        ("worst:x", "record = 'worst:x': must be worst:N with N from 1"),
        ("12", "record = '12': the results have no lane 12"),
        ("1@blnd", "record: variant = 'blnd': must be one of full, blind; did you mean 'blind'"),
        ("-3", "record = '-3': must be worst:N, or lanes"),
    ],
)
def test_bad_choices_are_refused(results, text, expected):
    with pytest.raises(InputError, match=expected):
        report.chosen_rows(results, text)


def test_rejections_are_reported(made_up_columns):
    columns = made_up_columns(3)
    for name in columns:
        if name.startswith("rejected_"):
            columns[name] = [0, 0, 0]
    columns["rejected_start"] = [1, 0, 2]
    line = report.rejected_line({"complete": True}, results_of(columns))
    assert line == "3 scenarios out of 6 draws; rejected as impossible: 3 start"
    assert "not finished" in report.rejected_line({"complete": False}, results_of(columns))
