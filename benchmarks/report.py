"""The results as a Markdown table, for the terminal and for a page that shows the headline figures."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from pathlib import Path
from typing import Any, NamedTuple

from jaxlocomanip.checked import InputError
from jaxlocomanip.files import write_whole

BEGIN, END = "<!-- bench -->", "<!-- /bench -->"
"""Marks of the part of a page that `update` replaces."""


class Row(NamedTuple):
    """One line of the table."""

    what: str
    figure: str
    headline: bool


def table(measured: Mapping[str, Any], headlines: bool = False) -> str:
    """All results, or the headline figures only, as aligned Markdown with the machine below."""
    rows = [row for row in _rows(measured) if row.headline or not headlines]
    cells = [("measured", "figure"), *((row.what, row.figure) for row in rows)]
    widths = [max(len(cell[i]) for cell in cells) for i in range(2)]
    lines = [_line(cell, widths) for cell in cells]
    rule = f"|{'-' * (widths[0] + 2)}|{'-' * (widths[1] + 2)}|"
    return "\n".join([lines[0], rule, *lines[1:], "", _machine(measured["environment"])])


def refuse_without_marks(page: Path) -> str:
    """The text of a page that has the marks.

    Raises:
      InputError: the page cannot be read or has no marks.
    """
    try:
        text = page.read_text(encoding="utf-8")
    except (OSError, UnicodeDecodeError) as error:
        reason = error.strerror if isinstance(error, OSError) else "it is not UTF-8"
        raise InputError(f"{page}: cannot be read ({reason})") from error
    if text.count(BEGIN) != 1 or text.count(END) != 1 or text.index(BEGIN) > text.index(END):
        raise InputError(f"{page}: must hold {BEGIN} and, after it, {END} once each")
    return text


def update(page: Path, measured: Mapping[str, Any]) -> None:
    """Replace what stands between the marks of a page by the headline figures."""
    head, _, rest = refuse_without_marks(page).partition(BEGIN)
    tail = rest.partition(END)[2]
    write_whole(page, f"{head}{BEGIN}\n{table(measured, headlines=True)}\n{END}{tail}")


def _rows(measured: Mapping[str, Any]) -> Iterator[Row]:
    if "push2" in measured:
        yield from _push2_rows(measured["push2"])
    latency = measured.get("latency", {"horizons": [], "common_ms": {}})
    for record in latency["horizons"]:
        stages = record["stages"]
        for part, times in record["parts_ms"].items():
            whole = part == "tick"
            yield Row(f"{'one planner tick' if whole else part}, N = {stages}", _spread(times), whole)
    for part, times in latency["common_ms"].items():
        yield Row(part, _spread(times), part == "path search")
    for episode in [*measured.get("episode", []), *measured.get("quadruped", [])]:
        where = ", ".join(filter(None, (episode["world"], episode["backend"])))
        name, cold, cached = f"`{episode['scenario']}`, {where}", episode["cold"], episode["cached"]
        yield Row(f"{name}: compile, cold", f"{cold['compile_s']:.1f} s", True)
        yield Row(f"{name}: start, compiled before", f"{cached['compile_s']:.1f} s", True)
        for label, run in (("cold", cold), ("compiled before", cached)):
            yield Row(f"{name}: whole process, {label}", f"{run['process_s']:.1f} s", False)
        seconds = f"{cached['simulated_s']:.0f} s in {cached['second_run_s']:.2f} s"
        yield Row(f"{name}: closed loop", f"{seconds} ({cached['speed']:.1f} x real time)", True)
    for axis, found in measured.get("scaling", {}).items():
        first, last = found["points"][0], found["points"][-1]
        ends = f"{first['ms']:.2f} ms at {first['size']} to {last['ms']:.2f} ms at {last['size']}"
        line = f"off a straight line by {100 * found['deviation']:.0f} % at most"
        yield Row(f"SQP iteration by {axis}", f"{ends}, exponent {found['exponent']:.2f}, {line}", True)
    for record in measured.get("batch", []):
        lanes = f"{record['lanes']} lane" + ("s" if record["lanes"] > 1 else "")
        yield Row(f"batch of {lanes}: throughput", f"{record['speed']:.1f} scenario-s per wall s", True)
        memory = (
            f"{record['peak_mb']:.0f} MB, of which intermediate results {record['temporary_mb_a_device']} MB a device"
        )
        yield Row(f"batch of {lanes}: memory", memory, record["lanes"] == 256)
        yield Row(f"batch of {lanes}: compile", f"{record['compile_s']:.1f} s", False)
    for name, times in measured.get("gradients", {"programs": {}})["programs"].items():
        headline = name.endswith("implicit vjp by x0 and body")
        yield Row(f"plan's derivative: {name}", _derivative(times), headline)
    if "physics" in measured:
        yield from _physics_rows(measured["physics"])


def _push2_rows(push2: Mapping[str, Any]) -> Iterator[Row]:
    compile_s, cold = push2["compile_s"], push2["cold"]
    yield Row("`push2`: one warm iteration", _spread(push2["latency"]), True)
    yield Row(f"`push2`: cold solve, {cold['iterations']} iterations", _spread(cold), True)
    for record in push2["batch"]:
        lanes = f"{record['lanes']} lane" + ("s" if record["lanes"] > 1 else "")
        figure = f"{record['iterations_per_s']:.0f} iterations per wall s ({record['best']:.0f} best)"
        memory = (
            f"{record['temporary_mb_a_device']:.1f} MB of intermediate results on each of {push2['devices']} devices"
        )
        yield Row(f"`push2`, {lanes}: throughput", f"{figure}, {memory}", record["lanes"] == 256)
    yield Row("`push2`: compile, cold", f"{compile_s['cold']:.1f} s", False)
    yield Row("`push2`: compile, compiled before", f"{compile_s['cached']:.1f} s", False)


def _physics_rows(physics: Mapping[str, Any]) -> Iterator[Row]:
    c, cold, cached = physics["c"], physics["cold"], physics["cached"]
    yield Row("physics, MuJoCo C: throughput", f"{c['steps_per_s']:.0f} steps per wall s, one core", True)
    yield Row(f"physics, MuJoCo C: {c['held']} steps and an observation", f"{c['period_us']:.0f} us", False)
    for record in physics["mjx"]:
        lanes = f"{record['lanes']} lane" + ("s" if record["lanes"] > 1 else "")
        yield Row(f"physics, MJX, {lanes}: throughput", f"{record['steps_per_s']:.0f} lane-steps per wall s", True)
    what = f"physics, MJX, {cold['lanes']} lanes: compile"
    yield Row(f"{what}, cold", f"{cold['compile_s']:.1f} s", False)
    yield Row(f"{what}, compiled before", f"{cached['compile_s']:.1f} s", False)


def _derivative(times: dict[str, Any]) -> str:
    return f"{_spread(times)}, {times['ratio']:.2f} iterations, {times['temporary_kb']} kB"


def _spread(times: Mapping[str, float]) -> str:
    return f"{times['median']:.2f} ms median ({times['min']:.2f} min, {times['p90']:.2f} p90)"


def _machine(environment: Mapping[str, Any]) -> str:
    loads = (environment["load_before"] or ["?"])[0], (environment["load_after"] or ["?"])[0]
    return (
        f"Device: {environment['device']} ({environment['device_kind']}, {environment['cpus']} CPUs), "
        f"{environment['dtype']}; Python {environment['python']}, jax {environment['jax']}, "
        f"jaxlib {environment['jaxlib']}, numpy {environment['numpy']}; "
        f"load {loads[0]} before, {loads[1]} after; {environment['date']}."
    )


def _line(cells: Sequence[str], widths: Sequence[int]) -> str:
    padded = [cell.ljust(width) for cell, width in zip(cells, widths, strict=True)]
    return f"| {' | '.join(padded)} |"
