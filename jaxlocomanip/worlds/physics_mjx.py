"""Physics by MJX: pure functions of pytrees, for batches of scenes. The only file that imports MJX.

Lanes of a batch have the same robots and the same number of corners; everything else may differ between them:
`stack_models` joins their models into one, and `vmap` goes over model, state and command alike. Not for gradients:
those of MJX's elliptic friction cone are NaN.
"""

# Most of MuJoCo's names come out of its C library, where pyright cannot see them.
# pyright: reportAttributeAccessIssue=false

from __future__ import annotations

import contextlib
import dataclasses
import io
from collections.abc import Sequence
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
from jax import Array

from jaxlocomanip.checked import InputError
from jaxlocomanip.locomotion.robot import BodyState, JointCommand, joint_torque
from jaxlocomanip.numerics import pytree, static, wrap_angle
from jaxlocomanip.worlds.physics import Observation, PhysicsState
from jaxlocomanip.worlds.scene import Scene, Tables

with contextlib.redirect_stdout(io.StringIO()):  # it prints which of its optional back ends are not installed
    from mujoco import mjx

_IDLE = ("body_sameframe", "geom_sameframe", "body_simple", "dof_simplenum")
"""Static fields of the model that MJX never reads; so are those that begin with `mesh_`, once the hulls are made."""


@pytree
class MjxPhysics:
    """Implements `worlds.physics.Physics`; the fields may have a leading axis of lanes."""

    model: mjx.Model
    qpos: Array
    """[nq] at the start"""
    heading: Array
    """[] rad, of the object at the start"""
    tables: Tables = static(None)

    def start(self) -> PhysicsState:
        """The scene's start, at rest."""
        count = len(self.tables.trunk_body)
        still = jnp.zeros(self.model.nv, self.qpos.dtype)
        none = jnp.zeros((count, 4, 3), self.qpos.dtype)
        return PhysicsState(self.qpos, still, still, self.heading, none[:, 0, 0], jnp.zeros(count, bool), none)

    def advance(self, state: PhysicsState, command: JointCommand, steps: Array | int) -> PhysicsState:
        """The state `steps` physics steps later, the command [N_r, 4, 3] held; `steps` may be traced."""
        limit = self._of_joints(self.model.actuator_ctrlrange[:, 1], self.tables.actuator)

        def step(_: Any, now: PhysicsState) -> PhysicsState:
            joint = self._of_joints(now.qpos, self.tables.joint_qpos)
            rate = self._of_joints(now.qvel, self.tables.joint_dof)
            torque = joint_torque(command, joint, rate, limit)
            order = np.ravel(self.tables.actuator)
            return self._step(now, jnp.zeros(self.model.nu, torque.dtype).at[order].set(torque.ravel()))

        return jax.lax.fori_loop(0, steps, step, state)

    def observe(self, state: PhysicsState) -> Observation:
        """What can be seen of the state."""
        tables, qvel = self.tables, state.qvel
        placed = mjx.kinematics(self.model, self._data(state))
        spin = placed.xmat[tables.object_body] @ qvel[tables.object_dof + 3 : tables.object_dof + 6]
        position, axis = placed.xpos[tables.object_body], placed.xmat[tables.object_body][:, 2]
        trunks = np.array(tables.trunk_body)
        free = np.array(tables.trunk_dof)[:, None] + np.arange(3)
        rotation = placed.xmat[trunks]
        return Observation(
            pose=jnp.append(position[:2], state.heading),
            twist=jnp.append(qvel[tables.object_dof : tables.object_dof + 2], spin[2]),
            lift=position[2],
            tilt=jnp.arctan2(jnp.sqrt(axis[0] ** 2 + axis[1] ** 2), axis[2]),
            robots=BodyState(
                position=placed.xpos[trunks],
                rotation=rotation,
                velocity=qvel[free],
                angular_velocity=jnp.einsum("rij,rj->ri", rotation, qvel[free + 3]),
                joint=self._of_joints(state.qpos, tables.joint_qpos),
                joint_rate=self._of_joints(qvel, tables.joint_dof),
            ),
            push_force=state.push_force,
            touching=state.touching,
            foot_force=state.foot_force,
            body_position=placed.xpos[np.array(tables.bodies)],
            body_quaternion=placed.xquat[np.array(tables.bodies)],
        )

    def _of_joints(self, values: Array, addresses: tuple[tuple[int, ...], ...]) -> Array:
        """[N_r, 4, 3] the entries of a vector that belong to the joints."""
        return values[np.array(addresses)].reshape(-1, 4, 3)

    def _data(self, state: PhysicsState) -> mjx.Data:
        fresh = mjx.make_data(self.model)
        return fresh.replace(qpos=state.qpos, qvel=state.qvel, qacc_warmstart=state.warmstart)

    def _step(self, state: PhysicsState, torque: Array) -> PhysicsState:
        """One physics step with the torques [nu] N m."""
        data = mjx.step(self.model, self._data(state).replace(ctrl=torque))
        push, touching, feet = self._contact_forces(data)
        w, x, y, z = data.qpos[self.tables.object_qpos + 3 : self.tables.object_qpos + 7]
        yaw = jnp.arctan2(2.0 * (w * z + x * y), 1.0 - 2.0 * (y * y + z * z))
        heading = state.heading + wrap_angle(yaw - state.heading)
        return PhysicsState(data.qpos, data.qvel, data.qacc_warmstart, heading, push, touching, feet)

    def _contact_forces(self, data: mjx.Data) -> tuple[Array, Array, Array]:
        """Push force [N_r] N, touch [N_r] bool and foot forces [N_r, 4, 3] N of a step.

        With an elliptic cone the three constraint forces of a contact are its force along the rows of the contact
        frame, acting on the second geom; MJX has every possible contact in a fixed place.
        """
        contact: Any = data._impl.contact
        rows = np.asarray(contact.efc_address)[:, None] + np.arange(3)
        local = data._impl.efc_force[rows]
        active = contact.dist < contact.includemargin
        local = jnp.where(active[:, None], local, 0.0)
        world = jnp.einsum("ci,cij->cj", local, contact.frame)
        feet = contact.geom[:, 1] == np.ravel(self.tables.foot_geom)[:, None]
        pushers = contact.geom[:, 0] == np.array(self.tables.pusher_geom)[:, None]
        foot_force = jnp.sum(jnp.where(feet[..., None], world, 0.0), axis=1)
        push = jnp.sum(jnp.where(pushers, local[:, 0], 0.0), axis=1)
        return push, jnp.any(pushers & active, axis=1), foot_force.reshape(-1, 4, 3)


def load_model(scene: Scene) -> MjxPhysics:
    """One scene on the default device."""
    model = _without_idle_statics(mjx.put_model(scene.model))
    return MjxPhysics(model, jnp.asarray(scene.qpos), jnp.asarray(np.asarray(scene.heading)), scene.tables)


def stack_models(scenes: Sequence[Scene]) -> MjxPhysics:
    """A batch [B, ...] of scenes, made with `build_scene(..., scenery=False)`.

    Raises:
      InputError: no scenes, or one that is built otherwise than the first.
    """
    if not scenes:
        raise InputError("scenes: at least one is needed")
    lanes = [load_model(scene) for scene in scenes]
    for i, scene in enumerate(scenes):
        for field in dataclasses.fields(scene.structure):
            value, expected = getattr(scene.structure, field.name), getattr(scenes[0].structure, field.name)
            if value != expected:
                raise InputError(f"scenes[{i}]: {field.name} = {value!r}: must be {expected!r} as in scenes[0]")
        if _build(lanes[i]) != _build(lanes[0]):
            raise InputError(f"scenes[{i}]: its model is built otherwise than that of scenes[0] (with scenery=False?)")
    return jax.tree.map(lambda *leaves: jnp.asarray(np.stack([np.asarray(leaf) for leaf in leaves])), *lanes)


def _without_idle_statics(model: Any) -> Any:
    """The model with zeros in those static fields that differ between scenes of one build and that MJX never reads.

    What is static must be equal in all lanes, and for a compiled function to be used again.
    """

    def blank(owner: Any, names: Sequence[str]) -> dict[str, Any]:
        return {name: np.zeros_like(getattr(owner, name)) for name in names}

    meshes = [f.name for f in dataclasses.fields(model) if f.name.startswith("mesh_")]
    implementation = model._impl.replace(**blank(model._impl, ["geom_rbound_hfield"]))
    return model.replace(_impl=implementation, **blank(model, [*_IDLE, *meshes]))


def _build(lane: MjxPhysics) -> tuple[Any, list[tuple[int, ...]]]:
    """What lanes must have in common: static parts and shapes."""
    leaves, structure = jax.tree.flatten(lane)
    return structure, [np.shape(leaf) for leaf in leaves]
