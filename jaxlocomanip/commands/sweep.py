"""`jaxlocomanip sweep`: a study over many scenarios, chunk by chunk, into a table."""

from __future__ import annotations

import argparse
from collections.abc import Sequence

from jaxlocomanip.checked import InputError, installing
from jaxlocomanip.commands import options
from jaxlocomanip.commands.options import say


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Arguments of the command."""
    add = parser.add_argument
    add("study", metavar="STUDY", help="name of a study or path of a TOML file; `jaxlocomanip list` names them")
    add("--out", required=True, metavar="DIR", help="results; a sweep that was stopped is gone on with")
    add("--count", type=options.positive, help="random draws at each point (default: that of the study)")
    add("--seed", type=options.seed, default=0, help="of scenarios and measurement noise (default: %(default)s)")
    add("--world", help="world to simulate in: planar or quadruped (default: that of the study)")
    options.add_backend(parser)
    add("--chunk", type=options.positive, help="scenarios in one compiled batch, bounds the memory")
    options.add_planner(parser)
    add("--workers", metavar="KIND", help="ray or ray:N: run the chunks on a Ray cluster, by N workers")


def run(arguments: argparse.Namespace, command: Sequence[str]) -> None:
    """Run a sweep, with progress on standard error and a table on standard output.

    Args:
      arguments: parsed.
      command: as typed, for the manifest.

    Raises:
      InputError: bad input, before anything is compiled.
    """
    from jaxlocomanip.sampling.study import find_study

    study = find_study(arguments.study)
    workers = _workers(arguments.workers)

    from jaxlocomanip import config_file
    from jaxlocomanip.sweep import execute, report
    from jaxlocomanip.sweep.plan import plan_sweep
    from jaxlocomanip.sweep.store import read_results, refuse_missing_parquet

    refuse_missing_parquet()
    plan = plan_sweep(
        study,
        config_file.named_config(arguments.config),
        seed=arguments.seed,
        count=arguments.count,
        world=arguments.world,
        backend=arguments.backend,
        chunk=arguments.chunk,
        without=arguments.without,
    )
    if workers is None:
        from jaxlocomanip.batch import Runner

        manifest = execute.execute(plan, arguments.out, Runner(plan.world, plan.backend), command, say)
    else:
        from jaxlocomanip.sweep.ray_workers import execute_on_ray

        manifest = execute_on_ray(plan, arguments.out, command, say, workers)
    results = report.Results.of(read_results(arguments.out))
    print(report.summary_table(results))
    print(report.rejected_line(manifest, results))


def _workers(text: str | None) -> int | None:
    """Number of Ray workers; 0 where Ray decides, None without Ray."""
    if text is None:
        return None
    kind, _, number = text.partition(":")
    if kind != "ray" or (number and not (number.isascii() and number.isdigit() and 1 <= int(number) <= 10_000)):
        raise InputError(f"workers = {text!r}: must be ray, or ray:N with N from 1 to 10000")
    import importlib.util

    if importlib.util.find_spec("ray") is None:
        raise InputError(f"workers = 'ray': needs the ray extra: {installing('ray')}")
    return int(number) if number else 0
