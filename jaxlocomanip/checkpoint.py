"""Checkpoints of a tuning run: its state after a step, and what it belongs to, in one JSON file."""

from __future__ import annotations

import dataclasses
import hashlib
import json
from pathlib import Path
from typing import Any

import jax
import numpy as np
from numpy.typing import NDArray

from jaxlocomanip.checked import InputError
from jaxlocomanip.files import write_whole

Floats = NDArray[np.floating[Any]]


@dataclasses.dataclass(frozen=True)
class State:
    """What goes from step to step."""

    step: int
    center: Floats
    """[n] logarithms"""
    memory: tuple[Floats, ...]
    """of the optimiser, or [n] the spread"""
    best: Floats
    """[n] logarithms of the least loss that was validated"""
    best_loss: float
    history: tuple[dict[str, float], ...]


def digest(tree: Any) -> str:
    """Tells one batch of scenarios from another."""
    parts = hashlib.sha256()
    for leaf in jax.tree.leaves(tree):
        parts.update(str((np.shape(leaf), np.asarray(leaf).dtype)).encode())
        parts.update(np.ascontiguousarray(leaf).tobytes())
    return parts.hexdigest()


def write(path: Path, about: dict[str, Any], state: State) -> None:
    """A checkpoint, whole."""
    fields = {
        **vars(state),
        "center": state.center.tolist(),
        "memory": [{"dtype": str(leaf.dtype), "values": leaf.tolist()} for leaf in state.memory],
        "best": state.best.tolist(),
    }
    write_whole(path, json.dumps({"about": about, "state": fields}, indent=1) + "\n")


def read(path: Path | None, about: dict[str, Any]) -> State | None:
    """State of a checkpoint; None where there is none.

    Args:
      path: of the file.
      about: what the run is; all of it has to be the same, but for the number of steps among its `settings`.

    Raises:
      InputError: not a checkpoint, one of another run, or of one that has gone farther.
    """
    if path is None or not path.exists():
        return None
    try:
        content = json.loads(path.read_text(encoding="utf-8"))
        before, fields = dict(content["about"]), content["state"]
        state = State(
            int(fields["step"]),
            np.array(fields["center"], float),
            tuple(np.array(leaf["values"], leaf["dtype"]) for leaf in fields["memory"]),
            np.array(fields["best"], float),
            float(fields["best_loss"]),
            tuple(fields["history"]),
        )
        settings = dict(before["settings"])
    except (OSError, ValueError, KeyError, TypeError) as error:
        raise InputError(f"{path}: cannot be read as a checkpoint ({error})") from error
    now = json.loads(json.dumps(about))
    for name in now:
        if name != "settings" and before.get(name) != now[name]:
            raise InputError(f"{path}: is the checkpoint of a run with another {name}; choose another file")
    # More steps than before are what going on is for.
    if {**settings, "steps": 0} != {**now["settings"], "steps": 0}:
        raise InputError(f"{path}: is the checkpoint of a run with other settings; choose another file")
    if state.step > now["settings"]["steps"]:
        raise InputError(f"{path}: has {state.step} steps already, more than {now['settings']['steps']}")
    return state
