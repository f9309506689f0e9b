"""`jaxlocomanip falsify`: a search for the scenarios in which the planner keeps the least clearance."""

from __future__ import annotations

import argparse
import json
import re
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING

from jaxlocomanip.checked import InputError
from jaxlocomanip.commands import options
from jaxlocomanip.commands.options import refuse_missing_viewers, say
from jaxlocomanip.files import prepare_directory, write_whole

if TYPE_CHECKING:
    from jaxlocomanip.planner.config import PlannerConfig
    from jaxlocomanip.random_worst import Falsified
    from jaxlocomanip.trials import Found

DRAWN = 10
"""random scenarios among which one to begin with is chosen"""
ROUNDS = 4
"""of scenarios with an obstacle in the way"""
ROWS = ("seed", "clearance", "team_clearance", "hit_obstacle", "robots_touched", "run_over", "reached")
"""what `worst.json` tells of a scenario"""


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Arguments of the command."""
    add, count = parser.add_argument, partial(options.add_count, parser)
    add("study", metavar="STUDY", help="name of a study or path of a TOML file; its teams must have one size")
    add("--out", required=True, metavar="DIR", help="the worst scenarios as TOML files, and worst.json")
    options.add_planner(parser)
    count("--screened", 16, "the most promising of 10 times as many random scenarios (at least 160), to begin with")
    count("--aimed", 8, "scenarios retried in each of four rounds with an obstacle moved into the object's way")
    count("--lanes", 8, "worst scenarios to keep, and to improve by gradients of the clearance at the end")
    count("--rounds", 4, "gradients of each scenario kept, one after the other")
    add("--random", action="store_true", help="no search: as many random scenarios as it would cost episodes")
    add("--seed", type=options.seed, default=0, help="of scenarios and measurement noise (default: %(default)s)")
    add("--record", type=options.positive, metavar="N", help="run the N worst again and record them to DIR/worst.rrd")


def run(arguments: argparse.Namespace) -> None:
    """Search, with progress on standard error and a table of the worst on standard output.

    Raises:
      InputError: bad input, before anything is compiled.
    """
    for name in ("aimed", "lanes"):
        if getattr(arguments, name) > arguments.screened:
            limit = f"must not exceed --screened, which is {arguments.screened}"
            raise InputError(f"argument --{name}: {getattr(arguments, name)} {limit}")
    refuse_missing_viewers(record=arguments.record is not None)

    from jaxlocomanip import config_file
    from jaxlocomanip.falsification import Search, falsify
    from jaxlocomanip.random_worst import sample_worst

    study = options.planar_study(arguments.study)
    config = config_file.without(config_file.named_config(arguments.config), arguments.without)
    out = prepare_directory(arguments.out)
    search = Search(
        drawn=max(Search.drawn, DRAWN * arguments.screened),
        screened=arguments.screened,
        aimed=(arguments.aimed,) * ROUNDS,
        lanes=arguments.lanes,
        rounds=arguments.rounds,
    )
    say(f"{study.name}: {search.episodes} episodes\n")
    # What is there after every stage is written, so that an interrupted search leaves it.
    if arguments.random:
        found = sample_worst(study, config, search.episodes, arguments.seed, arguments.lanes, kept=partial(_keep, out))
    else:
        found = falsify(
            study, config, arguments.seed, search, say=lambda text: say(f"{text}\n"), kept=partial(_keep, out)
        )
    _list(found)
    if arguments.record:
        _record(out / "worst.rrd", config, found.worst[: arguments.record])


def _keep(out: Path, found: Falsified) -> None:
    """Write the scenarios, and what came of them."""
    from jaxlocomanip.scenario_file import scenario_to_toml

    rows = []
    for number, one in enumerate(found.worst):
        write_whole(out / _file(number), scenario_to_toml(one.spec))
        rows.append(
            {
                "file": _file(number),
                "scenario": one.spec.name,
                **{name: getattr(one, name) for name in ROWS},
            }
        )
    _remove_others(out, {str(row["file"]) for row in rows})
    counts = {name: getattr(found, name) for name in ("episodes", "collisions", "touches", "counted")}
    write_whole(out / "worst.json", json.dumps({**counts, "worst": rows}, indent=2) + "\n")


def _remove_others(out: Path, names: set[str]) -> None:
    """Delete what a search before left and this one does not replace: more scenarios, and their recording."""
    for path in out.iterdir():
        if re.fullmatch(r"worst-\d\d+\.toml|worst\.rrd", path.name) and path.name not in names:
            path.unlink()


def _file(number: int) -> str:
    return f"worst-{number:02d}.toml"


def _list(found: Falsified) -> None:
    """Print the scenarios, and how many collided."""
    for number, one in enumerate(found.worst):
        verdict = "run over" if one.run_over else "collided" if one.hit_obstacle else "clear"
        verdict += ", robots touched" if one.robots_touched else ""
        print(f"{_file(number)}  {one.spec.name}  clearance {one.clearance:7.3f} m  {verdict}  --seed {one.seed}")
    kept = len(found.worst)
    of = f"{found.counted} episodes" if found.counted > kept else f"the {kept} scenarios kept"
    print(f"{found.collisions} of {of} collided with an obstacle, in {found.touches} robots touched each other")
    print(f"{found.episodes} episodes, of which the {kept} worst are kept")


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
