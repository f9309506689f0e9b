"""The quadruped world: robots with legs walk up to the object and push it; it moves only by contact.

The physics is MuJoCo's: stepped in C for one scenario (`quadruped_c`), or by MJX inside the compiled closed loop for
batches (`quadruped_mjx`). What the robots do is the same in both (`quadruped_team`).
"""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

from jaxlocomanip.worlds.interface import World


def world(backend: str, mjcfs: Sequence[str | Path] | None = None) -> World:
    """The quadruped world on a physics engine.

    Args:
      backend: `c` or `mjx`.
      mjcfs: model file of each robot, with the names of the packaged ones (`worlds.legged.read_robot`), instead of the
        models of the team's types; the planner goes on with the sizes and limits of the types.
    """
    files = None if mjcfs is None else tuple(str(path) for path in mjcfs)
    # Imported when they are asked for: MJX takes seconds to start, and one scenario in MuJoCo C does without.
    if backend == "mjx":
        from jaxlocomanip.worlds.quadruped_mjx import MjxWorld

        return MjxWorld(mjcfs=files)
    from jaxlocomanip.worlds.quadruped_c import CWorld

    return CWorld(mjcfs=files)
