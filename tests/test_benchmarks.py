"""What the benchmarks make of their measurements: tables, fits, comparisons, and the page that shows them."""

import copy
import sys
from pathlib import Path

import numpy as np
import pytest

sys.path.insert(0, str(Path(__file__).parents[1]))  # they are no part of the package

from benchmarks import peers, report, scaling
from jaxlocomanip.checked import InputError

ENVIRONMENT = {
    "date": "2025-01-01",
    "device": "cpu",
    "device_kind": "a processor",
    "dtype": "float32",
    "python": "3.11.0",
    "jax": "0.7.0",
    "jaxlib": "0.7.0",
    "numpy": "2.0.0",
    "cpus": 2,
    "load_before": [0.5, 0.4, 0.3],
    "load_after": None,
}
TIMES = {"median": 1.0, "min": 0.9, "p90": 1.25}
MEASURED = {
    "environment": ENVIRONMENT,
    "latency": {
        "horizons": [{"stages": 30, "parts_ms": {"tick": TIMES, "safety filter": TIMES}}],
        "common_ms": {"path search": TIMES},
    },
    "batch": [
        {"lanes": 1, "speed": 10.0, "peak_mb": 400, "temporary_mb_a_device": 3, "compile_s": 20.0},
        {"lanes": 256, "speed": 90.0, "peak_mb": 800, "temporary_mb_a_device": 40, "compile_s": 30.0},
    ],
}
PAGE = f"# Title\n\nbefore\n{report.BEGIN}\nold figures\n{report.END}\nafter, ü\n"


@pytest.fixture
def page(tmp_path):
    path = tmp_path / "page.md"
    path.write_text(PAGE, encoding="utf-8")
    return path


def test_only_what_is_between_the_marks_is_replaced(page):
    report.update(page, MEASURED)
    text = page.read_text(encoding="utf-8")
    assert text == PAGE.replace("old figures", report.table(MEASURED, headlines=True))
    assert "| one planner tick, N = 30 " in text and "safety filter" not in text
    report.update(page, MEASURED)
    assert page.read_text(encoding="utf-8") == text, "the same figures leave the same page"


def test_the_table_is_aligned_and_names_the_machine():
    lines = report.table(MEASURED).splitlines()
    rows, blank, machine = lines[:-2], lines[-2], lines[-1]
    assert len({len(line) for line in rows}) == 1 and not blank
    assert sum("safety filter" in line for line in rows) == 1
    assert any(
        line.startswith("| batch of 1 lane: throughput ") and "10.0 scenario-s per wall s" in line for line in rows
    )
    assert any(line.startswith("| batch of 256 lanes: throughput ") for line in rows)
    assert "a processor, 2 CPUs" in machine and "load 0.5 before, ? after" in machine
    assert report.table({"environment": ENVIRONMENT}).count("\n") == 3, "nothing measured, no rows"


@pytest.mark.parametrize(
    "text",
    [
        "no marks",
        f"{report.BEGIN} begins only",
        f"{report.END} the wrong way round {report.BEGIN}",
        f"{report.BEGIN}{report.END} twice {report.BEGIN}{report.END}",
    ],
)
def test_a_page_without_marks_is_refused_and_left(tmp_path, text):
    path = tmp_path / "page.md"
    path.write_text(text, encoding="utf-8")
    for refuses in (report.refuse_without_marks, lambda page: report.update(page, MEASURED)):
        with pytest.raises(InputError, match="page.md: must hold .* once each"):
            refuses(path)
    assert path.read_text(encoding="utf-8") == text


def test_a_page_that_cannot_be_read_is_refused(tmp_path):
    with pytest.raises(InputError, match="missing.md: cannot be read"):
        report.refuse_without_marks(tmp_path / "missing.md")
    path = tmp_path / "latin.md"
    path.write_bytes(PAGE.encode("latin-1"))
    with pytest.raises(InputError, match="it is not UTF-8"):
        report.refuse_without_marks(path)


def test_figures_that_are_incomplete_leave_the_page_as_it_was(page):
    broken = copy.deepcopy(MEASURED)
    del broken["batch"][1]["speed"]
    with pytest.raises(KeyError, match="speed"):
        report.update(page, broken)
    assert page.read_text(encoding="utf-8") == PAGE
    assert [path.name for path in page.parent.iterdir()] == [page.name]


def points(sizes, ms):
    return [{"size": size, "ms": float(value)} for size, value in zip(sizes, ms, strict=True)]


def test_a_straight_line_is_found():
    size = np.array(scaling.STAGES)
    found = scaling.fitted("stages", points(scaling.STAGES, 2.0 + 0.25 * size))
    assert found["base_ms"] == pytest.approx(2.0) and found["slope_ms"] == pytest.approx(0.25)
    assert found["deviation"] == 0.0
    assert 0.0 < found["exponent"] < 1.0


@pytest.mark.parametrize("exponent", [0.0, 1.0, 2.0])
def test_the_exponent_of_a_power_is_found(exponent):
    found = scaling.fitted("robots", points(scaling.ROBOTS, 3.0 * np.array(scaling.ROBOTS) ** exponent))
    assert found["exponent"] == pytest.approx(exponent, abs=1e-3)
    assert (found["deviation"] > 0.02) == (exponent == 2.0)


@pytest.mark.parametrize(("place", "deviation"), [(0, 0.03), (-1, 0.063)])
def test_errors_count_relative_to_the_figure(place, deviation):
    """One of five points is a tenth too high, the smallest or the largest; the largest does not draw the line to it."""
    ms = np.array(scaling.OBSTACLES, float)
    ms[place] *= 1.1
    found = scaling.fitted("obstacles", points(scaling.OBSTACLES, ms))
    assert found["deviation"] == pytest.approx(deviation, abs=1e-3)


def test_batches_that_leave_cores_idle_do_not_count():
    size = np.array(scaling.BATCH)
    ms = np.where(size < scaling.SATURATED, 1.0, 0.1 * size)
    assert scaling.fitted("lanes", points(scaling.BATCH, ms))["deviation"] == 0.0
    assert scaling.fitted("lanes", points(scaling.BATCH, ms))["exponent"] == 1.0
    assert scaling.fitted("anything else", points(scaling.BATCH, ms))["deviation"] > 0.1


def solver(peer, **changes):
    figures = {"rti_ms_median": 1.0, "cold_ms": 20.0, "batch256_iters_per_s": 1000.0}
    return {"peer": peer, **figures, "guess_cost": 421.2, "final_cost": -34.4, **changes}


def test_ratios_are_of_the_same_round_and_figures_their_medians():
    """A machine that is half as fast in one round changes no ratio."""
    rounds = [
        tuple(
            solver(peer, rti_ms_median=slow * ms, batch256_iters_per_s=rate / slow)
            for peer, ms, rate in (("own", 1.0, 1000.0), ("other", 4.0, 500.0))
        )
        for slow in (1.0, 2.0, 3.0)
    ]
    own, other = peers.compared([(own, [other]) for own, other in rounds])
    assert (own["peer"], other["peer"]) == ("own", "other")
    assert own["throughput_ratio"] == own["latency_ratio"] == 1.0
    assert other["throughput_ratio"] == pytest.approx(2.0) and other["latency_ratio"] == pytest.approx(0.25)
    assert own["rti_ms_median"] == 2.0 and other["batch256_iters_per_s"] == 250.0
    assert own["same_problem"] and other["same_problem"]
    lines = peers.table([own, other]).splitlines()
    assert len(lines) == 4 and len({len(line) for line in lines}) == 1


def test_a_peer_that_was_not_measured_is_left_out():
    rounds = [
        (solver("own"), [{"peer": "absent"}, solver("other", batch256_iters_per_s=None), solver("third", cold_ms=None)])
    ]
    rows = peers.compared(rounds)
    assert [row["peer"] for row in rows] == ["own", "third"]
    assert rows[1]["cold_ms"] is None
    assert "| - " in peers.table(rows).splitlines()[-1]


def test_solvers_of_one_problem_must_agree_about_its_cost():
    close = -34.4 * (1.0 + 0.9 * peers.SHARE)
    assert peers.compared([(solver("own"), [solver("other", final_cost=close)])])[1]["same_problem"]
    with pytest.raises(RuntimeError, match=r"other: final cost -34\.5, here -34\.4"):
        peers.compared([(solver("own"), [solver("other", final_cost=-34.5)])])


def test_one_that_solves_another_problem_may_find_another_cost():
    rows = peers.compared([(solver("own"), [solver("other", final_cost=-30.0, guess_cost=400.0)])])
    assert not rows[1]["same_problem"]
