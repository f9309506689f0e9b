"""The directory of a sweep: a manifest, one file for each finished piece of work, and the joined results.

    DIR/manifest.json     everything needed to repeat the sweep, and what was rejected
    DIR/chunks/*.parquet  finished pieces, each written whole; they are gone once they are joined
    DIR/results.parquet   one row a scenario and planner

A program that is killed at any moment leaves only whole files, and the same command goes on after the last of them.
"""

from __future__ import annotations

import contextlib
import hashlib
import importlib.metadata
import importlib.util
import io
import json
import platform
from collections.abc import Iterator, Mapping, Sequence
from pathlib import Path
from types import MappingProxyType
from typing import TYPE_CHECKING, Any

import jaxlocomanip
from jaxlocomanip.checked import InputError, installing
from jaxlocomanip.files import prepare_directory, write_whole
from jaxlocomanip.sweep.rows import COLUMNS, Columns

if TYPE_CHECKING:
    import pyarrow

MANIFEST, RESULTS, CHUNKS, LOCK = "manifest.json", "results.parquet", "chunks", ".lock"
"""Names within the directory."""


def refuse_missing_parquet() -> None:
    """Tables need pyarrow.

    Raises:
      InputError: it is not installed.
    """
    if importlib.util.find_spec("pyarrow") is None:
        raise InputError(f"sweeps need the sweep extra: {installing('sweep')}")


def versions() -> dict[str, str]:
    """Versions that results depend on."""
    found = {name: importlib.metadata.version(name) for name in ("jax", "jaxlib", "numpy")}
    return {"jaxlocomanip": jaxlocomanip.__version__, "python": platform.python_version(), **found}


def code_digest() -> str:
    """A fingerprint of the package's source, so that rows of different states of it never mix."""
    folder = Path(jaxlocomanip.__file__).parent
    digest = hashlib.sha256()
    for path in sorted(folder.rglob("*")):
        if path.suffix in (".py", ".xml", ".toml"):
            digest.update(path.relative_to(folder).as_posix().encode() + b"\0" + path.read_bytes())
    return digest.hexdigest()[:16]


class Store:
    """The directory of one sweep, held by one program at a time."""

    def __init__(self, directory: str | Path, settings: Mapping[str, Any]) -> None:
        """Begin a sweep, or go on with the same one.

        Args:
          directory: created if need be.
          settings: what the rows depend on; JSON values.

        Raises:
          InputError: the directory cannot be used, or holds a sweep with other settings.
        """
        self.directory = prepare_directory(directory)
        self._chunks = prepare_directory(self.directory / CHUNKS) if not self.complete else self.directory / CHUNKS
        self._settings = MappingProxyType(dict(settings))
        if (self.directory / MANIFEST).exists():
            _refuse_other(self.directory, read_manifest(self.directory)["settings"], self._settings)
        elif (self.directory / RESULTS).exists() or any(self._chunks.iterdir()):
            raise InputError(f"{self.directory}: holds results without a {MANIFEST}; choose another directory")

    @property
    def complete(self) -> bool:
        """Whether the results are joined already."""
        return (self.directory / RESULTS).exists()

    def finished(self) -> Mapping[str, Any] | None:
        """The manifest of a sweep of which nothing is left to do."""
        manifest = read_manifest(self.directory) if self.complete and (self.directory / MANIFEST).exists() else {}
        return manifest if manifest.get("complete") else None

    def done(self) -> set[str]:
        """Keys of the finished pieces."""
        return {path.stem for path in self._chunks.glob("*.parquet") if not path.name.startswith(".")}

    def keep(self, key: str, columns: Columns) -> None:
        """Write the rows of a finished piece, whole."""
        self.keep_bytes(key, to_parquet(columns))

    def keep_bytes(self, key: str, content: bytes) -> None:
        """Write a finished piece that is Parquet already."""
        write_whole(self._chunks / f"{key}.parquet", content)

    def describe(self, about: Mapping[str, Any]) -> None:
        """Write the manifest."""
        text = json.dumps({"settings": dict(self._settings), **about}, indent=2, allow_nan=False)
        write_whole(self.directory / MANIFEST, text + "\n")

    def join(self, keys: Sequence[str]) -> pyarrow.Table:
        """Write the results of all pieces, and remove the pieces once those are safe.

        Returns:
          The results, sorted by planner and lane.
        """
        import pyarrow
        from pyarrow import parquet

        if not self.complete:
            tables = [parquet.read_table(self._chunks / f"{key}.parquet") for key in keys]
            table = pyarrow.concat_tables(tables)
            buffer = io.BytesIO()
            parquet.write_table(_sorted(table), buffer, compression="zstd")
            write_whole(self.directory / RESULTS, buffer.getvalue())
        for path in self._chunks.iterdir() if self._chunks.exists() else ():
            path.unlink()
        with contextlib.suppress(FileNotFoundError):
            self._chunks.rmdir()
        return read_results(self.directory)

    @contextlib.contextmanager
    def held(self) -> Iterator[None]:
        """Keep other programs out of the directory; the operating system lets go of it if this one is killed.

        Raises:
          InputError: another program is at work in it.
        """
        try:
            import fcntl
        except ImportError:  # not on this system: two programs at once are the user's care
            yield
            return
        with (self.directory / LOCK).open("w") as file:
            try:
                fcntl.flock(file, fcntl.LOCK_EX | fcntl.LOCK_NB)
            except OSError:
                raise InputError(f"{self.directory}: another sweep is writing into it") from None
            for path in self._chunks.glob(".*.tmp") if self._chunks.exists() else ():
                path.unlink()  # of a program that was killed while it wrote
            yield


def _refuse_other(directory: Path, before: Mapping[str, Any], now: Mapping[str, Any]) -> None:
    """Refuse to mix results of different settings."""
    for field, value in now.items():
        if field in before and before[field] == json.loads(json.dumps(value)):
            continue
        old = before.get(field)
        if isinstance(value, str | int | float | None) and "\n" not in str(value) + str(old):
            difference = f"{field} = {old!r} there and {value!r} here"
        else:
            difference = f"{field} there and here differ"
        raise InputError(f"{directory}: holds a sweep with other settings ({difference}); choose another directory")


def read_manifest(directory: str | Path) -> dict[str, Any]:
    """The manifest of a sweep.

    Raises:
      InputError: there is none, or it is damaged.
    """
    path = Path(directory) / MANIFEST
    try:
        return json.loads(path.read_text(encoding="utf-8"))
    except OSError as error:
        raise InputError(f"{path}: cannot be read ({error.strerror}); is {directory} the --out of a sweep?") from error
    except ValueError as error:
        raise InputError(f"{path}: is damaged ({error})") from error


def read_results(directory: str | Path) -> pyarrow.Table:
    """The results of a sweep, as far as it has come.

    Raises:
      InputError: there are none, or the files are damaged.
    """
    import pyarrow
    from pyarrow import parquet

    folder = Path(directory)
    paths = [folder / RESULTS] if (folder / RESULTS).exists() else sorted((folder / CHUNKS).glob("[!.]*.parquet"))
    if not paths:
        raise InputError(f"{folder}: holds no results yet")
    try:
        return _sorted(pyarrow.concat_tables([parquet.read_table(path) for path in paths]))
    except (OSError, pyarrow.ArrowInvalid) as error:
        raise InputError(f"{folder}: results cannot be read ({error})") from error


def _sorted(table: pyarrow.Table) -> pyarrow.Table:
    return table.sort_by([("variant_number", "ascending"), ("lane", "ascending")])


def to_parquet(columns: Columns) -> bytes:
    """Columns as the bytes of a Parquet file, with the types of `rows.COLUMNS`."""
    import pyarrow
    from pyarrow import parquet

    plain = {
        "int64": pyarrow.int64(),
        "float64": pyarrow.float64(),
        "bool": pyarrow.bool_(),
        "string": pyarrow.string(),
        "list of float64": pyarrow.list_(pyarrow.float64()),
        "list of string": pyarrow.list_(pyarrow.string()),
    }
    arrays = [pyarrow.array(columns[name], plain[kind]) for name, kind in COLUMNS.items()]
    buffer = io.BytesIO()
    parquet.write_table(pyarrow.table(arrays, names=list(COLUMNS)), buffer, compression="zstd")
    return buffer.getvalue()
