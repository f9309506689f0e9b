"""Output files: written whole or not at all, into a directory known to be writable beforehand."""

from __future__ import annotations

import os
import secrets
from pathlib import Path

from jaxlocomanip.checked import InputError


def write_whole(path: str | Path, data: str | bytes) -> None:
    """Write a file of which readers see the old content or the new one, never a part.

    That holds also if the program is interrupted; no temporary file is left behind.

    Args:
      path: file to create or replace; its directory must exist.
      data: content; text is written as UTF-8.

    Raises:
      InputError: the file cannot be written; the text names the path and the reason.
    """
    path = Path(path)
    # In the same directory, since a rename is atomic within one file system only.
    temporary = path.with_name(f".{secrets.token_hex(8)}.tmp")
    try:
        try:
            with temporary.open("xb") as file:
                file.write(data.encode("utf-8") if isinstance(data, str) else data)
                file.flush()
                os.fsync(file.fileno())
            os.replace(temporary, path)
        finally:
            # Gone already after success; the directory itself may be what is missing or unusable.
            if os.path.lexists(temporary):
                temporary.unlink()
    except OSError as error:
        raise InputError(f"{path}: cannot be written ({error.strerror})") from error


def prepare_directory(path: str | Path) -> Path:
    """Create a directory if need be and make sure that files can be written into it.

    Raises:
      InputError: it cannot be created or written into; the text names the path and the reason.
    """
    directory = Path(path)
    if directory.exists() and not directory.is_dir():
        raise InputError(f"{directory}: cannot be used as output directory (it is a file)")
    probe = directory / f".{secrets.token_hex(8)}.tmp"
    try:
        directory.mkdir(parents=True, exist_ok=True)
        # Permission bits say too little (superuser, read-only and virtual file systems).
        probe.touch(exist_ok=False)
        probe.unlink()
    except OSError as error:
        raise InputError(f"{directory}: cannot be used as output directory ({error.strerror})") from error
    return directory
