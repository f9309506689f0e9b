"""What came of a run, for people (a table) and for programs (JSON)."""

from __future__ import annotations

import dataclasses
import json
import math
from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np

from jaxlocomanip.outcome import CLEAR, Outcome
from jaxlocomanip.tables import aligned

_SOLVER = ("ticks", "nonfinite", "converged")


def outcome_record(outcome: Outcome) -> dict[str, Any]:
    """One scenario's outcome as plain Python values; what does not exist (NaN, nothing to hit) is None."""
    record: dict[str, Any] = {}
    for field in dataclasses.fields(outcome):
        value = getattr(outcome, field.name)
        if field.name == "estimates":
            record["estimates"] = estimates_record(np.asarray(value))
        elif field.name not in _SOLVER:
            limit = CLEAR if "clearance" in field.name else math.inf
            record[field.name] = _plain(np.asarray(value).item(), limit)
    ticks, nonfinite, converged = (int(getattr(outcome, name)) for name in _SOLVER)
    record["solver"] = {
        "ticks": ticks,
        "nonfinite": nonfinite,
        "converged_fraction": _plain(converged / ticks) if ticks else None,
    }
    return record


def estimates_record(psi: np.ndarray) -> dict[str, Any]:
    """Estimated Psi [6] = [m, I, m c_x, m c_y, F_c, M_c] by name; the centre of mass divided out."""
    mass, inertia, first_x, first_y, force, torsion = (float(v) for v in psi)
    com = [_plain(first / mass) if mass else None for first in (first_x, first_y)]
    return {
        "mass_kg": _plain(mass),
        "inertia_kgm2": _plain(inertia),
        "com_m": com,
        "friction_force_n": _plain(force),
        "friction_moment_nm": _plain(torsion),
    }


def as_json(records: Sequence[Mapping[str, Any]]) -> str:
    """The records as indented JSON text, strictly standard (no NaN)."""
    return json.dumps(list(records), indent=2, allow_nan=False) + "\n"


def verdict(record: Mapping[str, Any]) -> str:
    """The outcome in a few words: "reached at 15.4 s"."""
    if record["reached"]:
        words = f"reached at {_cell(record['reach_time_s'], 1)} s"
    else:
        distance, turn = record["final_position_error_m"], record["final_heading_error_rad"]
        words = f"not reached ({_cell(distance)} m and {_cell(turn)} rad off)"
    if record["collided"]:
        words += ", collided"
    if record["fell"]:
        words += ", a robot fell"
    if record["solver"]["nonfinite"]:
        words += ", met non-finite numbers"
    return words


def table(records: Sequence[Mapping[str, Any]]) -> str:
    """An aligned plain-text table with one row a scenario."""
    columns = [
        ("scenario", "", [r["name"] for r in records]),
        ("reached", "", ["yes" if r["reached"] else "no" for r in records]),
        ("time", "s", [_cell(r["reach_time_s"], 1) for r in records]),
        ("position", "m off", [_cell(r["final_position_error_m"]) for r in records]),
        ("heading", "rad off", [_cell(r["final_heading_error_rad"]) for r in records]),
        ("object", "m clear", [_cell(r["min_object_clearance_m"]) for r in records]),
        ("robots", "m clear", [_cell(r["min_robot_clearance_m"]) for r in records]),
        ("team", "m clear", [_cell(r["min_team_clearance_m"]) for r in records]),
        ("collided", "", ["yes" if r["collided"] else "no" for r in records]),
        ("fell", "", ["yes" if r["fell"] else "no" for r in records]),
        ("force", "max N", [_cell(r["max_force_n"], 1) for r in records]),
        ("converged", "% ticks", [_percent(r["solver"]["converged_fraction"]) for r in records]),
        ("compile", "s", [_cell(r["compile_s"], 1) for r in records]),
        ("run", "s", [_cell(r["run_s"], 1) for r in records]),
    ]
    cells = [[title, unit, *rows] for title, unit, rows in columns]
    return aligned(list(zip(*cells, strict=True)))


def _plain(value: float | bool, limit: float = math.inf) -> float | bool | None:
    """A JSON value: None for what is not finite or not below the limit; float32 holds seven digits."""
    if isinstance(value, bool):
        return value
    return float(f"{value:.7g}") if math.isfinite(value) and value < limit else None


def _cell(value: float | None, digits: int = 3) -> str:
    return "-" if value is None else f"{value:.{digits}f}"


def _percent(value: float | None) -> str:
    return "-" if value is None else f"{100.0 * value:.1f}"
