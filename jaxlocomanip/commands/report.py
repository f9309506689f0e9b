"""`jaxlocomanip report`: what a sweep says, its figures, and recordings of chosen scenarios."""

from __future__ import annotations

import argparse
from collections.abc import Mapping
from pathlib import Path
from typing import TYPE_CHECKING, Any

from jaxlocomanip.checked import InputError
from jaxlocomanip.commands import options
from jaxlocomanip.commands.options import refuse_missing_viewers, say

if TYPE_CHECKING:
    from jaxlocomanip.loop import Log
    from jaxlocomanip.scenario import Scenario
    from jaxlocomanip.sweep.report import Results

Episode = tuple[str, "Scenario", "Log"]


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Arguments of the command."""
    add = parser.add_argument
    add("directory", metavar="DIR", help="--out of a sweep, finished or not")
    add("--worst", type=options.positive, default=8, metavar="N", help="list the N worst (default: %(default)s)")
    add(
        "--record",
        metavar="WHICH",
        help="run worst:N, or lanes such as 17 or 17@variant,23, again and record them to one .rrd",
    )


def run(arguments: argparse.Namespace) -> None:
    """Print tables, draw figures beside the results, and record scenarios if asked to.

    Raises:
      InputError: no results, or bad arguments.
    """
    from jaxlocomanip.sweep import report
    from jaxlocomanip.sweep.store import read_manifest, read_results, refuse_missing_parquet

    refuse_missing_parquet()
    drawable = refuse_missing_viewers(record=arguments.record is not None)
    directory = Path(arguments.directory)
    manifest = read_manifest(directory)
    results = report.Results.of(read_results(directory))
    chosen = report.chosen_rows(results, arguments.record) if arguments.record else None
    print(report.summary_table(results))
    print(report.rejected_line(manifest, results))
    print()
    print(report.worst_table(report.worst(results, arguments.worst), str(directory)))
    if drawable:
        from jaxlocomanip.recording.sweep_figures import draw_sweep

        settings = manifest["settings"]
        title = f"{settings['name']}, {settings['world']} world, seed {settings['seed']}"
        for path in draw_sweep(directory, results, title):
            say(f"{path}\n")
    if chosen is not None:
        _record(directory, manifest, chosen, arguments.record)


def _record(directory: Path, manifest: Mapping[str, Any], chosen: Results, text: str) -> None:
    """Run the chosen rows again, with trajectories, and write them to one file."""
    from jaxlocomanip.recording.several import write_recordings

    episodes = [_again(manifest, chosen, i) for i in range(len(chosen))]
    name = text.replace(":", "_").replace(",", "_").replace("@", "_")
    path = directory / f"{name[:80]}.rrd"
    write_recordings(path, episodes)
    say(f"{path}\n")


def _again(manifest: Mapping[str, Any], chosen: Results, i: int) -> Episode:
    from jaxlocomanip.closed_loop import simulate
    from jaxlocomanip.config_file import config_from_table
    from jaxlocomanip.sampling.sampler import draw
    from jaxlocomanip.sampling.study import study_of
    from jaxlocomanip.sweep.report import planner_tables

    settings = manifest["settings"]
    lane, variant = int(chosen["lane"][i]), str(chosen["variant"][i])
    drawn = draw(study_of(settings["study"]), settings["seed"], lane)
    config = config_from_table(planner_tables(manifest)[variant], variant or "config")
    say(f"{drawn.spec.name} {variant}\n".replace(" \n", "\n"))
    result = simulate(
        drawn.scenario, config, settings["world"], backend=settings["backend"], seed=settings["seed"], record=True
    )
    if result.log is None:
        raise InputError(f"world = {settings['world']!r}: keeps no trajectories")
    kept = bool(result.outcome.reached) == bool(chosen["reached"][i])
    if not kept:
        say(f"{drawn.spec.name}: ended otherwise than in the sweep (rounding differs outside of a batch)\n")
    return f"{drawn.spec.name} {variant}".strip(), drawn.scenario, result.log
