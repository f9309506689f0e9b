"""`jaxlocomanip falsify`: a search for the scenarios in which the planner keeps the least clearance."""

from __future__ import annotations

import argparse
import json
from pathlib import Path
from typing import TYPE_CHECKING

from jaxlocomanip.commands import options
from jaxlocomanip.commands.options import refuse_missing_viewers, say
from jaxlocomanip.files import prepare_directory, write_whole

if TYPE_CHECKING:
    from jaxlocomanip.falsification import Falsified, Found
    from jaxlocomanip.planner.config import PlannerConfig


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Arguments of the command."""
    add = parser.add_argument
    add("study", metavar="STUDY", help="name of a study or path of a TOML file; its teams must have one size")
    add("--out", required=True, metavar="DIR", help="the worst scenarios as TOML files, and worst.json")
    options.add_planner(parser)
    add("--screened", type=options.positive, default=16, help="random scenarios to begin with (default: %(default)s)")
    add(
        "--aimed",
        type=options.positive,
        default=8,
        help="with an obstacle in the way, four times (default: %(default)s)",
    )
    add("--lanes", type=options.positive, default=8, help="the worst, improved by gradients (default: %(default)s)")
    add("--rounds", type=options.positive, default=1, help="gradients of each (default: %(default)s)")
    add("--random", action="store_true", help="only random scenarios, as many episodes as the search would cost")
    add("--seed", type=options.seed, default=0, help="of scenarios and noise (default: %(default)s)")
    add("--record", type=options.positive, metavar="N", help="record the N worst to worst.rrd")


def run(arguments: argparse.Namespace) -> None:
    """Search, with progress on standard error and a table of the worst on standard output.

    Raises:
      InputError: bad input, before anything is compiled.
    """
    refuse_missing_viewers(record=arguments.record is not None)

    from jaxlocomanip import config_file
    from jaxlocomanip.falsification import Search, falsify, sample_worst
    from jaxlocomanip.sampling.study import find_study

    study = find_study(arguments.study)
    config = config_file.without(config_file.named_config(arguments.config), arguments.without)
    out = prepare_directory(arguments.out)
    search = Search(
        screened=arguments.screened,
        aimed=(arguments.aimed,) * 4,
        lanes=arguments.lanes,
        rounds=arguments.rounds,
    )
    say(f"{study.name}: {search.episodes} episodes\n")
    if arguments.random:
        found = sample_worst(study, config, search.episodes, arguments.seed, keep=arguments.lanes)
    else:
        found = falsify(study, config, arguments.seed, search, say=lambda text: say(f"{text}\n"))
    _keep(out, found)
    if arguments.record:
        _record(out / "worst.rrd", config, found.worst[: arguments.record])


def _keep(out: Path, found: Falsified) -> None:
    """Write the scenarios, and list them."""
    from jaxlocomanip.scenario_file import scenario_to_toml

    rows = []
    for number, one in enumerate(found.worst):
        name = f"worst-{number:02d}.toml"
        write_whole(out / name, scenario_to_toml(one.spec))
        rows.append(
            {
                "file": name,
                "scenario": one.spec.name,
                **{k: v for k, v in vars(one).items() if k not in ("spec", "motion")},
            }
        )
        verdict = "run over" if one.run_over else "collided" if one.collided else "clear"
        print(f"{name}  {one.spec.name}  clearance {one.clearance:7.3f} m  {verdict}  --seed {one.seed}")
    summary = {"episodes": found.episodes, "collisions": found.collisions, "worst": rows}
    write_whole(out / "worst.json", json.dumps(summary, indent=2) + "\n")
    print(f"{found.collisions} of {len(found.worst)} collided, after {found.episodes} episodes")


def _record(path: Path, config: PlannerConfig, worst: tuple[Found, ...]) -> None:
    """Run scenarios again, with trajectories, and write them to one file."""
    from jaxlocomanip.build import build
    from jaxlocomanip.closed_loop import simulate
    from jaxlocomanip.recording.several import write_recordings

    episodes = []
    for one in worst:
        scenario = build(one.spec)
        result = simulate(scenario, config, seed=one.seed)
        if result.log is not None:
            episodes.append((one.spec.name, scenario, result.log))
    write_recordings(path, episodes)
    say(f"{path}\n")
