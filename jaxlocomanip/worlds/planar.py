"""The planar world: a rigid body on a floor with Coulomb friction, pushed by ideal robots.

Friction follows the coupled limit surface of `planar.dynamics`, by default with exact sticking. A robot's push follows
the command after a first-order lag and fades as the contact recedes faster than the robot can walk; the robot slides
along its face, limited by how fast it can walk sideways while the face itself moves. A team that changes its formation
walks around the object as `formation.Walk` says, and pushes again once it is there.
"""

from __future__ import annotations

import dataclasses
from typing import ClassVar

import jax
import jax.numpy as jnp
import numpy as np
from jax import Array

from jaxlocomanip.formation import Standing, count, standing, team_in
from jaxlocomanip.numerics import Floats, pytree, static
from jaxlocomanip.planar import dynamics
from jaxlocomanip.planar.geometry import perpendicular, rotate
from jaxlocomanip.scenario import Scenario, Team
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
    standing: Standing


@pytree
class PlanarWorld:
    """Implements `worlds.interface.World`."""

    traceable: ClassVar[bool] = True
    sway: ClassVar[float] = 0.0
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
        offset = scenario.team.offset
        return PlanarState(scenario.start, still, offset, jnp.zeros_like(offset), standing(scenario.team))

    def step(self, state: PlanarState, scenario: Scenario, push: Push, time: Floats, tick: float) -> PlanarState:
        """One tick of physics."""
        del time
        h = tick / self.substeps
        state = _walked(state, scenario, push, tick)
        team = team_in(scenario.team, scenario.formations, state.standing.formation)

        def body(carry: PlanarState, _: None) -> tuple[PlanarState, None]:
            return self.substep(carry, scenario, team, push, h), None

        return jax.lax.scan(body, state, None, length=self.substeps)[0]

    def substep(self, state: PlanarState, scenario: Scenario, team: Team, push: Push, h: float) -> PlanarState:
        """One physics step of length h, s, with the team in its formation."""
        points, ahead, aside = _contacts(state, team)
        wanted = jnp.clip(push.force, 0.0, team.force_max)
        at_faces = state.standing.arrived
        force = jnp.where(at_faces, wanted + (state.force - wanted) * jnp.exp(-h / self.force_lag), 0.0)
        acting = force * self._keeping_up(team, ahead)
        wrench_B = dynamics.body_wrench(points, team.normal, acting)
        pose, twist = dynamics.step(scenario.truth, state.pose, state.twist, wrench_B, h, self.smoothing)
        walk = jnp.clip(push.offset_rate + aside, -team.slide_speed_max, team.slide_speed_max) - aside
        walk = jnp.where(at_faces, walk, 0.0)
        offset = jnp.clip(state.offset + h * walk, -team.offset_limit, team.offset_limit)
        return dataclasses.replace(state, pose=pose, twist=twist, offset=offset, force=force)

    def _keeping_up(self, team: Team, ahead: Array) -> Array:
        """[N_r] share of its push that a robot can bring to a face that recedes at [N_r] m/s."""
        return jnp.clip((team.push_speed_max - ahead) / self.fade, 0.0, 1.0)

    def view(self, state: PlanarState, scenario: Scenario) -> View:
        """The true state."""
        now, at_faces = state.standing, state.standing.arrived
        team = team_in(scenario.team, scenario.formations, now.formation)
        robots, acting = team.robot_poses(state.pose, state.offset), state.force
        acting = acting * self._keeping_up(team, _contacts(state, team)[1])
        if count(scenario.formations) > 1:
            walking = now.walk(scenario).poses_in_world(state.pose, now.phase)
            robots = jnp.where(at_faces, robots, walking)
        touching = jnp.broadcast_to(at_faces, state.offset.shape)
        nobody = jnp.zeros_like(touching)
        return View(state.pose, state.twist, state.offset, acting, robots, touching, nobody, now.formation, bodies=None)


def _contacts(state: PlanarState, team: Team) -> tuple[Array, Array, Array]:
    """Contact points [N_r, 2] m in the body frame, and the speeds [N_r] m/s of the faces there, ahead and aside."""
    points = team.contact_points(state.offset)
    velocity_B = rotate(-state.pose[2], state.twist[:2]) + state.twist[2] * perpendicular(points)
    return points, jnp.sum(velocity_B * team.normal, axis=-1), jnp.sum(velocity_B * team.tangent, axis=-1)


def _walked(state: PlanarState, scenario: Scenario, push: Push, tick: float) -> PlanarState:
    """The state after one tick of walking; a team that is at its faces may begin."""
    if count(scenario.formations) == 1:
        return state
    new, begins = state.standing.asked(push.formation, state.offset)
    offset = jnp.where(begins, team_in(scenario.team, scenario.formations, new.formation).offset, state.offset)
    new = dataclasses.replace(new, phase=new.walk(scenario).advance(new.phase, tick))
    return dataclasses.replace(state, offset=offset, force=jnp.where(begins, 0.0, state.force), standing=new)
