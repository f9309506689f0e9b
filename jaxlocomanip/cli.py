"""Command line: run scenarios in closed loop and keep what came of them.

    jaxlocomanip simulate adaptive people my_scenario.toml --config paper --without path --out out/paper
    jaxlocomanip list

Whatever starts JAX is imported after the arguments are parsed, so that help and most refusals are instant,
and after the environment is set, because JAX reads it when it is imported.
"""

from __future__ import annotations

import argparse
import dataclasses
import importlib.util
import os
import sys
import time
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any, NoReturn

from jaxlocomanip import library
from jaxlocomanip.checked import InputError, nearest
from jaxlocomanip.files import prepare_directory, write_whole
from jaxlocomanip.specification import ScenarioSpec

if TYPE_CHECKING:
    from jaxlocomanip.closed_loop import Result
    from jaxlocomanip.planner.config import PlannerConfig
    from jaxlocomanip.scenario import Scenario

SEED_LIMIT = 2**32 - 1
"""largest seed"""
INTERRUPTED = 130
"""exit code after Ctrl-C, as shells have it"""


def main(argv: Sequence[str] | None = None) -> int:
    """Run the command line.

    Args:
      argv: arguments without the program's name; those of the process by default.

    Returns:
      Exit code: 0 if the run completed, whether goals were reached or not; 2 for bad input.
    """
    try:
        arguments = _parser().parse_args(argv)
        if arguments.command == "list":
            _list()
            return 0
        _set_environment()
        _simulate(arguments)
        return 0
    except InputError as error:
        # Values and system messages may hold line breaks; a refusal is one line whatever it quotes.
        print(f"error: {' '.join(str(error).split())}", file=sys.stderr)
        return 2
    except KeyboardInterrupt:
        print("interrupted; finished scenarios are kept", file=sys.stderr)
        return INTERRUPTED


def experiment(description: str | None, out: str, runs: Mapping[str, Sequence[str]]) -> int:
    """The command line of a small script: several calls of `simulate`, each into its own directory.

    Args:
      description: what the script shows; its docstring.
      out: default output directory.
      runs: arguments of `simulate` by name of subdirectory.

    Returns:
      The first exit code that is not 0, else 0.
    """
    parser = argparse.ArgumentParser(description=description)
    parser.add_argument("--out", default=out, metavar="DIR", help="output directory (default: %(default)s)")
    parser.add_argument("--world", default="planar", help="world to simulate in (default: %(default)s)")
    arguments = parser.parse_args()
    for name, run in runs.items():
        where = str(Path(arguments.out) / name)
        code = main(["simulate", *run, "--world", arguments.world, "--out", where])
        if code:
            return code
    return 0


class _Parser(argparse.ArgumentParser):
    """A parser that refuses with one line, like every other check."""

    def error(self, message: str) -> NoReturn:
        raise InputError(message)


def _parser() -> argparse.ArgumentParser:
    parser = _Parser(
        prog="jaxlocomanip",
        description="Teams of quadrupeds pushing an object, simulated.",
        allow_abbrev=False,
    )
    commands = parser.add_subparsers(dest="command", required=True, metavar="COMMAND")
    commands.add_parser("list", help="name the scenarios of the library")
    run = commands.add_parser("simulate", help="run scenarios in closed loop", allow_abbrev=False)
    add = run.add_argument
    add("scenarios", nargs="+", metavar="SCENARIO", help="name in the library or path of a TOML file")
    add("--world", default="planar", help="world to simulate in: planar (default) or quadruped")
    add("--backend", help="physics of the quadruped world: c (MuJoCo, default) or mjx")
    add("--config", default="robust", help="planner settings: robust (default), paper, or a TOML file")
    add(
        "--without",
        action="append",
        default=[],
        metavar="FEATURE",
        help="switch off adaptation, robot-cbf, object-cbf, clf, path or filter; may be repeated",
    )
    add("--out", default="out", metavar="DIR", help="output directory (default: %(default)s)")
    add("--no-record", action="store_true", help="write no Rerun recordings")
    add("--seed", type=_seed, default=0, help="of the measurement noise (default: %(default)s)")
    return parser


def _seed(text: str) -> int:
    if not text.isascii() or not text.isdigit() or len(text) > 10 or int(text) > SEED_LIMIT:
        raise argparse.ArgumentTypeError(f"{text!r} must be a whole number from 0 to {SEED_LIMIT}")
    return int(text)


def _list() -> None:
    width = max(len(name) for name in library.names())
    for name in library.names():
        print(f"{name.ljust(width)}  {library.describe(name)}")


def _set_environment() -> None:
    """Settings that JAX reads from the environment; whatever the user has set stays."""
    # XLA's CPU thread pool has one thread a core, and a pool of few threads can dead-lock.
    os.environ.setdefault("PJRT_NPROC", "16")
    # Compiling takes longer than simulating, so every program is kept for the next call.
    cache = Path(os.environ.get("XDG_CACHE_HOME") or os.path.expanduser("~/.cache"))
    os.environ.setdefault("JAX_COMPILATION_CACHE_DIR", str(cache / "jaxlocomanip" / "xla"))
    os.environ.setdefault("JAX_PERSISTENT_CACHE_MIN_COMPILE_TIME_SECS", "0")


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
    draw = _refuse_missing_viewers(record=not arguments.no_record)

    from jaxlocomanip import config_file
    from jaxlocomanip.closed_loop import load_world

    load_world(arguments.world, arguments.backend, batched=False)
    return _Job(
        world=arguments.world,
        backend=arguments.backend,
        config=config_file.without(_config(arguments.config), arguments.without),
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


def _refuse_missing_viewers(record: bool) -> bool:
    """Whether figures can be drawn; what a recording needs must be there if one is asked for."""
    drawable = importlib.util.find_spec("matplotlib") is not None
    if record and not (drawable and importlib.util.find_spec("rerun") is not None):
        raise InputError('recording needs the view extra: pip install "jaxlocomanip[view]", or pass --no-record')
    return drawable


def _config(name: str) -> PlannerConfig:
    """Planner settings of a preset or a file."""
    from jaxlocomanip.config_file import load_config
    from jaxlocomanip.planner.presets import PRESETS, preset

    if name in PRESETS:
        return preset(name)
    if name.endswith(".toml") or os.sep in name or Path(name).exists():
        return load_config(name)
    hint = nearest(name, PRESETS)
    raise InputError(f"config = {name!r}: must be a file or one of {', '.join(PRESETS)}{hint}")


def _built(spec: ScenarioSpec) -> Scenario:
    """Arrays of a scenario, its name before whatever is wrong with it."""
    from jaxlocomanip.build import build

    try:
        return build(spec)
    except InputError as error:
        raise InputError(f"{spec.name}: {error}") from None


def _simulate(arguments: argparse.Namespace) -> None:
    job = _checked_job(arguments)

    from jaxlocomanip.config_file import config_to_toml
    from jaxlocomanip.recording import summary

    # An older outcome must not stand beside the settings of a run that is still going on.
    write_whole(job.out / "outcome.json", summary.as_json([]))
    write_whole(job.out / "config.toml", config_to_toml(job.config))
    records = []
    for index, spec in enumerate(job.specs):
        _say(f"[{index + 1}/{len(job.specs)}] {spec.name}: ")
        record, result = _run(job, index)
        records.append(record)
        # Before the recording, which is large and can fail: the numbers of a finished scenario are kept.
        write_whole(job.out / "outcome.json", summary.as_json(records))
        _show(job, index, result)
    print(summary.table(records))


def _run(job: _Job, index: int) -> tuple[dict[str, Any], Result]:
    """Simulate one scenario of a job, telling how it goes."""
    import jax

    from jaxlocomanip.closed_loop import compiled
    from jaxlocomanip.recording import summary

    _say("compiling... ")
    start = time.perf_counter()
    record = job.record or job.draw
    run = compiled(job.scenarios[index], job.config, job.world, backend=job.backend, record=record)
    compile_s = time.perf_counter() - start
    _say(f"{compile_s:.1f} s, running... ")
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
    _say(f"{run_s:.1f} s: {summary.verdict(figures)}\n")
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


def _say(text: str) -> None:
    """Progress, visible at once."""
    print(text, end="", file=sys.stderr, flush=True)


if __name__ == "__main__":
    sys.exit(main())
