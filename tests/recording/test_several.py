"""Several episodes in one file: Rerun reads it and finds a recording for each."""

import subprocess
import sys

import pytest

from jaxlocomanip.checked import InputError
from jaxlocomanip.recording import several
from jaxlocomanip.recording.several import write_recordings


def test_every_episode_is_a_recording_of_its_own(made_up, tmp_path):
    scenario, log = made_up[0], made_up[1].log
    path = tmp_path / "worst.rrd"
    write_recordings(path, [("first", scenario, log), ("second", scenario, log)])
    rerun = [sys.executable, "-m", "rerun", "rrd"]
    subprocess.run([*rerun, "verify", str(path)], check=True, capture_output=True)
    shown = subprocess.run([*rerun, "print", str(path)], check=True, capture_output=True, text=True).stdout
    assert len({line.strip() for line in shown.splitlines() if line.count("-") == 4 and '"' in line}) >= 2
    assert [p.name for p in tmp_path.iterdir()] == ["worst.rrd"]


def test_a_failed_merge_leaves_nothing(made_up, tmp_path, monkeypatch):
    scenario, log = made_up[0], made_up[1].log
    failed = subprocess.CompletedProcess([], 1, "", "no such thing\nbecause\n")
    monkeypatch.setattr(several.subprocess, "run", lambda *_, **__: failed)
    with pytest.raises(InputError, match=r"cannot be merged \(because\)"):
        write_recordings(tmp_path / "worst.rrd", [("first", scenario, log)])
    assert not list(tmp_path.iterdir())
