"""The quadruped world in MuJoCo's C library: one scenario, stepped by Python between compiled controllers."""

from __future__ import annotations

from functools import partial
from typing import ClassVar

import jax
import numpy as np

from jaxlocomanip.numerics import Floats
from jaxlocomanip.scenario import Scenario
from jaxlocomanip.worlds.interface import Push, View
from jaxlocomanip.worlds.physics_c import CPhysics
from jaxlocomanip.worlds.quadruped_team import SWAY, QuadrupedState, Robots, begin, drive, load_robots, rates, view_of
from jaxlocomanip.worlds.scene import TIMESTEP, build_scene


class CWorld:
    """Implements `worlds.interface.World` outside of compiled programs, for one scenario."""

    traceable: ClassVar[bool] = False
    sway: ClassVar[float] = SWAY

    def __init__(self, timestep: float = TIMESTEP, mjcfs: tuple[str, ...] | None = None) -> None:
        self.timestep, self.mjcfs = timestep, mjcfs

    def prepare(self, scenarios: Scenario) -> CWorld:
        """With the model of the scenario."""
        world = CWorld(self.timestep, self.mjcfs)
        world.physics = CPhysics(build_scene(scenarios, robots=self.mjcfs, timestep=self.timestep))
        world.robots = jax.device_put(load_robots(scenarios, self.mjcfs))
        return world

    physics: CPhysics
    robots: Robots

    def start(self, scenario: Scenario) -> QuadrupedState:
        """Standing before the faces."""
        physics = self.physics.start()
        return _begin(physics, self.physics.observe(physics), scenario, self.robots)

    def step(self, state: QuadrupedState, scenario: Scenario, push: Push, time: Floats, tick: float) -> QuadrupedState:
        """One tick: some joint commands, each held for some physics steps."""
        updates, hold, every = rates(tick, self.timestep)
        period = hold * self.timestep
        first = round(float(time) / period)
        for k in range(updates):
            now = np.float32((first + k) * period)
            solve = np.bool_((first + k) % every == 0)
            reached, places, controllers, joints = _drive(state, scenario, self.robots, push, now, solve, period)
            physics = self.physics.advance(state.physics, joints, hold)
            state = QuadrupedState(physics, self.physics.observe(physics), reached, controllers, places)
        return state

    def view(self, state: QuadrupedState, scenario: Scenario) -> View:
        """The true state."""
        return _view(state, scenario, self.robots)


_begin = jax.jit(begin)
_view = jax.jit(view_of)
_drive = partial(jax.jit, static_argnames=("period",))(drive)
