"""`jaxlocomanip tune`: settings of the planner adjusted to the scenarios of a study, and kept as a file."""

from __future__ import annotations

import argparse
import math
from functools import partial

from jaxlocomanip.commands import options
from jaxlocomanip.commands.options import say
from jaxlocomanip.files import prepare_directory, write_whole


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Arguments of the command."""
    add, count = parser.add_argument, partial(options.add_count, parser)
    add("study", metavar="STUDY", help="name of a study or path of a TOML file; its teams must have one size")
    add(
        "--out",
        required=True,
        metavar="DIR",
        help="tuned.toml, for --config, and tune.json, from which the same command goes on",
    )
    add("--config", default="robust", help="settings to start from: robust (default), paper, or a TOML file")
    add(
        "--tune",
        action="append",
        metavar="NAME",
        help="setting or group to tune, such as constraints.margin or weights; may be repeated (default: weights, "
        "constraints, and gain, low_pass and prior_friction of the adaptation)",
    )
    add("--method", default="gradient", help="gradient (default; needs the tune extra), or cem, without gradients")
    count("--steps", 40, "changes of the settings; a larger number goes on with a run that has ended")
    count("--batch", 8, "training scenarios that each step sees, drawn at random")
    add(
        "--rate",
        type=options.fraction,
        default=0.2,
        metavar="R",
        help="length of a gradient step, in logarithms of the settings (default: %(default)s)",
    )
    count("--train", 64, "training scenarios: the first N of the study")
    count("--held-out", 32, "scenarios of later draws, never trained on, by which the best settings are chosen")
    add("--seed", type=options.seed, default=0, help="of the scenarios and of the steps (default: %(default)s)")


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
    from jaxlocomanip.sweep.plan import longest, padding
    from jaxlocomanip.tuning import METHODS, NAMES, Settings, Tuned, tune

    study, config = options.planar_study(arguments.study), named_config(arguments.config)
    settings = Settings(
        names=tuple(arguments.tune or NAMES),
        method=checked.one_of("method", arguments.method, METHODS),
        steps=arguments.steps,
        rate=arguments.rate,
        batch=arguments.batch,
        seed=arguments.seed,
    )
    knobs = knobs_of(config, settings.names)
    out = prepare_directory(arguments.out)
    say(f"{study.name}: {len(knobs.names)} settings, {arguments.train} + {arguments.held_out} scenarios\n")
    # Points of a study share their draws: what is held out begins with a draw that no training scenario has.
    points = len(study.points)
    first = math.ceil(arguments.train / points) * points
    drawn = [*range(arguments.train), *range(first, first + arguments.held_out)]
    lanes = [draw(study, arguments.seed, k).scenario for k in drawn]

    def keep(tuned: Tuned) -> None:
        write_whole(out / "tuned.toml", config_to_toml(tuned.config))

    tuned = tune(
        config,
        stack(lanes[: arguments.train], padding(study)),
        stack(lanes[arguments.train :], padding(study)),
        ticks=math.ceil(longest(study) / config.horizon.tick - 1e-6),
        settings=settings,
        checkpoint=out / "tune.json",
        say=lambda text: say(f"{text}\n"),
        kept=keep,
    )
    keep(tuned)
    before = tuned.history[0]["held_out"]
    print(f"loss on the held-out scenarios, by which the best was chosen: {before:.4g} before, {tuned.loss:.4g} after")
    for name, (old, new) in changes(config, tuned.config, knobs).items():
        print(f"  {name}: {old:.4g} -> {new:.4g}")
