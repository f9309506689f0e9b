"""Robots as parts of a scene: their MJCF read, checked and attached, with the contact pairs that they need."""

# Most of MuJoCo's names come out of its C library, where pyright cannot see them.
# pyright: reportAttributeAccessIssue=false

from __future__ import annotations

import importlib.resources
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import mujoco
import numpy as np
from numpy.typing import NDArray

from jaxlocomanip.checked import InputError
from jaxlocomanip.locomotion.robot import JOINTS, LEGS
from jaxlocomanip.robots.model import ROBOT_TYPES

Floats = NDArray[np.floating[Any]]

JOINT_NAMES: tuple[str, ...] = tuple(f"{leg}_{joint}" for leg in LEGS for joint in JOINTS)
"""[12] names of the motors, leg by leg; the joints' end in `_joint`"""


@dataclass(frozen=True)
class RobotPart:
    """A checked MJCF."""

    source: str
    spec: mujoco.MjSpec
    front: float
    """m, from the trunk's origin to the front of the pusher"""
    height: float
    """m, of the trunk's origin at the stand pose"""
    stand: Floats
    """[12] rad, leg by leg"""


def read_robot_part(source: str) -> RobotPart:
    """A robot's MJCF: that of a packaged type, else a file."""
    try:
        if source in ROBOT_TYPES:
            text = importlib.resources.files("jaxlocomanip.robots").joinpath(f"{source}.xml")
            spec = mujoco.MjSpec.from_string(text.read_text(encoding="utf-8"))
        else:
            spec = mujoco.MjSpec.from_file(source)
        model = spec.compile()
    except ValueError as error:
        reason = " ".join(str(error).split())
        raise InputError(f"robots: {source}: is not a readable MJCF ({reason})") from error
    for kind, names in (
        ("body", ["trunk"]),
        ("geom", ["pusher", *(f"{leg}_foot" for leg in LEGS)]),
        ("joint", [f"{name}_joint" for name in JOINT_NAMES]),
        ("actuator", JOINT_NAMES),
        ("key", ["stand"]),
    ):
        for name in names:
            if mujoco.mj_name2id(model, getattr(mujoco.mjtObj, f"mjOBJ_{kind.upper()}"), name) < 0:
                raise InputError(f"robots: {source}: has no {kind} named '{name}' (names as in the packaged robots)")
    _refuse_odd_motors(model, source)
    stand, data = model.key("stand").qpos, mujoco.MjData(model)
    data.qpos[:] = stand
    mujoco.mj_kinematics(model, data)
    pusher, trunk = model.geom("pusher").id, model.body("trunk").id
    reach = (data.geom_xpos[pusher] - data.xpos[trunk]) @ data.xmat[trunk].reshape(3, 3)
    return RobotPart(
        source=source,
        spec=spec,
        front=float(reach[0] + model.geom_size[pusher, 0]),
        height=float(data.xpos[trunk, 2]),
        stand=stand[[model.joint(f"{name}_joint").qposadr[0] for name in JOINT_NAMES]],
    )


def _refuse_odd_motors(model: mujoco.MjModel, source: str) -> None:
    """Refuse what would not do as the commands say: a body without free joint, a motor that is not a plain torque."""
    trunk = model.body("trunk")
    free = model.njnt and model.jnt_type[trunk.jntadr[0]] == mujoco.mjtJoint.mjJNT_FREE
    if not free or model.nu != 12:
        raise InputError(f"robots: {source}: must have a free joint on 'trunk' and 12 motors (it has {model.nu})")
    for name in ("pusher", *(f"{leg}_foot" for leg in LEGS)):
        if model.geom_type[model.geom(name).id] != mujoco.mjtGeom.mjGEOM_SPHERE:
            raise InputError(f"robots: {source}: geom '{name}' must be a sphere")
    plain = (
        (model.actuator_gaintype == mujoco.mjtGain.mjGAIN_FIXED)
        & (model.actuator_biastype == mujoco.mjtBias.mjBIAS_NONE)
        & (model.actuator_gainprm[:, 0] * model.actuator_gear[:, 0] == 1.0)
        & (model.actuator_ctrllimited == 1)
    )
    for index in np.flatnonzero(~plain):
        name = model.actuator(index).name
        raise InputError(f"robots: {source}: actuator '{name}' must be a motor of gear 1 with a ctrlrange")


def add_robot(spec: mujoco.MjSpec, robot: RobotPart, prefix: str) -> None:
    """Attach a robot, silence its geoms, and pair its feet with the floor and its pusher with the object."""
    child = robot.spec
    for key in list(child.keys):
        child.delete(key)
    for geom in child.geoms:
        geom.contype = geom.conaffinity = 0
    touching = {name: child.geom(name) for name in ("pusher", *(f"{leg}_foot" for leg in LEGS))}
    pairs = {n: (list(g.friction), list(g.solref), list(g.solimp)) for n, g in touching.items()}
    spec.worldbody.add_frame().attach_body(child.body("trunk"), prefix, "")
    for name, (friction, solref, solimp) in pairs.items():
        other = "object" if name == "pusher" else "floor"
        add_pair(spec, other, f"{prefix}{name}", friction, solref=solref, solimp=solimp)


def add_pair(spec: mujoco.MjSpec, first: str, second: str, friction: Sequence[float], **contact: Any) -> None:
    """A contact pair of two geoms by their names.

    Args:
      spec: the scene.
      first: name of a geom.
      second: name of another geom.
      friction: [3] as a geom's: sliding, torsional, rolling; of a pair of three dimensions only the first acts.
      **contact: solref and solimp; MuJoCo's defaults if left out. A pair inherits nothing from its geoms.
    """
    slide, spin, roll = friction
    spec.add_pair(
        geomname1=first, geomname2=second, condim=3, friction=[slide, slide, spin, roll, roll], margin=0.0, **contact
    )
