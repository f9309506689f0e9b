"""Measure, print one table, write `DIR/benchmarks.json`.

    python -m benchmarks --out out/benchmarks --update README.md

JAX is imported after the environment is set, because JAX reads it when it is imported.
"""

from __future__ import annotations

import argparse
import json
import os
import sys
from collections.abc import Sequence
from pathlib import Path
from typing import Any

from jaxlocomanip.checked import InputError
from jaxlocomanip.files import prepare_directory, write_whole

SECTIONS = ("push2", "latency", "scaling", "episode", "batch", "physics", "quadruped", "gradients")
"""What can be measured, in the order in which it is."""


def main(argv: Sequence[str] | None = None) -> int:
    """Run the benchmarks.

    Returns:
      Exit code: 0 if everything was measured, however slow; 2 for bad input.
    """
    arguments = _parser().parse_args(argv)
    # XLA's CPU thread pool has one thread a core, and a pool of few threads can dead-lock.
    os.environ.setdefault("PJRT_NPROC", "16")
    try:
        out = prepare_directory(arguments.out)
        page = Path(arguments.update) if arguments.update else None
        from benchmarks import report, scaling

        if page is not None:
            report.refuse_without_marks(page)
        measured = measure(arguments.only or SECTIONS, arguments.quick)
        write_whole(out / "benchmarks.json", json.dumps(measured, indent=2, allow_nan=False) + "\n")
        if "scaling" in measured:
            scaling.draw(out / "scaling.png", measured["scaling"])
        print(report.table(measured))
        if page is not None:
            report.update(page, measured)
    except InputError as error:
        print(f"error: {error}", file=sys.stderr)
        return 2
    return 0


def measure(sections: Sequence[str], quick: bool) -> dict[str, Any]:
    """All results of the sections, as plain Python values."""
    from benchmarks import batch, environment, episode, gradients, latency, reference_problem, scaling

    lanes = (1, 16, 64, 256)
    run = {
        "push2": lambda: reference_problem.measure(repeats=2 if quick else 5, calls=200 if quick else 500),
        "latency": lambda: latency.measure(calls=200 if quick else 500),
        "scaling": lambda: scaling.measure(repeats=10 if quick else 30),
        "episode": lambda: episode.measure(episode.PLANAR),
        "quadruped": lambda: episode.measure(episode.QUADRUPED),
        "batch": lambda: batch.measure(lanes, repeats=1 if quick else 3),
        "gradients": lambda: gradients.measure(calls=100 if quick else 300),
        "physics": lambda: _physics(repeats=1 if quick else 3),
    }
    measured: dict[str, Any] = {"environment": environment.describe(), "quick": quick}
    for name in SECTIONS:
        if name in sections:
            print(f"{name}...", file=sys.stderr, flush=True)
            measured[name] = run[name]()
    measured["environment"]["load_after"] = environment.load()
    return measured


def _physics(repeats: int) -> dict[str, Any]:
    from benchmarks import physics  # the only section that needs the extra `sim`

    return physics.measure(repeats)


def _parser() -> argparse.ArgumentParser:
    parser = argparse.ArgumentParser(
        prog="python -m benchmarks", description="Latency, start-up and throughput on this machine."
    )
    add = parser.add_argument
    add("--quick", action="store_true", help="fewer calls and repetitions")
    add("--out", default="out/benchmarks", metavar="DIR", help="output directory (default: %(default)s)")
    add(
        "--only",
        action="append",
        choices=SECTIONS,
        help="measure only this; may be repeated",
    )
    add(
        "--update",
        metavar="PAGE",
        help="Markdown page whose marked table gets the headline figures",
    )
    return parser


if __name__ == "__main__":
    sys.exit(main())
