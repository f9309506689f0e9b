"""What a sweep says: tables of success with confidence intervals, and the worst scenarios."""

from __future__ import annotations

import shlex
import tomllib
from collections.abc import Mapping
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from jaxlocomanip.checked import InputError, one_of
from jaxlocomanip.sweep.statistics import CONFIDENCE, percent
from jaxlocomanip.tables import aligned

if TYPE_CHECKING:
    import pyarrow

Values = NDArray[Any]
Row = dict[str, Any]

WORST = 8
"""scenarios that a report lists"""


@dataclass(frozen=True)
class Results:
    """The rows of a sweep as arrays by column; missing numbers are NaN."""

    columns: Mapping[str, Values]

    @staticmethod
    def of(table: pyarrow.Table) -> Results:
        """From a table."""
        return Results({name: _array(table[name]) for name in table.column_names})

    def __getitem__(self, name: str) -> Values:
        """A column."""
        return self.columns[name]

    def __len__(self) -> int:
        """Number of rows."""
        return len(self.columns["lane"])

    def where(self, chosen: Values) -> Results:
        """The rows for which `chosen` [n] is true, or those that it numbers."""
        return Results({name: values[chosen] for name, values in self.columns.items()})

    def variants(self) -> list[str]:
        """Names of the planners, in the order of the study."""
        return list(dict.fromkeys(self["variant"].tolist()))

    def of_variant(self, name: str) -> Results:
        """The rows of one planner."""
        return self.where(self["variant"] == name)


def _array(column: Any) -> Values:
    values = column.to_pylist()
    if values and isinstance(values[0], list | str):
        made = np.empty(len(values), dtype=object)
        made[:] = values
        return made
    if any(value is None for value in values):
        return np.array([np.nan if value is None else value for value in values], dtype=float)
    return np.array(values)


def summary_table(results: Results) -> str:
    """One row a planner, and a point where the points have names: counts, rates with intervals, medians."""
    header = [
        "", "n", "success %", "reached %", "collided %", "run over %", "fell %",
        "time s", "object m", "robots m", "off m", "nonfinite",
    ]  # fmt: skip
    under = ["", "", *[f"{CONFIDENCE:.0%} interval"] * 5, "median", "5th pct", "5th pct", "median", "scenarios"]
    lines = [header, under]
    for variant in results.variants():
        rows = results.of_variant(variant)
        lines.append([variant or "all", *_figures(rows)])
        for name in dict.fromkeys(n for n in rows["point_name"].tolist() if n):
            lines.append([f"  {name}", *_figures(rows.where(rows["point_name"] == name))])
    return aligned(lines)


def _figures(rows: Results) -> list[str]:
    count = len(rows)
    rates = [percent(int(rows[name].sum()), count) for name in ("success", "reached", "collided", "run_over", "fell")]
    return [
        str(count),
        *rates,
        _quantile(rows["reach_time_s"], 0.5, 1),
        _quantile(rows["min_object_clearance_m"], 0.05, 3),
        _quantile(rows["min_robot_clearance_m"], 0.05, 3),
        _quantile(rows["final_position_error_m"], 0.5, 3),
        str(int((rows["nonfinite"] > 0).sum())),
    ]


def _quantile(values: Values, part: float, digits: int) -> str:
    there = values[np.isfinite(values.astype(float))]
    return f"{np.quantile(there, part):.{digits}f}" if len(there) else "-"


def rejected_line(manifest: Mapping[str, Any], results: Results) -> str:
    """How many draws were rejected, and why."""
    first = results.of_variant(results.variants()[0])
    names = [name for name in first.columns if name.startswith("rejected_")]
    counts = {name.removeprefix("rejected_"): int(first[name].sum()) for name in names}
    total = sum(counts.values())
    reasons = ", ".join(f"{count} {reason}" for reason, count in counts.items() if count)
    drawn = f"{len(first)} scenarios out of {len(first) + total} draws"
    state = "" if manifest.get("complete") else "; the sweep is not finished"
    return f"{drawn}; rejected as impossible: {reasons or 'none'}{state}"


def badness(results: Results) -> tuple[Values, Values]:
    """How bad rows are: 4 non-finite, 3 fell, 2 collided, 1 not reached, 0 success; and a figure within the class."""
    clearance = np.fmin(
        np.fmin(results["min_object_clearance_m"], results["min_robot_clearance_m"]), results["min_team_clearance_m"]
    ).astype(float)
    grade = np.where(results["reached"], 0, 1)
    grade = np.where(results["collided"], 2, grade)
    grade = np.where(results["fell"], 3, grade)
    grade = np.where(results["nonfinite"] > 0, 4, grade)
    within = np.where(grade == 1, results["final_position_error_m"], -np.nan_to_num(clearance, nan=1e3))
    return grade, within


def worst(results: Results, count: int) -> Results:
    """The worst rows, the worst first; equal ones in the order of their lanes."""
    grade, within = badness(results)
    return results.where(np.lexsort((results["lane"], -within, -grade))[:count])


def worst_table(rows: Results, directory: str) -> str:
    """The rows with what went wrong and the command that replays each of them, as a shell reads it."""
    words = ["-", "not reached", "collided", "fell", "non-finite"]
    grade, _ = badness(rows)
    lines = [["lane", "variant", "what", "object m", "robots m", "team m", "off m", "off rad", "replay"]]
    for i, kind in enumerate(grade.tolist()):
        what = "run over" if kind == 2 and rows["run_over"][i] else words[kind]
        lane, variant = int(rows["lane"][i]), rows["variant"][i]
        which = f"{lane}@{variant}" if variant else str(lane)
        replay = f"jaxlocomanip report {shlex.quote(directory)} --record {shlex.quote(which)}"
        cells = [
            f"{float(rows[name][i]):.3f}" if np.isfinite(float(rows[name][i])) else "-"
            for name in (
                "min_object_clearance_m",
                "min_robot_clearance_m",
                "min_team_clearance_m",
                "final_position_error_m",
                "final_heading_error_rad",
            )
        ]
        lines.append([str(lane), variant or "-", what, *cells, replay])
    return aligned(lines)


def chosen_rows(results: Results, text: str) -> Results:
    """Rows that `--record` names: `worst:8`, or lanes such as `17` or `17@variant,23`.

    Raises:
      InputError: none of these, or rows that are not there.
    """
    if text.startswith("worst:"):
        number = text.removeprefix("worst:")
        if not number.isascii() or not number.isdigit() or not 1 <= int(number) <= 1000:
            raise InputError(f"record = {text!r}: must be worst:N with N from 1 to 1000")
        return worst(results, int(number))
    chosen = []
    for part in text.split(","):
        lane, _, variant = part.partition("@")
        if not lane.isascii() or not lane.isdigit():
            raise InputError(f"record = {text!r}: must be worst:N, or lanes such as 17 or 17@variant,23")
        variant = one_of("record: variant", variant or results.variants()[0], results.variants())
        found = np.flatnonzero((results["lane"] == int(lane)) & (results["variant"] == variant))
        if len(found) == 0:
            raise InputError(f"record = {text!r}: the results have no lane {lane}")
        chosen.append(int(found[0]))
    return results.where(np.array(chosen))


def planner_tables(manifest: Mapping[str, Any]) -> dict[str, Any]:
    """Settings of each planner of a sweep, as nested tables by its name."""
    return {one["name"]: tomllib.loads(one["config"]) for one in manifest["settings"]["variants"]}
