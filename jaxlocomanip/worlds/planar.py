"""The planar world: a rigid body on a floor with Coulomb friction, pushed by ideal robots.

Friction follows the coupled limit surface of `planar.dynamics`, by default with exact sticking. A robot's push follows
the command after a first-order lag and fades as the contact recedes faster than the robot can walk; the robot slides
along its face, limited by how fast it can walk sideways while the face itself moves.
"""

from __future__ import annotations

from typing import ClassVar

import jax
import jax.numpy as jnp
import numpy as np
from jax import Array

from jaxlocomanip.numerics import Floats, pytree, static
from jaxlocomanip.planar import dynamics
from jaxlocomanip.planar.geometry import perpendicular, rotate
from jaxlocomanip.scenario import Scenario
from jaxlocomanip.worlds.interface import Push, View


@pytree
class PlanarState:
    """State of the planar world."""

    pose: Array
    """[3]"""
    twist: Array
    """[3]"""
    offset: Array
    """[N_r] m"""
    force: Array
    """[N_r] N"""


@pytree
class PlanarWorld:
    """Implements `worlds.interface.World`."""

    traceable: ClassVar[bool] = True
    substeps: int = static(4)
    """physics steps a tick"""
    force_lag: float = 0.05
    """s, time constant of the robots' push"""
    fade: float = 0.1
    """m/s below the robot's top speed over which its push fades"""
    smoothing: float = 0.0
    """m/s, width of the transition between sticking and sliding; 0: exact sticking"""

    def prepare(self, scenarios: Scenario) -> PlanarWorld:
        """The same numbers for each scenario of a batch."""
        lanes = np.shape(scenarios.duration)
        return jax.tree.map(lambda leaf: np.full(lanes, leaf, np.asarray(scenarios.start).dtype), self)

    def start(self, scenario: Scenario) -> PlanarState:
        """At rest in the start pose, in contact, not pushing."""
        still = jnp.zeros_like(scenario.start)
        return PlanarState(scenario.start, still, scenario.team.offset, jnp.zeros_like(scenario.team.offset))

    def step(self, state: PlanarState, scenario: Scenario, push: Push, time: Floats, tick: float) -> PlanarState:
        """One tick of physics."""
        del time
        h = tick / self.substeps

        def body(carry: PlanarState, _: None) -> tuple[PlanarState, None]:
            return self.substep(carry, scenario, push, h), None

        return jax.lax.scan(body, state, None, length=self.substeps)[0]

    def substep(self, state: PlanarState, scenario: Scenario, push: Push, h: float) -> PlanarState:
        """One physics step of length h, s."""
        team = scenario.team
        points = team.contact_points(state.offset)
        velocity_B = rotate(-state.pose[2], state.twist[:2]) + state.twist[2] * perpendicular(points)
        ahead = jnp.sum(velocity_B * team.normal, axis=-1)
        aside = jnp.sum(velocity_B * team.tangent, axis=-1)
        wanted = jnp.clip(push.force, 0.0, team.force_max)
        force = wanted + (state.force - wanted) * jnp.exp(-h / self.force_lag)
        acting = force * jnp.clip((team.push_speed_max - ahead) / self.fade, 0.0, 1.0)
        wrench_B = dynamics.body_wrench(points, team.normal, acting)
        pose, twist = dynamics.step(scenario.truth, state.pose, state.twist, wrench_B, h, self.smoothing)
        walk = jnp.clip(push.offset_rate + aside, -team.slide_speed_max, team.slide_speed_max) - aside
        offset = jnp.clip(state.offset + h * walk, -team.offset_limit, team.offset_limit)
        return PlanarState(pose, twist, offset, force)

    def view(self, state: PlanarState, scenario: Scenario) -> View:
        """The true state."""
        robots = scenario.team.robot_poses(state.pose, state.offset)
        touching = jnp.ones_like(state.offset, dtype=bool)
        return View(state.pose, state.twist, state.offset, state.force, robots, touching, ~touching, None)
