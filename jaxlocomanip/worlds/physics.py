"""What the two physics engines under the quadruped world have in common: state, observation, interface.

`physics_c` steps with MuJoCo's C library (one scene, NumPy, about ten times faster on a CPU), `physics_mjx` with MJX
(pure functions, batches, accelerators). Both take the same `Scene`s, the same commands, and give the same pytrees.
Leading axis N_r: robots in the order of the team.
"""

from __future__ import annotations

from typing import Protocol

from jax import Array

from jaxlocomanip.locomotion.robot import BodyState, JointCommand
from jaxlocomanip.numerics import pytree


@pytree
class PhysicsState:
    """All that a simulation goes on from, and the contact forces of the last physics step."""

    qpos: Array
    """[nq] MuJoCo's positions: m, unit quaternions wxyz, rad"""
    qvel: Array
    """[nv] its velocities; angular ones of free bodies in body axes"""
    warmstart: Array
    """[nv] accelerations from which the contact solver starts"""
    heading: Array
    """[] rad, of the object, counting full turns"""
    push_force: Array
    """[N_r] N, see `Observation`"""
    touching: Array
    """[N_r] bool"""
    foot_force: Array
    """[N_r, 4, 3] N"""


@pytree
class Observation:
    """What can be seen of a state; positions and velocities after the last step, forces during it."""

    pose: Array
    """[3] of the object's body point p in plan view: m, m, rad; the heading counts full turns"""
    twist: Array
    """[3] velocity of p, m/s, world axes, and yaw rate, rad/s"""
    lift: Array
    """[] m, of p above the floor"""
    tilt: Array
    """[] rad, of the object's axis from the vertical"""
    robots: BodyState
    """of every robot, [N_r, ...]"""
    push_force: Array
    """[N_r] N, normal force of the pusher on the object, >= 0"""
    touching: Array
    """[N_r] bool, the pusher touches the object"""
    foot_force: Array
    """[N_r, 4, 3] N, of the ground on each foot, world axes"""
    body_position: Array
    """[n_b, 3] m, of all bodies of `Scene.body_names`"""
    body_quaternion: Array
    """[n_b, 4] wxyz"""


class Physics(Protocol):
    """A physics engine with a scene; an object that never changes, as seen from outside."""

    def start(self) -> PhysicsState:
        """The scene's start, at rest."""
        ...

    def advance(self, state: PhysicsState, command: JointCommand, steps: int) -> PhysicsState:
        """The state `steps` physics steps later.

        Args:
          state: unbatched.
          command: [N_r, 4, 3], held; the torques follow from it anew in every step and are clipped to the limits.
          steps: physics steps, >= 1.
        """
        ...

    def observe(self, state: PhysicsState) -> Observation:
        """What can be seen of the state."""
        ...
