"""Command line: run scenarios in closed loop, alone or by the thousand, and keep what came of them.

    jaxlocomanip list
    jaxlocomanip simulate adaptive people my_scenario.toml --config paper --without path --out out/paper
    jaxlocomanip sweep standard --count 1000 --out out/standard
    jaxlocomanip report out/standard --record worst:8
    jaxlocomanip warmup adaptive --study standard
    jaxlocomanip tune standard --config paper --out out/tuned
    jaxlocomanip falsify standard --config out/tuned/tuned.toml --out out/worst --record 4

Whatever starts JAX is imported after the arguments are parsed, so that help and most refusals are instant,
and after the environment is set, because JAX reads it when it is imported.
"""

from __future__ import annotations

import argparse
import os
import sys
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import NoReturn

from jaxlocomanip import library
from jaxlocomanip.checked import InputError
from jaxlocomanip.commands import falsify, report, simulate, sweep, tune, warmup

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
        _run(arguments, sys.argv[1:] if argv is None else argv)
        return 0
    except InputError as error:
        # Values and system messages may hold line breaks; a refusal is one line whatever it quotes.
        print(f"error: {' '.join(str(error).split())}", file=sys.stderr)
        return 2
    except KeyboardInterrupt:
        print("interrupted; whatever was finished is kept", file=sys.stderr)
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


def study(description: str | None, name: str, out: str) -> int:
    """The command line of a script for one study: `sweep`, with all of its other options, and then `report`.

    Args:
      description: what the script shows; its docstring.
      name: of the study.
      out: default output directory.

    Returns:
      The first exit code that is not 0, else 0.
    """
    parser = argparse.ArgumentParser(description=description, epilog="Options of `jaxlocomanip sweep` may follow.")
    parser.add_argument("--out", default=out, metavar="DIR", help="output directory (default: %(default)s)")
    arguments, others = parser.parse_known_args()
    code = main(["sweep", name, "--out", arguments.out, *others])
    return code or main(["report", arguments.out])


def _run(arguments: argparse.Namespace, command: Sequence[str]) -> None:
    if arguments.command == "simulate":
        simulate.run(arguments)
    elif arguments.command == "sweep":
        sweep.run(arguments, command)
    else:
        {"report": report, "tune": tune, "falsify": falsify, "warmup": warmup}[arguments.command].run(arguments)


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
    commands.add_parser("list", help="name the scenarios of the library and the studies")
    for name, module, text in (
        ("simulate", simulate, "run scenarios in closed loop"),
        ("sweep", sweep, "run a study: many random or systematic scenarios"),
        ("report", report, "tables, figures and recordings of a sweep"),
        ("tune", tune, "adjust the planner's settings to the scenarios of a study"),
        ("falsify", falsify, "search for the scenarios in which the planner keeps the least clearance"),
        ("warmup", warmup, "compile what simulate and sweep will run"),
    ):
        module.add_arguments(commands.add_parser(name, help=text, allow_abbrev=False))
    return parser


def _list() -> None:
    from jaxlocomanip.sampling import study

    groups = {
        "scenarios (jaxlocomanip simulate NAME)": {name: library.describe(name) for name in library.names()},
        "studies (jaxlocomanip sweep NAME --out DIR)": {name: study.describe(name) for name in study.names()},
    }
    width = max(len(name) for group in groups.values() for name in group)
    for title, group in groups.items():
        print(title)
        for name, text in group.items():
            print(f"  {name.ljust(width)}  {text}")


def _set_environment() -> None:
    """Settings that JAX reads from the environment; whatever the user has set stays."""
    # XLA's CPU thread pool has one thread a core, and a pool of few threads can dead-lock.
    os.environ.setdefault("PJRT_NPROC", "16")
    # One device a core: batches are shared among devices, which takes less than sharing each operation among cores.
    os.environ.setdefault("XLA_FLAGS", f"--xla_force_host_platform_device_count={os.cpu_count() or 1}")
    # Compiling takes longer than simulating, so every program is kept for the next call.
    cache = Path(os.environ.get("XDG_CACHE_HOME") or os.path.expanduser("~/.cache"))
    os.environ.setdefault("JAX_COMPILATION_CACHE_DIR", str(cache / "jaxlocomanip" / "xla"))
    os.environ.setdefault("JAX_PERSISTENT_CACHE_MIN_COMPILE_TIME_SECS", "0")


if __name__ == "__main__":
    sys.exit(main())
