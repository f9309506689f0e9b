"""`jaxlocomanip tune`: settings of the planner adjusted to the scenarios of a study, and kept as a file."""

from __future__ import annotations

import argparse
import math

from jaxlocomanip.commands import options
from jaxlocomanip.commands.options import say
from jaxlocomanip.files import prepare_directory, write_whole


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Arguments of the command."""
    add = parser.add_argument
    add("study", metavar="STUDY", help="name of a study or path of a TOML file; its teams must have one size")
    add("--out", required=True, metavar="DIR", help="tuned.toml, for --config, and tune.json; stopped runs go on")
    add("--config", default="robust", help="settings to start from: robust (default), paper, or a TOML file")
    add("--tune", action="append", metavar="NAME", help="setting or group to tune, such as weights; may be repeated")
    add("--method", default="gradient", help="gradient (default) or cem, which needs no gradients")
    add("--steps", type=options.positive, default=40, help="(default: %(default)s)")
    add("--batch", type=options.positive, default=8, help="scenarios of a step (default: %(default)s)")
    add("--train", type=options.positive, default=64, help="scenarios to learn from (default: %(default)s)")
    add("--held-out", type=options.positive, default=32, help="scenarios to choose by (default: %(default)s)")
    add("--seed", type=options.seed, default=0, help="of scenarios and steps (default: %(default)s)")


def run(arguments: argparse.Namespace) -> None:
    """Tune, with progress on standard error and the change of each setting on standard output.

    Raises:
      InputError: bad input, before anything is compiled.
    """
    from jaxlocomanip import checked
    from jaxlocomanip.config_file import config_to_toml, named_config
    from jaxlocomanip.knobs import changes, knobs_of
    from jaxlocomanip.padding import stack
    from jaxlocomanip.sampling.sampler import draw
    from jaxlocomanip.sampling.study import find_study
    from jaxlocomanip.sweep.plan import longest, padding
    from jaxlocomanip.tuning import METHODS, NAMES, Settings, tune

    study, config = find_study(arguments.study), named_config(arguments.config)
    settings = Settings(
        names=tuple(arguments.tune or NAMES),
        method=checked.one_of("method", arguments.method, METHODS),
        steps=arguments.steps,
        batch=arguments.batch,
        seed=arguments.seed,
    )
    knobs = knobs_of(config, settings.names)
    out = prepare_directory(arguments.out)
    say(f"{study.name}: {len(knobs.names)} settings, {arguments.train} + {arguments.held_out} scenarios\n")
    lanes = [draw(study, arguments.seed, k).scenario for k in range(arguments.train + arguments.held_out)]
    tuned = tune(
        config,
        stack(lanes[: arguments.train], padding(study)),
        stack(lanes[arguments.train :], padding(study)),
        ticks=math.ceil(longest(study) / config.horizon.tick - 1e-6),
        settings=settings,
        checkpoint=out / "tune.json",
        say=lambda text: say(f"{text}\n"),
    )
    write_whole(out / "tuned.toml", config_to_toml(tuned.config))
    print(f"loss on the held-out scenarios: {tuned.history[0]['held_out']:.4g} before, {tuned.loss:.4g} after")
    for name, (before, after) in changes(config, tuned.config, knobs).items():
        print(f"  {name}: {before:.4g} -> {after:.4g}")
