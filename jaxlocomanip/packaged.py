"""TOML files that come with the package, known by name, and arguments that take such a name or the path of a file."""

from __future__ import annotations

import importlib.resources
import os
from collections.abc import Iterable
from dataclasses import dataclass
from importlib.resources.abc import Traversable
from pathlib import Path

from jaxlocomanip.checked import InputError, nearest, one_of


@dataclass(frozen=True)
class Files:
    """The TOML files in one folder of the package, by their names without the ending."""

    field: str
    """what refusals call a name of theirs"""
    folder: str

    def names(self) -> tuple[str, ...]:
        """All names, in alphabetical order."""
        files = (entry.name for entry in self._folder().iterdir())
        return tuple(sorted(name.removesuffix(".toml") for name in files if name.endswith(".toml")))

    def text(self, name: str) -> str:
        """The content of a file.

        Raises:
          InputError: unknown name.
        """
        file = f"{one_of(self.field, name, self.names())}.toml"
        return self._folder().joinpath(file).read_text(encoding="utf-8")

    def describe(self, name: str) -> str:
        """One line on a file: its first, a comment.

        Raises:
          InputError: unknown name.
        """
        return self.text(name).partition("\n")[0].removeprefix("#").strip()

    def _folder(self) -> Traversable:
        return importlib.resources.files("jaxlocomanip").joinpath(self.folder)


def is_name(field: str, name_or_path: str, known: Iterable[str]) -> bool:
    """Whether a text is one of the known names; otherwise it is the path of a file, which need not be there.

    Args:
      field: what a refusal calls the text.
      name_or_path: a path ends in `.toml`, has a separator in it, or exists.
      known: names.

    Raises:
      InputError: neither.
    """
    names = list(known)
    if name_or_path in names:
        return True
    if name_or_path.endswith(".toml") or os.sep in name_or_path or Path(name_or_path).exists():
        return False
    hint = nearest(name_or_path, names)
    raise InputError(f"{field} = {name_or_path!r}: must be a file or one of {', '.join(names)}{hint}")
