"""The team of the quadruped world, whatever the physics: its robots, what they do in each period, and how it looks.

Each robot has its own locomotion controller (`locomotion/`), fed by the contact command (`worlds/contact.py`).
"""

from __future__ import annotations

import dataclasses
import math
from collections.abc import Sequence

import jax
import jax.numpy as jnp
import numpy as np
from jax import Array

from jaxlocomanip.checked import InputError
from jaxlocomanip.locomotion import controller
from jaxlocomanip.locomotion.algebra import yaw_of
from jaxlocomanip.locomotion.controller import ControllerState
from jaxlocomanip.locomotion.robot import JointCommand, LeggedRobot
from jaxlocomanip.locomotion.settings import LocomotionSettings, derived_settings, settings_for
from jaxlocomanip.numerics import pytree
from jaxlocomanip.robots.model import ROBOT_TYPES
from jaxlocomanip.scenario import Scenario
from jaxlocomanip.worlds import contact
from jaxlocomanip.worlds.contact import ContactSettings, ContactState
from jaxlocomanip.worlds.interface import Bodies, Push, View
from jaxlocomanip.worlds.legged import read_robot
from jaxlocomanip.worlds.physics import Observation, PhysicsState

HOLD = 5
"""physics steps at most for which a joint command is held"""
PLANNING = 0.02
"""s, about the time between two solutions of a robot's force MPC"""
LEAD = 0.03
"""m, of a robot's integrated reference before itself; more of it goes on pressing after the planner has let go"""
FALLEN_HEIGHT = 0.6
"""of the standing height; a trunk below it has fallen"""
FALLEN_TILT = 0.5
"""rad; a trunk tilted more has fallen"""


@pytree
class Robots:
    """The team's legged robots."""

    legged: LeggedRobot
    """[N_r, ...]"""
    settings: LocomotionSettings
    """[N_r, ...]"""
    contact: ContactSettings


@pytree
class QuadrupedState:
    """State of the quadruped world."""

    physics: PhysicsState
    seen: Observation
    contact: ContactState
    controllers: ControllerState
    """[N_r, ...]"""


def begin(physics: PhysicsState, seen: Observation, scenario: Scenario, robots: Robots) -> QuadrupedState:
    """Standing before the faces."""
    faces = contact.look(seen.pose, seen.robots, robots.legged, scenario.team)
    controllers = jax.vmap(controller.start)(robots.legged, robots.settings, seen.robots)
    return QuadrupedState(physics, seen, contact.start(scenario.team, faces), controllers)


def drive(
    state: QuadrupedState, scenario: Scenario, robots: Robots, push: Push, time: Array, solve: Array, period: float
) -> tuple[ContactState, ControllerState, JointCommand]:
    """The joints' commands [N_r, 4, 3] for one period, s; `solve` says whether forces are planned anew."""
    seen = state.seen
    faces = contact.look(seen.pose, seen.robots, robots.legged, scenario.team)
    touching, settings = seen.touching, robots.contact
    reached, motion = contact.command(
        state.contact, seen.pose, seen.twist, touching, faces, scenario.team, push, settings, period
    )
    control = jax.vmap(controller.control, in_axes=(0, 0, 0, 0, 0, None, None))
    controllers, joints = control(state.controllers, robots.legged, robots.settings, seen.robots, motion, time, solve)
    return reached, controllers, joints


def view_of(state: QuadrupedState, scenario: Scenario, robots: Robots) -> View:
    """What outcome, planner and recording see."""
    seen, team, legged = state.seen, scenario.team, robots.legged
    faces = contact.look(seen.pose, seen.robots, legged, team)
    yaw = jax.vmap(yaw_of)(seen.robots.rotation)
    ahead = legged.pusher[:, 0] + legged.pusher_radius - team.reach
    direction = jnp.stack([jnp.cos(yaw), jnp.sin(yaw)], axis=-1)
    rectangles = jnp.concatenate([seen.robots.position[:, :2] + ahead[:, None] * direction, yaw[:, None]], axis=1)
    low = seen.robots.position[:, 2] < FALLEN_HEIGHT * legged.stand_height
    return View(
        pose=seen.pose,
        twist=seen.twist,
        offset=state.contact.offset,
        force=seen.push_force,
        robots=rectangles,
        contact=contact.at_face(state.contact, faces, robots.contact),
        fallen=low | (seen.robots.rotation[:, 2, 2] < math.cos(FALLEN_TILT)),
        formation=jnp.zeros((), jnp.int32),
        bodies=Bodies(seen.body_position, seen.body_quaternion, seen.foot_force, faces.point),
    )


def rates(tick: float, timestep: float) -> tuple[int, int, int]:
    """Joint commands a tick, physics steps each of them is held, and commands from one force plan to the next.

    Raises:
      InputError: the planner's tick is not a multiple of the physics step.
    """
    steps = round(tick / timestep)
    if steps < 1 or abs(steps * timestep - tick) > 1e-6:
        raise InputError(f"horizon.tick = {tick}: must be a multiple of the physics step, {timestep} s")
    hold = max(n for n in range(1, HOLD + 1) if steps % n == 0)
    return steps // hold, hold, max(1, round(PLANNING / (hold * timestep)))


def load_robots(scenario: Scenario, mjcfs: Sequence[str] | None = None) -> Robots:
    """Parameters and gains of the robots of one scenario's team, from their types or from files."""
    if mjcfs is None:
        names = [ROBOT_TYPES[int(kind)] for kind in np.asarray(scenario.team.kind)]
        team, gains = [read_robot(name) for name in names], [settings_for(name) for name in names]
    else:
        team = [read_robot(path) for path in mjcfs]
        gains = [derived_settings(robot) for robot in team]
    legged, settings = (jax.tree.map(lambda *leaves: jnp.stack(leaves), *each) for each in (team, gains))
    settings = dataclasses.replace(settings, reach=jnp.minimum(settings.reach, LEAD))
    return Robots(legged, settings, ContactSettings())
