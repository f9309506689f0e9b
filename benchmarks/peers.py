"""The solver and its peers on `push2` in one go: `python -m benchmarks.peers FOLDER`.

FOLDER holds the peers: its `run.py --out FILE [--only A,B] [--quick]` runs those that are installed and writes
`{"rows": [{"peer", "rti_ms_median", "cold_ms", "batch256_iters_per_s", "guess_cost", "final_cost", ...}]}`.
"""

from __future__ import annotations

import argparse
import json
import subprocess
import sys
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

from benchmarks import environment, reference_problem
from jaxlocomanip.files import prepare_directory, write_whole

BATCH = 256
SHARE = 1e-3
"""by which costs may differ between solvers of one problem"""


def main(argv: Sequence[str] | None = None) -> int:
    """Measure both, print a table of ratios, write `DIR/peers.json`."""
    parser = argparse.ArgumentParser(
        prog="python -m benchmarks.peers", description="The solver and its peers on `push2`."
    )
    parser.add_argument("folder", type=Path, help="folder with the peers' run.py")
    parser.add_argument("--python", default=sys.executable, help="interpreter of the peers (default: this one)")
    parser.add_argument("--only", help="peers to run, as their run.py names them")
    parser.add_argument("--rounds", type=int, default=3, help="turns that the peers and the solver take")
    parser.add_argument("--quick", action="store_true", help="few repetitions")
    parser.add_argument("--out", default="out/benchmarks", metavar="DIR")
    given = parser.parse_args(argv)
    out = prepare_directory(given.out)
    about = environment.describe()
    rounds = [(_own(given.quick), _peers(given, out / f"peers_{k}.json")) for k in range(given.rounds)]
    about["load_after"] = environment.load()
    rows = compared(rounds)
    write_whole(out / "peers.json", json.dumps({"environment": about, "rows": rows}, indent=2) + "\n")
    print(table(rows))
    return 0


def _own(quick: bool) -> dict[str, Any]:
    found = reference_problem.measure(repeats=2 if quick else 5, calls=200 if quick else 500)
    batch = next(record for record in found["batch"] if record["lanes"] == BATCH)
    return {
        "peer": "jaxlocomanip",
        "rti_ms_median": found["latency"]["median"],
        "cold_ms": found["cold"]["median"],
        "batch256_iters_per_s": batch["iterations_per_s"],
        "guess_cost": found["costs"]["guess"],
        "final_cost": found["costs"]["solution"],
    }


def _peers(given: argparse.Namespace, out: Path) -> list[dict[str, Any]]:
    command = [given.python, str(given.folder / "run.py"), "--out", str(out.absolute())]
    asked = [*(["--only", given.only] if given.only else []), *(["--quick"] if given.quick else [])]
    subprocess.run([*command, *asked], check=True, stdout=subprocess.DEVNULL)
    return json.loads(out.read_text(encoding="utf-8"))["rows"]


def compared(rounds: Sequence[tuple[Mapping[str, Any], Sequence[Mapping[str, Any]]]]) -> list[dict[str, Any]]:
    """One row a solver, medians over the rounds, with the ratio of each figure to this solver's of the same round.

    Raises:
      RuntimeError: two solvers of one problem disagree about a cost.
    """
    figures: dict[str, list[dict[str, Any]]] = {}
    for own, peers in rounds:
        for row in (own, *peers):
            if row.get("batch256_iters_per_s") is None:
                continue
            same = abs(row["guess_cost"] - own["guess_cost"]) <= SHARE * abs(own["guess_cost"])
            if same and abs(row["final_cost"] - own["final_cost"]) > SHARE * abs(own["final_cost"]):
                raise RuntimeError(f"{row['peer']}: final cost {row['final_cost']}, here {own['final_cost']}")
            kept = {name: row.get(name) for name in own}
            kept["same_problem"] = same
            kept["throughput_ratio"] = own["batch256_iters_per_s"] / row["batch256_iters_per_s"]
            kept["latency_ratio"] = own["rti_ms_median"] / row["rti_ms_median"]
            figures.setdefault(row["peer"], []).append(kept)
    return [{name: _middle([row[name] for row in rows]) for name in rows[0]} for rows in figures.values()]


def _middle(values: list[Any]) -> Any:
    known = sorted(value for value in values if value is not None) if not isinstance(values[0], str) else values
    return known[len(known) // 2] if known else None


def table(rows: Sequence[Mapping[str, Any]]) -> str:
    """Aligned Markdown; the ratios are this solver's figure over the peer's."""
    columns = {
        "peer": ("solver", "{}"),
        "rti_ms_median": ("iteration, ms", "{:.3f}"),
        "latency_ratio": ("latency ratio", "{:.2f}"),
        "cold_ms": ("cold solve, ms", "{:.2f}"),
        "batch256_iters_per_s": ("256 lanes, it/s", "{:.0f}"),
        "throughput_ratio": ("throughput ratio", "{:.2f}"),
        "guess_cost": ("cost at guess", "{:.3f}"),
        "final_cost": ("final cost", "{:.5f}"),
    }
    cells = [[head for head, _ in columns.values()]]
    cells += [["-" if row[k] is None else form.format(row[k]) for k, (_, form) in columns.items()] for row in rows]
    widths = [max(len(line[i]) for line in cells) for i in range(len(columns))]
    lines = ["| " + " | ".join(c.ljust(w) for c, w in zip(line, widths, strict=True)) + " |" for line in cells]
    return "\n".join([lines[0], "|" + "|".join("-" * (w + 2) for w in widths) + "|", *lines[1:]])


if __name__ == "__main__":
    sys.exit(main())
