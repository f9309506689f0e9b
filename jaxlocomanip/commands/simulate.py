"""`jaxlocomanip simulate`: scenarios in closed loop, each with its recording, figure and outcome."""

from __future__ import annotations

import argparse
import dataclasses
import time
from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any

from jaxlocomanip import library
from jaxlocomanip.checked import InputError
from jaxlocomanip.commands import options
from jaxlocomanip.commands.options import refuse_missing_viewers, say
from jaxlocomanip.files import prepare_directory, write_whole
from jaxlocomanip.specification import ScenarioSpec

if TYPE_CHECKING:
    from jaxlocomanip.closed_loop import Result
    from jaxlocomanip.planner.config import PlannerConfig
    from jaxlocomanip.scenario import Scenario


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Arguments of the command."""
    add = parser.add_argument
    add("scenarios", nargs="+", metavar="SCENARIO", help="name in the library or path of a TOML file")
    add("--world", default="planar", help="world to simulate in: planar (default) or quadruped")
    options.add_backend(parser)
    options.add_planner(parser)
    add("--out", default="out", metavar="DIR", help="output directory (default: %(default)s)")
    add("--no-record", action="store_true", help="write no Rerun recordings")
    add("--seed", type=options.seed, default=0, help="of the measurement noise (default: %(default)s)")


@dataclasses.dataclass(frozen=True)
class _Job:
    """A checked request."""

    specs: tuple[ScenarioSpec, ...]
    scenarios: tuple[Scenario, ...]
    config: PlannerConfig
    config_name: str
    without: tuple[str, ...]
    world: str
    backend: str | None
    seed: int
    record: bool
    draw: bool
    out: Path


def _checked_job(arguments: argparse.Namespace) -> _Job:
    """Refuse here, before minutes of compilation, whatever can be refused; the directory comes last."""
    specs = tuple(library.find(name) for name in arguments.scenarios)
    _refuse_repeated([spec.name for spec in specs])
    draw = refuse_missing_viewers(not arguments.no_record, hint=", or pass --no-record")

    from jaxlocomanip import config_file
    from jaxlocomanip.closed_loop import load_world

    load_world(arguments.world, arguments.backend, batched=False)
    return _Job(
        world=arguments.world,
        backend=arguments.backend,
        config=config_file.without(config_file.named_config(arguments.config), arguments.without),
        config_name=arguments.config,
        without=tuple(dict.fromkeys(arguments.without)),
        specs=specs,
        scenarios=tuple(_built(spec) for spec in specs),
        seed=arguments.seed,
        record=not arguments.no_record,
        draw=draw,
        out=prepare_directory(arguments.out),
    )


def _refuse_repeated(names: Sequence[str]) -> None:
    for name in names:
        if names.count(name) > 1:
            raise InputError(f"scenario {name!r}: given twice, or two files have this name; outputs would collide")


def _built(spec: ScenarioSpec) -> Scenario:
    """Arrays of a scenario, its name before whatever is wrong with it."""
    from jaxlocomanip.build import build

    try:
        return build(spec)
    except InputError as error:
        raise InputError(f"{spec.name}: {error}") from None


def run(arguments: argparse.Namespace) -> None:
    """Simulate, with progress on standard error and a table on standard output.

    Raises:
      InputError: bad input, before anything is compiled.
    """
    job = _checked_job(arguments)

    from jaxlocomanip.config_file import config_to_toml
    from jaxlocomanip.recording import summary

    # An older outcome must not stand beside the settings of a run that is still going on.
    write_whole(job.out / "outcome.json", summary.as_json([]))
    write_whole(job.out / "config.toml", config_to_toml(job.config))
    records = []
    for index, spec in enumerate(job.specs):
        say(f"[{index + 1}/{len(job.specs)}] {spec.name}: ")
        record, result = _simulated(job, index)
        records.append(record)
        # Before the recording, which is large and can fail: the numbers of a finished scenario are kept.
        write_whole(job.out / "outcome.json", summary.as_json(records))
        _show(job, index, result)
    print(summary.table(records))


def _simulated(job: _Job, index: int) -> tuple[dict[str, Any], Result]:
    """Simulate one scenario of a job, telling how it goes."""
    import jax

    from jaxlocomanip.closed_loop import compiled
    from jaxlocomanip.recording import summary

    say("compiling... ")
    start = time.perf_counter()
    record = job.record or job.draw
    run = compiled(job.scenarios[index], job.config, job.world, backend=job.backend, record=record)
    compile_s = time.perf_counter() - start
    say(f"{compile_s:.1f} s, running... ")
    start = time.perf_counter()
    result = jax.block_until_ready(run(job.seed))
    run_s = time.perf_counter() - start
    figures = {
        "name": job.specs[index].name,
        "world": job.world,
        "config": job.config_name,
        "without": list(job.without),
        "seed": job.seed,
        **summary.outcome_record(result.outcome),
        "compile_s": round(compile_s, 3),
        "run_s": round(run_s, 3),
    }
    say(f"{run_s:.1f} s: {summary.verdict(figures)}\n")
    return figures, result


def _show(job: _Job, index: int, result: Result) -> None:
    """Write the recording and the figure of a scenario, as far as they are wanted."""
    name, scenario = job.specs[index].name, job.scenarios[index]
    if job.record and result.log is not None:
        from jaxlocomanip.recording.rerun import write_recording

        write_recording(job.out / f"{name}.rrd", name, scenario, result.log)
    if job.draw:
        from jaxlocomanip.recording.figures import draw_figure

        draw_figure(job.out / f"{name}.png", name, scenario, result)
