"""The quadruped world in MJX: pure functions of pytrees, compiled together with the planner, alone or in batches."""

from __future__ import annotations

import dataclasses
from typing import Any, ClassVar

import jax
import jax.numpy as jnp
import numpy as np
from jax import Array

from jaxlocomanip.numerics import Floats, pytree, static
from jaxlocomanip.scenario import Scenario
from jaxlocomanip.worlds import physics_mjx
from jaxlocomanip.worlds.interface import Push, View
from jaxlocomanip.worlds.quadruped_team import SWAY, QuadrupedState, Robots, begin, drive, load_robots, rates, view_of
from jaxlocomanip.worlds.scene import TIMESTEP, Scene, build_scene


@pytree
class MjxWorld:
    """Implements `worlds.interface.World` inside compiled programs."""

    traceable: ClassVar[bool] = True
    sway: ClassVar[float] = SWAY
    physics: Any = None
    robots: Robots | None = None
    timestep: float = static(TIMESTEP)
    """s, of the physics"""
    mjcfs: tuple[str, ...] | None = static(None)
    """[N_r] files of the robots' models, instead of the packaged ones of the team's types"""

    def prepare(self, scenarios: Scenario) -> MjxWorld:
        """With the models of one scenario or a batch of them."""
        if np.ndim(scenarios.duration) == 0:
            physics, robots = physics_mjx.load_model(self._scene(scenarios)), load_robots(scenarios, self.mjcfs)
            return dataclasses.replace(self, physics=physics, robots=robots)
        lanes = [jax.tree.map(lambda leaf, i=i: leaf[i], scenarios) for i in range(len(scenarios.duration))]
        physics = physics_mjx.stack_models([self._scene(s) for s in lanes])
        robots = load_robots(lanes[0], self.mjcfs)
        robots = jax.tree.map(lambda leaf: jnp.stack([leaf] * len(lanes)), robots)
        return dataclasses.replace(self, physics=physics, robots=robots)

    def _scene(self, scenario: Scenario) -> Scene:
        return build_scene(scenario, robots=self.mjcfs, scenery=False, timestep=self.timestep)

    def start(self, scenario: Scenario) -> QuadrupedState:
        """Standing before the faces."""
        physics = self.physics.start()
        return begin(physics, self.physics.observe(physics), scenario, self._robots)

    def step(self, state: QuadrupedState, scenario: Scenario, push: Push, time: Floats, tick: float) -> QuadrupedState:
        """One tick: some joint commands, each held for some physics steps."""
        updates, hold, every = rates(tick, self.timestep)
        period = hold * self.timestep
        first = jnp.rint(jnp.asarray(time) / period).astype(jnp.int32)

        def update(now: QuadrupedState, k: Array) -> tuple[QuadrupedState, None]:
            solve = (first + k) % every == 0
            reached, places, controllers, joints = drive(
                now, scenario, self._robots, push, time + k * period, solve, period
            )
            physics = self.physics.advance(now.physics, joints, hold)
            return QuadrupedState(physics, self.physics.observe(physics), reached, controllers, places), None

        return jax.lax.scan(update, state, jnp.arange(updates))[0]

    def view(self, state: QuadrupedState, scenario: Scenario) -> View:
        """The true state."""
        return view_of(state, scenario, self._robots)

    @property
    def _robots(self) -> Robots:
        assert self.robots is not None, "a world is prepared before it starts"
        return self.robots
