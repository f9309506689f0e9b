"""Physics by MuJoCo's C library: one scene, NumPy in double precision, a few dozen microseconds a step."""

# Most of MuJoCo's names come out of its C library, where pyright cannot see them.
# pyright: reportAttributeAccessIssue=false

from __future__ import annotations

from typing import Any

import mujoco
import numpy as np
from numpy.typing import NDArray

from jaxlocomanip.locomotion.robot import BodyState, JointCommand
from jaxlocomanip.worlds.physics import Observation, PhysicsState
from jaxlocomanip.worlds.scene import Scene

Floats = NDArray[np.floating[Any]]

_NOWHERE = -1


class CPhysics:
    """Implements `worlds.physics.Physics`; the arrays of its pytrees are NumPy's.

    The work happens in one `MjData`, `data`, which each call loads from the state it is given: calls for different
    states may alternate, but not run at the same time.
    """

    def __init__(self, scene: Scene) -> None:
        model, tables = scene.model, scene.tables
        self.scene, self.model, self.data = scene, model, mujoco.MjData(model)
        count = len(tables.trunk_body)
        self._shape = (count, 4, 3)
        self._joint_qpos, self._joint_dof = np.ravel(tables.joint_qpos), np.ravel(tables.joint_dof)
        self._actuator = np.ravel(tables.actuator)
        limit = model.actuator_ctrlrange[self._actuator, 1]
        self._low, self._high = -limit, limit
        self._trunks, self._bodies = np.array(tables.trunk_body), np.array(tables.bodies)
        self._linear = np.array(tables.trunk_dof)[:, None] + np.arange(3)
        self._angular = self._linear + 3
        self._rows = np.arange(3)
        # Which foot or pusher a geom is; contacts list the floor first and the object, a box or a mesh, last.
        self._foot_of, self._pusher_of = (np.full(model.ngeom, _NOWHERE) for _ in range(2))
        self._foot_of[np.ravel(tables.foot_geom)] = np.arange(4 * count)
        self._pusher_of[list(tables.pusher_geom)] = np.arange(count)
        # Views into MuJoCo's memory, looked up once: an attribute of `data` costs as much as the arithmetic on it.
        data = self.data
        self._qpos, self._qvel, self._warmstart = data.qpos, data.qvel, data.qacc_warmstart
        self._ctrl, self._xpos, self._xquat = data.ctrl, data.xpos, data.xquat
        self._xmat = data.xmat.reshape(-1, 3, 3)

    def start(self) -> PhysicsState:
        """The scene's start, at rest."""
        still, none = np.zeros(self.model.nv), np.zeros(self._shape)
        touching = np.zeros(self._shape[0], dtype=bool)
        heading = np.asarray(self.scene.heading)
        return _state(self.scene.qpos.copy(), still, still, heading, none[:, 0, 0], touching, none)

    def advance(self, state: PhysicsState, command: JointCommand, steps: int) -> PhysicsState:
        """The state `steps` physics steps later, the command [N_r, 4, 3] held."""
        self._qpos[:], self._qvel[:], self._warmstart[:] = state.qpos, state.qvel, state.warmstart
        kp, kd = (np.asarray(gain, dtype=float).ravel() for gain in (command.kp, command.kd))
        position, rate = (np.asarray(wanted, dtype=float).ravel() for wanted in (command.position, command.rate))
        fixed = np.asarray(command.torque, dtype=float).ravel() + kp * position + kd * rate
        if not all(np.isfinite(values).all() for values in (fixed, self._qpos, self._qvel)):
            # MuJoCo would put zero for such a torque and write a log file; MJX carries it on, and so does this.
            self._qpos[:] = self._qvel[:] = np.nan
            steps = 0
        for _ in range(steps):
            # `joint_torque`, with what does not change between steps taken out.
            torque = fixed - kp * self._qpos[self._joint_qpos] - kd * self._qvel[self._joint_dof]
            self._ctrl[self._actuator] = np.minimum(np.maximum(torque, self._low), self._high)
            mujoco.mj_step(self.model, self.data)
        push, touching, feet = self._contact_forces()
        at = self.scene.tables.object_qpos
        w, x, y, z = self._qpos[at + 3 : at + 7].tolist()
        yaw = np.arctan2(2.0 * (w * z + x * y), 1.0 - 2.0 * (y * y + z * z))
        heading = state.heading + (yaw - state.heading + np.pi) % (2.0 * np.pi) - np.pi
        arrays = self._qpos.copy(), self._qvel.copy(), self._warmstart.copy()
        return _state(*arrays, np.asarray(heading), push, touching, feet)

    def observe(self, state: PhysicsState) -> Observation:
        """What can be seen of the state."""
        self._qpos[:] = state.qpos
        mujoco.mj_kinematics(self.model, self.data)
        tables, qvel = self.scene.tables, np.asarray(state.qvel)
        turn, rotation = self._xmat[tables.object_body], self._xmat[self._trunks]
        x, y, lift = self._xpos[tables.object_body].tolist()
        at = tables.object_dof
        yaw_rate = turn[2] @ qvel[at + 3 : at + 6]
        robots = BodyState(
            position=self._xpos[self._trunks],  # pyright: ignore[reportArgumentType]
            rotation=rotation,  # pyright: ignore[reportArgumentType]
            velocity=qvel[self._linear],  # pyright: ignore[reportArgumentType]
            angular_velocity=(rotation @ qvel[self._angular][..., None])[..., 0],
            joint=self._qpos[self._joint_qpos].reshape(self._shape),
            joint_rate=qvel[self._joint_dof].reshape(self._shape),  # pyright: ignore[reportArgumentType]
        )
        shown: Any = {
            "pose": np.array([x, y, state.heading]),
            "twist": np.array([qvel[at], qvel[at + 1], yaw_rate]),
            "lift": np.asarray(lift),
            "tilt": np.arctan2(np.hypot(turn[0, 2], turn[1, 2]), turn[2, 2]),
            "body_position": self._xpos[self._bodies],
            "body_quaternion": self._xquat[self._bodies],
        }
        forces = {"push_force": state.push_force, "touching": state.touching, "foot_force": state.foot_force}
        return Observation(robots=robots, **forces, **shown)

    def place_obstacles(self, positions: Floats) -> None:
        """Move the drawn obstacles that move to `positions` [N_o, 2] m in `data`, for rendering it."""
        for number, (x, y) in zip(self.scene.mocap, np.asarray(positions), strict=True):
            if number != _NOWHERE:
                self.data.mocap_pos[number] = x, y, 0.0

    def _contact_forces(self) -> tuple[Floats, NDArray[np.bool_], Floats]:
        """Push force [N_r] N, touch [N_r] bool and foot forces [N_r, 4, 3] N of the last step.

        With an elliptic cone the three constraint forces of a contact are its force along the rows of the contact
        frame, acting on the second geom (the same numbers as `mj_contactForce`, without a call for each contact).
        """
        contact = self.data.contact
        geom, address, frame = contact.geom, contact.efc_address, contact.frame.reshape(-1, 3, 3)
        used = np.flatnonzero(address >= 0)
        pusher, foot = self._pusher_of[geom[used, 0]], self._foot_of[geom[used, 1]]
        local = self.data.efc_force[address[used, None] + self._rows]
        world = (local[:, None, :] @ frame[used])[:, 0]
        # One more place than there are feet and pushers takes what belongs to none, which comes as -1.
        count = self._shape[0]
        feet, push, touching = np.zeros((4 * count + 1, 3)), np.zeros(count + 1), np.zeros(count + 1, dtype=bool)
        np.add.at(feet, foot, world)
        np.add.at(push, pusher, local[:, 0])
        touching[pusher] = True
        return push[:-1], touching[:-1], feet[:-1].reshape(self._shape)


def _state(*arrays: Any) -> PhysicsState:
    """A state of NumPy arrays, which stand for JAX's."""
    return PhysicsState(*arrays)
