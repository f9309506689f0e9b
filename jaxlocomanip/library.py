"""Named scenarios: the files of `jaxlocomanip/scenarios`, loaded by name."""

from __future__ import annotations

import importlib.resources
import os
import tomllib
from importlib.resources.abc import Traversable
from pathlib import Path

from jaxlocomanip.checked import InputError, nearest, one_of
from jaxlocomanip.specification import ScenarioSpec, load_scenario, parse_scenario


def names() -> tuple[str, ...]:
    """Names of all scenarios of the library, in alphabetical order."""
    files = (entry.name for entry in _folder().iterdir())
    return tuple(sorted(name.removesuffix(".toml") for name in files if name.endswith(".toml")))


def load(name: str) -> ScenarioSpec:
    """A scenario of the library.

    Raises:
      InputError: unknown name.
    """
    return parse_scenario(tomllib.loads(_text(name)), name)


def describe(name: str) -> str:
    """One line on a scenario of the library: the first line of its file.

    Raises:
      InputError: unknown name.
    """
    return _text(name).partition("\n")[0].removeprefix("#").strip()


def find(name_or_path: str) -> ScenarioSpec:
    """A scenario of the library by its name, else from a file.

    Raises:
      InputError: neither a known name nor a readable, correct file.
    """
    known = names()
    if name_or_path in known:
        return load(name_or_path)
    looks_like_path = name_or_path.endswith(".toml") or os.sep in name_or_path
    if looks_like_path or Path(name_or_path).exists():
        return load_scenario(name_or_path)
    hint = nearest(name_or_path, known)
    raise InputError(f"scenario = {name_or_path!r}: must be a file or one of {', '.join(known)}{hint}")


def _folder() -> Traversable:
    return importlib.resources.files("jaxlocomanip").joinpath("scenarios")


def _text(name: str) -> str:
    file = f"{one_of('scenario', name, names())}.toml"
    return _folder().joinpath(file).read_text(encoding="utf-8")
