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
from jaxlocomanip.formation import PHASES, Standing, count, standing, team_in
from jaxlocomanip.locomotion import controller
from jaxlocomanip.locomotion.algebra import yaw_of
from jaxlocomanip.locomotion.controller import ControllerState
from jaxlocomanip.locomotion.robot import JointCommand, LeggedRobot
from jaxlocomanip.locomotion.settings import LocomotionSettings, derived_settings, settings_for
from jaxlocomanip.numerics import pytree, select
from jaxlocomanip.robots.model import ROBOT_TYPES
from jaxlocomanip.scenario import Scenario, Team
from jaxlocomanip.worlds import circling, contact
from jaxlocomanip.worlds.circling import CIRCLED
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
SWAY = 0.03
"""m, by which a robot sways about its contact offset, strides and yaw together"""
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
    standing: Standing


def begin(physics: PhysicsState, seen: Observation, scenario: Scenario, robots: Robots) -> QuadrupedState:
    """Standing before the faces."""
    faces = contact.look(seen.pose, seen.robots, robots.legged, scenario.team)
    controllers = jax.vmap(controller.start)(robots.legged, robots.settings, seen.robots)
    return QuadrupedState(physics, seen, contact.start(scenario.team, faces), controllers, standing(scenario.team))


def drive(
    state: QuadrupedState, scenario: Scenario, robots: Robots, push: Push, time: Array, solve: Array, period: float
) -> tuple[ContactState, Standing, ControllerState, JointCommand]:
    """The joints' commands [N_r, 4, 3] for one period, s; `solve` says whether forces are planned anew."""
    seen, settings = state.seen, robots.contact
    now, begins = state.standing.asked(push.formation, state.contact.offset)
    team = team_in(scenario.team, scenario.formations, now.formation)
    faces = contact.look(seen.pose, seen.robots, robots.legged, team)
    reached, motion = contact.command(
        state.contact, seen.pose, seen.twist, seen.touching, faces, team, push, settings, period
    )
    if count(scenario.formations) > 1:
        # While it walks the team is as before any contact with its new faces, where it shall hold its first offsets.
        fresh = dataclasses.replace(contact.start(team, faces), offset=team.offset)
        walking = begins | (now.phase < CIRCLED)
        phase, around = circling.motions(
            now.walk(scenario), now.phase, seen.pose, _trunks(seen), _ahead(robots, team), faces.point, period
        )
        reached, motion = select(walking, (fresh, around), (reached, motion))
        # Stepping up to the face is the contact's own approach.
        phase = jnp.where(walking, phase, jnp.where(jnp.all(reached.touched), float(PHASES), now.phase))
        now = dataclasses.replace(now, phase=phase)
    control = jax.vmap(controller.control, in_axes=(0, 0, 0, 0, 0, None, None))
    controllers, joints = control(state.controllers, robots.legged, robots.settings, seen.robots, motion, time, solve)
    return reached, now, controllers, joints


def _trunks(seen: Observation) -> Array:
    """[N_r, 3] poses of the trunks on the floor: origin, m, and heading, rad."""
    yaw = jax.vmap(yaw_of)(seen.robots.rotation)
    return jnp.concatenate([seen.robots.position[:, :2], yaw[:, None]], axis=1)


def _ahead(robots: Robots, team: Team) -> Array:
    """[N_r] m, from a trunk's origin to the middle of the robot's body rectangle."""
    return robots.legged.pusher[:, 0] + robots.legged.pusher_radius - team.reach


def view_of(state: QuadrupedState, scenario: Scenario, robots: Robots) -> View:
    """What outcome, planner and recording see."""
    seen, legged = state.seen, robots.legged
    team = team_in(scenario.team, scenario.formations, state.standing.formation)
    faces = contact.look(seen.pose, seen.robots, legged, team)
    trunks = _trunks(seen)
    direction = jnp.stack([jnp.cos(trunks[:, 2]), jnp.sin(trunks[:, 2])], axis=-1)
    middles = trunks[:, :2] + _ahead(robots, team)[:, None] * direction
    rectangles = jnp.concatenate([middles, trunks[:, 2:]], axis=1)
    low = seen.robots.position[:, 2] < FALLEN_HEIGHT * legged.stand_height
    return View(
        pose=seen.pose,
        twist=seen.twist,
        offset=state.contact.offset,
        force=seen.push_force,
        robots=rectangles,
        contact=contact.at_face(state.contact, faces, robots.contact) & state.standing.arrived,
        fallen=low | (seen.robots.rotation[:, 2, 2] < math.cos(FALLEN_TILT)),
        formation=state.standing.formation,
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
