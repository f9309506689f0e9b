"""Several episodes in one Rerun recording file."""

from __future__ import annotations

import subprocess
import sys
import tempfile
from collections.abc import Sequence
from pathlib import Path

from jaxlocomanip.checked import InputError
from jaxlocomanip.files import write_whole
from jaxlocomanip.loop import Log
from jaxlocomanip.recording.rerun import write_recording
from jaxlocomanip.scenario import Scenario


def write_recordings(path: Path, episodes: Sequence[tuple[str, Scenario, Log]]) -> None:
    """Write episodes as one .rrd file, in which the viewer shows one recording for each; whole or not at all.

    Args:
      path: the .rrd file; an existing one is replaced.
      episodes: name, scenario and trajectory of each, without batch axis; at least one.

    Raises:
      InputError: Rerun is not installed, or the file cannot be written.
    """
    with tempfile.TemporaryDirectory() as folder:
        parts = [Path(folder) / f"{i:04d}.rrd" for i in range(len(episodes))]
        for part, (name, scenario, log) in zip(parts, episodes, strict=True):
            write_recording(part, name, scenario, log)
        merged = Path(folder) / "merged.rrd"
        # A file with several recordings has one index, which only Rerun's own tool can make.
        command = [sys.executable, "-m", "rerun", "rrd", "merge", *map(str, parts), "-o", str(merged)]
        done = subprocess.run(command, capture_output=True, check=False, text=True)
        if done.returncode != 0 or not merged.exists():
            reason = (done.stderr.strip().splitlines() or ["unknown reason"])[-1]
            raise InputError(f"{path}: recordings cannot be merged ({reason})")
        write_whole(path, merged.read_bytes())
