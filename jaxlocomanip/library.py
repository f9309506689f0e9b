"""Named scenarios: the files of `jaxlocomanip/scenarios`, loaded by name."""

from __future__ import annotations

import tomllib

from jaxlocomanip.packaged import Files, is_name
from jaxlocomanip.specification import ScenarioSpec, load_scenario, parse_scenario

_SCENARIOS = Files("scenario", "scenarios")


def names() -> tuple[str, ...]:
    """Names of all scenarios of the library, in alphabetical order."""
    return _SCENARIOS.names()


def load(name: str) -> ScenarioSpec:
    """A scenario of the library.

    Raises:
      InputError: unknown name.
    """
    return parse_scenario(tomllib.loads(_SCENARIOS.text(name)), name)


def describe(name: str) -> str:
    """One line on a scenario of the library: the first line of its file.

    Raises:
      InputError: unknown name.
    """
    return _SCENARIOS.describe(name)


def find(name_or_path: str) -> ScenarioSpec:
    """A scenario of the library by its name, else from a file.

    Raises:
      InputError: neither a known name nor a readable, correct file.
    """
    return load(name_or_path) if is_name("scenario", name_or_path, names()) else load_scenario(name_or_path)
