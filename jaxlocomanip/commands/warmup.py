"""`jaxlocomanip warmup`: compile what `simulate` and `sweep` will run, so that they start from the cache."""

from __future__ import annotations

import argparse
import os
import time
from collections.abc import Callable, Iterator
from typing import TYPE_CHECKING

from jaxlocomanip import library
from jaxlocomanip.commands import options
from jaxlocomanip.commands.options import say

if TYPE_CHECKING:
    from jaxlocomanip.planner.config import PlannerConfig
    from jaxlocomanip.sweep.plan import Plan

SCENARIO, STUDY = "adaptive", "standard"
"""compiled if nothing is named"""
Program = tuple[str, Callable[[], object]]
"""What a program is for, and what compiles it."""


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Arguments of the command."""
    add = parser.add_argument
    add("scenarios", nargs="*", metavar="SCENARIO", help="name in the library or path of a TOML file, as for simulate")
    add("--study", action="append", default=[], metavar="STUDY", help="name of a study or TOML file; may be repeated")
    add("--world", help="world to simulate in: planar or quadruped (default: planar, or that of the study)")
    options.add_backend(parser)
    options.add_planner(parser)
    add("--chunk", type=options.positive, help="scenarios in one compiled batch (default: that of the study)")


def run(arguments: argparse.Namespace) -> None:
    """Compile, with progress on standard error and a table of seconds on standard output.

    Raises:
      InputError: bad input, before anything is compiled.
    """
    from jaxlocomanip.tables import aligned

    lines = [("program", "compiled in")]
    for name, compiles in _programs(arguments):
        say(f"{name}: compiling... ")
        start = time.perf_counter()
        compiles()
        taken = f"{time.perf_counter() - start:.1f} s"
        say(f"{taken}\n")
        lines.append((name, taken))
    print(aligned(lines))
    print(f"kept in {os.environ.get('JAX_COMPILATION_CACHE_DIR') or 'no cache: JAX_COMPILATION_CACHE_DIR is empty'}")


def _programs(arguments: argparse.Namespace) -> list[Program]:
    """Everything that is to be compiled, checked."""
    from jaxlocomanip.sampling.study import find_study

    nothing = not arguments.scenarios and not arguments.study
    specs = [library.find(name) for name in ([SCENARIO] if nothing else arguments.scenarios)]
    studies = [find_study(name) for name in ([STUDY] if nothing else arguments.study)]

    from jaxlocomanip import config_file
    from jaxlocomanip.build import build
    from jaxlocomanip.closed_loop import load_world
    from jaxlocomanip.sweep.plan import plan_sweep

    config = config_file.named_config(arguments.config)
    plans = [
        plan_sweep(
            study,
            config,
            world=arguments.world,
            backend=arguments.backend,
            chunk=arguments.chunk,
            without=arguments.without,
        )
        for study in studies
    ]
    single = config_file.without(config, arguments.without)
    world = arguments.world or "planar"
    if specs:
        load_world(world, arguments.backend, batched=False)
    programs = [(f"simulate {spec.name}", _alone(build(spec), single, world, arguments.backend)) for spec in specs]
    return [*programs, *(program for plan in plans for program in _of_a_sweep(plan))]


def _alone(scenario: object, config: PlannerConfig, world: str, backend: str | None) -> Callable[[], object]:
    def compiles() -> object:
        from jaxlocomanip.closed_loop import compiled

        return compiled(scenario, config, world, backend=backend, record=True)  # pyright: ignore[reportArgumentType]

    return compiles


def _of_a_sweep(plan: Plan) -> Iterator[Program]:
    """One program for each planner and size of team."""
    from jaxlocomanip.batch import Runner
    from jaxlocomanip.sampling.layout import team_size
    from jaxlocomanip.sampling.sampler import draw

    runner = Runner(plan.world, plan.backend)
    firsts = {team_size(plan.study, plan.seed, chunk.lanes[0]): chunk.lanes[0] for chunk in reversed(plan.chunks)}
    for size, lane in sorted(firsts.items()):
        for planner in plan.planners:
            named = f", {planner.name}" if planner.name else ""
            robots = f"{size} robot" + ("s" if size > 1 else "")

            def compiles(lane: int = lane, config: PlannerConfig = planner.config) -> None:
                # One lane is enough: it is repeated, and only shapes matter.
                runner.prepare([draw(plan.study, plan.seed, lane).scenario], config, plan.shape)

            yield f"sweep {plan.study.name}, {robots}{named}, {plan.shape.lanes} lanes", compiles
