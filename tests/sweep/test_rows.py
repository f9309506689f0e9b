"""Rows: every parameter and every field of the outcome, under names with units."""

import io
import math

import numpy as np
import pytest
from pyarrow import parquet

from jaxlocomanip.outcome import CLEAR, Outcome
from jaxlocomanip.sampling.sampler import draw
from jaxlocomanip.sampling.study import find_study
from jaxlocomanip.sweep.rows import COLUMNS, OUTCOME_COLUMNS, scenario_row
from jaxlocomanip.sweep.store import to_parquet


def test_every_field_of_the_outcome_has_a_column():
    fields = set(Outcome.__dataclass_fields__) - {"estimates"}
    assert fields <= set(OUTCOME_COLUMNS)
    assert sum(name.startswith("estimated_") for name in OUTCOME_COLUMNS) == 6


def test_a_row_says_what_was_asked():
    study = find_study("moving")
    lane = draw(study, 0, 5)
    row, spec = scenario_row(study, 0, lane), lane.spec
    assert (row["lane"], row["draw"], row["point"], row["point_name"]) == (5, 5, 0, "")
    assert row["mass_kg"] == pytest.approx(row["mass_ratio"] * 6.0)
    assert row["friction_n"] == pytest.approx(row["friction"] * row["mass_kg"] * 9.81)
    assert row["capacity_n"] > row["friction_n"]
    assert (row["distance_m"], row["turn_rad"]) == (
        pytest.approx(math.hypot(*spec.goal.pose[:2])),
        pytest.approx(spec.goal.pose[2]),
    )
    assert row["robot_types"] == [robot.type for robot in spec.robots]
    assert row["obstacle_count"] == len(spec.obstacles) == len(row["obstacle_x_m"])
    assert 1 <= row["moving_count"] <= 3
    assert all((speed > 0.0) == (i < row["moving_count"]) for i, speed in enumerate(row["obstacle_speed_mps"]))
    assert max(row["obstacle_speed_mps"]) <= 0.5 + 1e-9
    assert row["rejected_capacity"] == lane.rejected.get("capacity", 0)


def test_what_does_not_exist_is_missing(made_up_columns):
    far = np.array([CLEAR, 0.2] * 5, np.float32)
    times = np.array([np.nan, 3.0] * 5, np.float32)
    made = made_up_columns(min_team_clearance_m=far, reach_time_s=times)
    assert made["min_team_clearance_m"][:2] == [None, pytest.approx(0.2)]
    assert made["reach_time_s"][:2] == [None, 3.0]


def test_success_is_reaching_without_touching_or_falling(made_up_columns):
    flags = np.array([[1, 0, 0, 0], [0, 0, 0, 0], [1, 1, 0, 0], [1, 0, 1, 0], [1, 0, 0, 1]], bool)
    made = made_up_columns(5, **dict(zip(("reached", "collided", "fell", "nonfinite"), flags.T, strict=True)))
    assert made["success"] == [True, False, False, False, False]


def test_columns_keep_their_types_in_parquet(made_up_columns):
    columns = made_up_columns(3, variants=("a", "b"))
    table = parquet.read_table(io.BytesIO(to_parquet(columns)))
    assert table.column_names == list(COLUMNS)
    assert table.num_rows == 6
    assert table["variant"].to_pylist() == ["a"] * 3 + ["b"] * 3
    assert table["variant_number"].to_pylist() == [0] * 3 + [1] * 3
    kinds = {name: str(table.schema.field(name).type) for name in COLUMNS}
    assert {kinds["lane"], kinds["success"], kinds["mass_kg"], kinds["robot_faces"], kinds["obstacle_x_m"]} == {
        "int64", "bool", "double", "list<element: string>", "list<element: double>",
    }  # fmt: skip
    assert table.to_pydict() == columns
