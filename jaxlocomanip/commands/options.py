"""Arguments that several commands share, what they refuse alike, and their progress."""

from __future__ import annotations

import argparse
import importlib.util
import math
import sys
from typing import TYPE_CHECKING

from jaxlocomanip.checked import SEED_LIMIT, InputError, installing

if TYPE_CHECKING:
    from jaxlocomanip.sampling.study import Study


def seed(text: str) -> int:
    """A seed, for argparse."""
    return whole(text, 0, SEED_LIMIT)


def positive(text: str) -> int:
    """A count, for argparse."""
    return whole(text, 1, 10**7)


def whole(text: str, low: int, high: int) -> int:
    """A whole number in a range, for argparse."""
    if not text.isascii() or not text.isdigit() or len(text) > 10 or not low <= int(text) <= high:
        raise argparse.ArgumentTypeError(f"{text!r} must be a whole number from {low} to {high}")
    return int(text)


def fraction(text: str) -> float:
    """A number above 0 and up to 1, for argparse."""
    try:
        value = float(text)
    except ValueError:
        value = math.nan
    if not 0.0 < value <= 1.0:
        raise argparse.ArgumentTypeError(f"{text!r} must be a number > 0 and <= 1")
    return value


def add_count(parser: argparse.ArgumentParser, name: str, default: int, text: str) -> None:
    """A count with a default, which its help names."""
    parser.add_argument(name, type=positive, default=default, metavar="N", help=f"{text} (default: %(default)s)")


def add_backend(parser: argparse.ArgumentParser) -> None:
    """`--backend`."""
    parser.add_argument("--backend", help="physics of the quadruped world: c (MuJoCo) or mjx (for batches)")


def add_planner(parser: argparse.ArgumentParser) -> None:
    """`--config` and `--without`."""
    parser.add_argument("--config", default="robust", help="planner settings: robust (default), paper, or a TOML file")
    parser.add_argument(
        "--without",
        action="append",
        default=[],
        metavar="FEATURE",
        help="switch off adaptation, robot-cbf, object-cbf, clf, path, faces or filter; may be repeated",
    )


def refuse_missing_viewers(record: bool, hint: str = "") -> bool:
    """Whether figures can be drawn; what a recording needs must be there if one is asked for.

    Args:
      record: a recording is asked for.
      hint: what else the user may do, for the end of the refusal.

    Raises:
      InputError: it is not.
    """
    drawable = importlib.util.find_spec("matplotlib") is not None
    if record and not (drawable and importlib.util.find_spec("rerun") is not None):
        raise InputError(f"recording needs the view extra: {installing('view')}{hint}")
    return drawable


def planar_study(name: str) -> Study:
    """A study whose scenarios alone are meant, in the planar world.

    Raises:
      InputError: it does not exist, or asks for another world or for planners of its own, which would not be used.
    """
    from jaxlocomanip.sampling.study import find_study

    study = find_study(name)
    if study.world != "planar":
        raise InputError(f"study '{study.name}': world = {study.world!r}: must be planar for this command")
    if study.data.get("variants"):
        raise InputError(f"study '{study.name}': has variants, which this command does not try; say --config instead")
    return study


def say(text: str) -> None:
    """Progress, visible at once."""
    print(text, end="", file=sys.stderr, flush=True)
