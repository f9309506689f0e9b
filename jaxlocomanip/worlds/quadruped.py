"""The quadruped world: robots with legs walk up to the object and push it; it moves only by contact.

Each robot has its own locomotion controller (`locomotion/`), fed by the contact command (`worlds/contact.py`). The
physics is MuJoCo's: stepped in C for one scenario, or by MJX inside the compiled closed loop for batches.
"""

from __future__ import annotations

import dataclasses
import math
from collections.abc import Sequence
from functools import partial
from pathlib import Path
from typing import Any, ClassVar

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
from jaxlocomanip.numerics import Floats, pytree, static
from jaxlocomanip.robots.model import ROBOT_TYPES
from jaxlocomanip.scenario import Scenario
from jaxlocomanip.worlds import contact, physics_mjx
from jaxlocomanip.worlds.contact import ContactSettings, ContactState
from jaxlocomanip.worlds.interface import Bodies, Push, View, World
from jaxlocomanip.worlds.legged import read_robot
from jaxlocomanip.worlds.physics import Observation, PhysicsState
from jaxlocomanip.worlds.physics_c import CPhysics
from jaxlocomanip.worlds.scene import TIMESTEP, Scene, build_scene

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


@pytree
class MjxWorld:
    """Implements `worlds.interface.World` inside compiled programs."""

    traceable: ClassVar[bool] = True
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
            reached, controllers, joints = drive(now, scenario, self._robots, push, time + k * period, solve, period)
            physics = self.physics.advance(now.physics, joints, hold)
            return QuadrupedState(physics, self.physics.observe(physics), reached, controllers), None

        return jax.lax.scan(update, state, jnp.arange(updates))[0]

    def view(self, state: QuadrupedState, scenario: Scenario) -> View:
        """The true state."""
        return view_of(state, scenario, self._robots)

    @property
    def _robots(self) -> Robots:
        assert self.robots is not None, "a world is prepared before it starts"
        return self.robots


class CWorld:
    """Implements `worlds.interface.World` outside of compiled programs, for one scenario."""

    traceable: ClassVar[bool] = False

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
            reached, controllers, joints = _drive(state, scenario, self.robots, push, now, solve, period)
            physics = self.physics.advance(state.physics, joints, hold)
            state = QuadrupedState(physics, self.physics.observe(physics), reached, controllers)
        return state

    def view(self, state: QuadrupedState, scenario: Scenario) -> View:
        """The true state."""
        return _view(state, scenario, self.robots)


_begin = jax.jit(begin)
_view = jax.jit(view_of)
_drive = partial(jax.jit, static_argnames=("period",))(drive)


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


def world(backend: str, mjcfs: Sequence[str | Path] | None = None) -> World:
    """The quadruped world on a physics engine.

    Args:
      backend: `c` or `mjx`.
      mjcfs: model file of each robot, with the names of the packaged ones (`worlds.legged.read_robot`), instead of the
        models of the team's types; the planner goes on with the sizes and limits of the types.
    """
    files = None if mjcfs is None else tuple(str(path) for path in mjcfs)
    return MjxWorld(mjcfs=files) if backend == "mjx" else CWorld(mjcfs=files)
