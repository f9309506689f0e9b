"""Reads a quadruped's parameters from its MJCF as MuJoCo compiles it, so that no number is typed twice."""

# Most of MuJoCo's names come out of its C library, where pyright cannot see them.
# pyright: reportAttributeAccessIssue=false

from __future__ import annotations

import importlib.resources
from pathlib import Path

import jax.numpy as jnp
import mujoco
import numpy as np

from jaxlocomanip.checked import InputError
from jaxlocomanip.locomotion.robot import JOINTS, LEGS, LeggedRobot
from jaxlocomanip.robots.model import ROBOT_TYPES

TRUNK, PUSHER, STAND = "trunk", "pusher", "stand"
"""names of the floating body, the geom that pushes and the keyframe of the standing robot"""
LENGTH_TOLERANCE = 2e-3
"""m, by which links may differ from the kinematics assumed, or from leg to leg"""
AXIS_TOLERANCE = 1e-3


def robot_path(path_or_name: str | Path) -> Path:
    """The MJCF of a packaged robot by its name, or the given path."""
    if path_or_name in ROBOT_TYPES:
        return Path(str(importlib.resources.files("jaxlocomanip.robots").joinpath(f"{path_or_name}.xml")))
    return Path(path_or_name)


def read_robot(path_or_name: str | Path) -> LeggedRobot:
    """Parameters of one robot.

    Args:
      path_or_name: a name out of `robots.model.ROBOT_TYPES`, or the path of an MJCF that names its parts like the
        packaged ones: body `trunk` with a freejoint; joints `FR_hip_joint`, `FR_thigh_joint`, `FR_calf_joint` and
        so on for FR, FL, RR, RL, each with one motor; sphere geoms `FR_foot`, ... and `pusher`; keyframe `stand`.

    Raises:
      InputError: the file is missing, is no MJCF, lacks a part, or its legs are built otherwise; the text names the
        file and what is needed.
    """
    path = robot_path(path_or_name)
    if not path.is_file():
        raise InputError(f"robot = {str(path_or_name)!r}: must be one of {', '.join(ROBOT_TYPES)} or an MJCF file")
    try:
        model = mujoco.MjModel.from_xml_path(str(path))
    except ValueError as error:
        raise InputError(f"{path}: not a model that MuJoCo can read: {' '.join(str(error).split())}") from error
    _check_names(model, path)
    stand, zero = _postures(model)
    trunk, rotation = _trunk(stand)
    mass, inertia, com = _rigid_body(model, stand)
    hip, abduction, thigh, calf = _links(zero, path)
    link_mass, link_com = _link_masses(model, zero)
    ranges = np.array([model.joint(name).range for name in joint_names()])
    radii = np.array([model.geom(f"{leg}_foot").size[0] for leg in LEGS])
    soles = np.array([stand.geom(f"{leg}_foot").xpos[2] for leg in LEGS]) - radii
    numbers = {
        "mass": mass,
        "inertia": inertia,
        "com": com,
        "hip": hip,
        "abduction": abduction,
        "thigh": thigh,
        "calf": calf,
        "foot_radius": _common(radii, "radii of the feet", path),
        "joint_low": ranges[:, 0].reshape(4, 3),
        "joint_high": ranges[:, 1].reshape(4, 3),
        "torque_max": _torques(model, path).reshape(4, 3),
        "stand": np.array([stand.joint(name).qpos[0] for name in joint_names()]).reshape(4, 3),
        "stand_height": trunk[2] - np.mean(soles),
        "pusher": rotation.T @ (stand.geom(PUSHER).xpos - trunk),
        "pusher_radius": model.geom(PUSHER).size[0],
        "link_mass": link_mass,
        "link_com": link_com,
        "leg_inertia": _leg_inertia(model, stand),
        "joint_damping": np.array([model.dof_damping[d] for d in _dofs(model)]).reshape(4, 3),
    }
    return LeggedRobot(**{name: jnp.asarray(value, jnp.result_type(float)) for name, value in numbers.items()})


def joint_names() -> list[str]:
    """The twelve joints in the order of `JointCommand`, leg by leg."""
    return [f"{leg}_{joint}_joint" for leg in LEGS for joint in JOINTS]


def _check_names(model: mujoco.MjModel, path: Path) -> None:
    """Refuse a model that lacks a part or has it of another kind."""
    kinds, geoms, hinges = mujoco.mjtObj, [PUSHER, *(f"{leg}_foot" for leg in LEGS)], joint_names()
    wanted = [(kinds.mjOBJ_BODY, "body", TRUNK)]
    wanted += [(kinds.mjOBJ_JOINT, "hinge joint", name) for name in hinges]
    wanted += [(kinds.mjOBJ_GEOM, "sphere geom", name) for name in geoms]
    wanted += [(kinds.mjOBJ_KEY, "keyframe", STAND)]
    missing = [f"{text} '{name}'" for kind, text, name in wanted if mujoco.mj_name2id(model, kind, name) < 0]
    if missing:
        raise InputError(f"{path}: needs {', '.join(missing)}")
    trunk = model.body(TRUNK)
    floats = trunk.jntnum[0] == 1 and model.jnt_type[trunk.jntadr[0]] == mujoco.mjtJoint.mjJNT_FREE
    wrong = [f"body '{TRUNK}' must have a freejoint"] * (not floats)
    for name in hinges:
        joint = model.joint(name)
        wrong += [f"joint '{name}' must be a hinge"] * (joint.type[0] != mujoco.mjtJoint.mjJNT_HINGE)
        wrong += [f"joint '{name}' must have a range"] * (not model.jnt_limited[joint.id])
    spheres = mujoco.mjtGeom.mjGEOM_SPHERE
    wrong += [f"geom '{name}' must be a sphere" for name in geoms if model.geom(name).type[0] != spheres]
    if wrong:
        raise InputError(f"{path}: {', '.join(wrong)}")


def _postures(model: mujoco.MjModel) -> tuple[mujoco.MjData, mujoco.MjData]:
    """The model at its stand pose, and with all joints at zero, where links and axes show."""
    stand, zero = mujoco.MjData(model), mujoco.MjData(model)
    mujoco.mj_resetDataKeyframe(model, stand, model.key(STAND).id)
    zero.qpos[:] = stand.qpos
    for name in joint_names():
        zero.joint(name).qpos[0] = 0.0
    for data in (stand, zero):
        mujoco.mj_forward(model, data)
    return stand, zero


def _trunk(data: mujoco.MjData) -> tuple[np.ndarray, np.ndarray]:
    """Origin [3] m and rotation [3, 3] of the trunk."""
    return data.body(TRUNK).xpos, data.body(TRUNK).xmat.reshape(3, 3)


def _rigid_body(model: mujoco.MjModel, data: mujoco.MjData) -> tuple[float, np.ndarray, np.ndarray]:
    """Mass kg, inertia [3, 3] kg m^2 about the COM and COM [3] m from the trunk's origin, both in body axes.

    The floating joint's block of the mass matrix is that of the whole robot with its joints locked.
    """
    first = int(model.body(TRUNK).dofadr[0])
    block = _mass_matrix(model, data)[first : first + 6, first : first + 6]
    mass = float(block[0, 0])
    origin, rotation = _trunk(data)
    com = rotation.T @ (data.subtree_com[model.body(TRUNK).id] - origin)
    return mass, block[3:, 3:] - mass * (com @ com * np.eye(3) - np.outer(com, com)), com


def _mass_matrix(model: mujoco.MjModel, data: mujoco.MjData) -> np.ndarray:
    """[nv, nv], column by column: functions that return it whole differ between MuJoCo's releases."""
    full = np.zeros((model.nv, model.nv))
    for row, unit in zip(full, np.eye(model.nv), strict=True):
        mujoco.mj_mulM(model, data, row, unit)
    return full


def _dofs(model: mujoco.MjModel) -> list[int]:
    """[12] addresses of the joints' velocities."""
    return [int(model.joint(name).dofadr[0]) for name in joint_names()]


def _leg_inertia(model: mujoco.MjModel, data: mujoco.MjData) -> np.ndarray:
    """[4, 3, 3] kg m^2, each leg's block of the mass matrix."""
    legs, full = np.array(_dofs(model)).reshape(4, 3), _mass_matrix(model, data)
    return np.array([full[np.ix_(leg, leg)] for leg in legs])


def _links(zero: mujoco.MjData, path: Path) -> tuple[np.ndarray, np.ndarray, float, float]:
    """Hips [4, 3], signed abduction [4], lengths of thigh and calf, m, from the pose with all joints at zero."""
    origin, rotation = _trunk(zero)
    anchor = np.array([zero.joint(name).xanchor for name in joint_names()]).reshape(4, 3, 3)
    axis = np.array([zero.joint(name).xaxis for name in joint_names()]).reshape(4, 3, 3) @ rotation
    foot = np.array([zero.geom(f"{leg}_foot").xpos for leg in LEGS])[:, None]
    link = np.diff(np.concatenate([anchor, foot], axis=1), axis=1) @ rotation

    turns = np.array([[1.0, 0.0, 0.0], [0.0, 1.0, 0.0], [0.0, 1.0, 0.0]])
    straight = [link[:, 0, [0, 2]], link[:, 1, :2], link[:, 2, :2]]
    if np.abs(axis - turns).max() > AXIS_TOLERANCE or max(np.abs(part).max() for part in straight) > LENGTH_TOLERANCE:
        raise InputError(
            f"{path}: legs must have a hip axis along x, thigh and calf axes along y, the thigh's joint beside the "
            "hip's, and thigh and calf straight down when all joints are at zero"
        )
    thigh = _common(-link[:, 1, 2], "lengths of the thighs", path)
    calf = _common(-link[:, 2, 2], "lengths of the calves, to the foot's centre,", path)
    return (anchor[:, 0] - origin) @ rotation, link[:, 0, 1], thigh, calf


def _link_masses(model: mujoco.MjModel, zero: mujoco.MjData) -> tuple[np.ndarray, np.ndarray]:
    """Masses [4, 3] kg of the links and their COMs [4, 3, 3] m from their joints, at zero angles."""
    _, rotation = _trunk(zero)
    body = [int(model.joint(name).bodyid[0]) for name in joint_names()]
    total = model.body_subtreemass[body].reshape(4, 3)
    moment = total[..., None] * zero.subtree_com[body].reshape(4, 3, 3)
    # A link is what hangs on its joint less what hangs on the next one.
    mass, own = total.copy(), moment.copy()
    mass[:, :2] -= total[:, 1:]
    own[:, :2] -= moment[:, 1:]
    anchor = np.array([zero.joint(name).xanchor for name in joint_names()]).reshape(4, 3, 3)
    return mass, (own / mass[..., None] - anchor) @ rotation


def _common(values: np.ndarray, what: str, path: Path) -> float:
    """The value that all four legs have."""
    if np.ptp(values) > LENGTH_TOLERANCE or values.min() <= 0.0:
        raise InputError(f"{path}: {what} must be positive and the same for all legs, not {values.round(4).tolist()}")
    return float(values.mean())


def _torques(model: mujoco.MjModel, path: Path) -> np.ndarray:
    """[12] N m, largest torque of each joint's motor."""
    limits = []
    for name in joint_names():
        joint = model.joint(name).id
        motors = [a for a in range(model.nu) if model.actuator_trnid[a, 0] == joint]
        if len(motors) != 1:
            raise InputError(f"{path}: joint '{name}' needs one motor, it has {len(motors)}")
        (motor,) = motors
        gear, gain = abs(model.actuator_gear[motor, 0]), abs(model.actuator_gainprm[motor, 0])
        bounds = [np.inf]
        if model.actuator_forcelimited[motor]:
            bounds.append(gear * np.abs(model.actuator_forcerange[motor]).min())
        if model.actuator_ctrllimited[motor] and not model.actuator_biastype[motor]:
            bounds.append(gear * gain * np.abs(model.actuator_ctrlrange[motor]).min())
        if model.jnt_actfrclimited[joint]:
            bounds.append(np.abs(model.jnt_actfrcrange[joint]).min())
        if not np.isfinite(min(bounds)):
            raise InputError(f"{path}: the motor of joint '{name}' needs a ctrlrange or forcerange")
        limits.append(min(bounds))
    return np.array(limits)
