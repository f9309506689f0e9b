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

from jaxlocomanip.formation import PHASES, Walk, count, team_in, walk_around
from jaxlocomanip.numerics import Floats, pytree, select, static
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
    formation: Array
    """[] int, taken or walked to"""
    left: Array
    """[] int, formation that the last walk began in"""
    leaving: Array
    """[N_r] m, contact offsets at which it began"""
    phase: Array
    """[] of the walk; `formation.PHASES`: everybody is at the faces"""


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
        first, offset = jnp.zeros((), jnp.int32), scenario.team.offset
        arrived = jnp.full((), float(PHASES), still.dtype)
        return PlanarState(scenario.start, still, offset, jnp.zeros_like(offset), first, first, offset, arrived)

    def step(self, state: PlanarState, scenario: Scenario, push: Push, time: Floats, tick: float) -> PlanarState:
        """One tick of physics."""
        del time
        h = tick / self.substeps
        state = _walked(state, scenario, push, tick)
        team = team_in(scenario.team, scenario.formations, state.formation)

        def body(carry: PlanarState, _: None) -> tuple[PlanarState, None]:
            return self.substep(carry, scenario, team, push, h), None

        return jax.lax.scan(body, state, None, length=self.substeps)[0]

    def substep(self, state: PlanarState, scenario: Scenario, team: Team, push: Push, h: float) -> PlanarState:
        """One physics step of length h, s, with the team in its formation."""
        points = team.contact_points(state.offset)
        velocity_B = rotate(-state.pose[2], state.twist[:2]) + state.twist[2] * perpendicular(points)
        ahead = jnp.sum(velocity_B * team.normal, axis=-1)
        aside = jnp.sum(velocity_B * team.tangent, axis=-1)
        wanted = jnp.clip(push.force, 0.0, team.force_max)
        at_faces = state.phase >= PHASES
        force = jnp.where(at_faces, wanted + (state.force - wanted) * jnp.exp(-h / self.force_lag), 0.0)
        acting = force * jnp.clip((team.push_speed_max - ahead) / self.fade, 0.0, 1.0)
        wrench_B = dynamics.body_wrench(points, team.normal, acting)
        pose, twist = dynamics.step(scenario.truth, state.pose, state.twist, wrench_B, h, self.smoothing)
        walk = jnp.clip(push.offset_rate + aside, -team.slide_speed_max, team.slide_speed_max) - aside
        walk = jnp.where(at_faces, walk, 0.0)
        offset = jnp.clip(state.offset + h * walk, -team.offset_limit, team.offset_limit)
        return dataclasses.replace(state, pose=pose, twist=twist, offset=offset, force=force)

    def view(self, state: PlanarState, scenario: Scenario) -> View:
        """The true state."""
        robots = team_in(scenario.team, scenario.formations, state.formation).robot_poses(state.pose, state.offset)
        at_faces = state.phase >= PHASES
        if count(scenario.formations) > 1:
            walking = _walk(state, scenario).poses_in_world(state.pose, state.phase)
            robots = jnp.where(at_faces, robots, walking)
        touching = jnp.broadcast_to(at_faces, state.offset.shape)
        nobody = jnp.zeros_like(touching)
        return View(state.pose, state.twist, state.offset, state.force, robots, touching, nobody, state.formation, None)


def _walk(state: PlanarState, scenario: Scenario) -> Walk:
    """The last walk of the team."""
    leaves, reaches = (team_in(scenario.team, scenario.formations, k) for k in (state.left, state.formation))
    size = count(scenario.formations)
    forwards = (state.formation - state.left) % size <= size // 2
    return walk_around(scenario.object.vertices, leaves, state.leaving, reaches, forwards)


def _walked(state: PlanarState, scenario: Scenario, push: Push, tick: float) -> PlanarState:
    """The state after one tick of walking; a team that is at its faces may begin."""
    if count(scenario.formations) == 1:
        return state
    wanted = jnp.asarray(push.formation, jnp.int32)
    begins = (state.phase >= PHASES) & (wanted != state.formation)
    new = team_in(scenario.team, scenario.formations, wanted)
    begun = dataclasses.replace(
        state,
        offset=new.offset,
        force=jnp.zeros_like(state.force),
        formation=wanted,
        left=state.formation,
        leaving=state.offset,
        phase=jnp.zeros_like(state.phase),
    )
    state = select(begins, begun, state)
    return dataclasses.replace(state, phase=_walk(state, scenario).advance(state.phase, tick))
