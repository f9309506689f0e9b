"""Walking to other faces: when the team is asked to, and what the planner forgets when it does.

A path that leads to such a place (`path.Aim`) is followed as one to the goal, up to the team's coming to rest there.
"""

from __future__ import annotations

import dataclasses
from typing import Any

import jax.numpy as jnp
from jax import Array

from jaxlocomanip.lanes import where_needed
from jaxlocomanip.numerics import safe_norm, select
from jaxlocomanip.planner import path, reference, regrasp
from jaxlocomanip.planner.config import PlannerConfig
from jaxlocomanip.planner.state import Measurement, PlannerState, Task, start

SHY = 0.05
"""m, more room that is wanted for walks around the object after there was too little for one"""


def regrouped(state: PlannerState, measured: Measurement, task: Task, config: PlannerConfig) -> PlannerState:
    """The state of a team that has begun to walk to another formation: no path yet, nobody pushes."""
    fresh = start(task, dataclasses.replace(measured, pose=state.object.pose), config)
    return dataclasses.replace(
        state,
        path=fresh.path,
        progress=fresh.progress,
        solver=fresh.solver,
        force=fresh.force,
        offset=measured.offset,
        formation=measured.formation,
        berth=fresh.berth,
        walks=state.walks + 1,
        command=dataclasses.replace(state.command, force=fresh.force, formation=measured.formation),
    )


def regrouping(state: PlannerState, measured: Measurement, task: Task, config: PlannerConfig) -> PlannerState:
    """The state in which a team that has come to rest at such a place is asked to walk to other faces.

    Where it turns out to have too little room, it plans another way, for which it wants more.
    """
    aim, rate, now = state.path.aim, state.object.twist, measured.formation
    still = (safe_norm(rate[:2]) < reference.STILL[0]) & (jnp.abs(rate[2]) < reference.STILL[1])
    there = state.progress.resting & (aim.formation != now) & jnp.all(measured.contact) & still
    given = (state.object.pose, measured.offset, now, aim.formation, task, state.obstacles, config)

    def room(given: tuple[Any, ...]) -> Array:
        pose, offset, now, wanted, task, obstacles, config = given
        return regrasp.room_to_walk(pose, offset, now, wanted, task.shapes, task.formations, obstacles, config)

    free = where_needed(there, room, given, jnp.full((), -1.0, aim.beyond.dtype), config.horizon.rest_skips)
    goes, refused = there & (free > 0.0), there & (free <= 0.0)
    formation = jnp.where(goes, aim.formation, now)
    lost = dataclasses.replace(state.path, cost=jnp.full_like(state.path.cost, path.UNPLANNED))
    return dataclasses.replace(
        state,
        path=select(refused, lost, state.path),
        progress=dataclasses.replace(state.progress, resting=state.progress.resting & ~refused),
        berth=state.berth + jnp.where(refused, SHY, 0.0),
        command=dataclasses.replace(state.command, formation=formation),
    )
