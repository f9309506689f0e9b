"""Outcomes as JSON and as a table: names, units, and nothing where there is nothing."""

import json

import numpy as np
import pytest

from jaxlocomanip.outcome import CLEAR, Outcome
from jaxlocomanip.recording import summary


def outcome(**changes):
    values = dict.fromkeys(Outcome.__dataclass_fields__, np.float32(0.1))
    flags = dict.fromkeys(("collided", "run_over", "fell"), np.bool_(False)) | {"reached": np.bool_(True)}
    counts = {"ticks": np.int32(200), "nonfinite": np.int32(0), "converged": np.int32(150)}
    psi = np.array([8.0, 1.0, 0.8, -0.4, 30.0, 3.0], np.float32)
    return Outcome(**(values | flags | counts | {"estimates": psi} | changes))


def record(name="small", **changes):
    timing = {"name": name, "compile_s": 12.3, "run_s": 4.1}
    return timing | summary.outcome_record(outcome(**changes))


def test_numbers_keep_the_digits_of_float32():
    plain = summary.outcome_record(outcome(max_force_n=np.float32(71.3)))
    assert plain["max_force_n"] == 71.3
    assert plain["reached"] is True
    assert plain["solver"] == {"ticks": 200, "nonfinite": 0, "converged_fraction": 0.75}


def test_every_field_of_the_outcome_is_in_the_record():
    solver = {"ticks", "nonfinite", "converged"}
    assert summary.outcome_record(outcome()).keys() == Outcome.__dataclass_fields__.keys() - solver | {"solver"}


def test_what_does_not_exist_is_null():
    plain = summary.outcome_record(
        outcome(
            reach_time_s=np.float32(np.nan),
            min_team_clearance_m=np.float32(CLEAR),
            final_position_error_m=np.float32(np.inf),
            max_force_n=np.float32(CLEAR),
            ticks=np.int32(0),
        )
    )
    assert plain["reach_time_s"] is None
    assert plain["min_team_clearance_m"] is None
    assert plain["final_position_error_m"] is None
    assert plain["max_force_n"] == CLEAR
    assert plain["solver"]["converged_fraction"] is None
    assert json.loads(summary.as_json([plain])) == [plain]


def test_estimates_by_name():
    assert summary.outcome_record(outcome())["estimates"] == {
        "mass_kg": 8.0,
        "inertia_kgm2": 1.0,
        "com_m": [pytest.approx(0.1), pytest.approx(-0.05)],
        "friction_force_n": 30.0,
        "friction_moment_nm": 3.0,
    }
    broken = summary.estimates_record(np.full(6, np.nan))
    assert (broken["mass_kg"], broken["com_m"]) == (None, [None, None])


@pytest.mark.parametrize(
    ("changes", "words"),
    [
        ({"reach_time_s": np.float32(15.4)}, "reached at 15.4 s"),
        ({"reached": np.bool_(False)}, "not reached (0.100 m and 0.100 rad off)"),
        ({"collided": np.bool_(True)}, "reached at 0.1 s, collided"),
        ({"fell": np.bool_(True)}, "reached at 0.1 s, a robot fell"),
        ({"nonfinite": np.int32(1)}, "reached at 0.1 s, met non-finite numbers"),
    ],
)
def test_verdict(changes, words):
    assert summary.verdict(record(**changes)) == words


def test_table_is_aligned_and_bears_units():
    lost = record("a_long_name", reached=np.bool_(False), reach_time_s=np.float32(np.nan))
    title, units, *rows = summary.table([record(), lost]).splitlines()
    assert title.split()[:3] == ["scenario", "reached", "time"]
    assert "rad off" in units
    assert len({len(line) for line in (title, units, *rows)}) == 1
    assert rows[1].split()[:3] == ["a_long_name", "no", "-"]
