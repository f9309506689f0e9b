"""The scene of the quadruped world as one MuJoCo model: floor, object with its true mechanics, robots, obstacles.

Contacts are explicit pairs and nothing else collides: feet and floor, object and floor, each robot's pusher and the
object. So a robot does not feel obstacles, other robots, or the object with anything but its pusher (overlaps are
found by geometry), and one that falls sinks through the floor with its trunk.

Sliding friction of object and floor is that of the scenario's truth. Its torsion is not set: it arises from the
contacts under the corners, which give more than the uniform pressure behind `truth.friction_moment` does (a square
box turns on the spot against mu m g times half its diagonal, 1.85 times that).
"""

# Most of MuJoCo's names come out of its C library, where pyright cannot see them.
# pyright: reportAttributeAccessIssue=false

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import jax.numpy as jnp
import mujoco
import numpy as np
from numpy.typing import NDArray

from jaxlocomanip import checked, checked_arrays
from jaxlocomanip.checked import InputError
from jaxlocomanip.footprint import placed, polygon_gap
from jaxlocomanip.locomotion.robot import LEGS
from jaxlocomanip.planar.dynamics import GRAVITY
from jaxlocomanip.robots.model import ROBOT_TYPES
from jaxlocomanip.scenario import Scenario
from jaxlocomanip.worlds import scene_shapes
from jaxlocomanip.worlds.scene_robots import JOINT_NAMES, RobotPart, add_pair, add_robot, read_robot_part

Floats = NDArray[np.floating[Any]]

STANDOFF = 0.15
"""m, from the pusher to the face at the start, where there is room"""
ROOM_BEHIND = 0.05
"""m to obstacles, up to which a robot starts nearer to its face instead"""
STEPS_BACK = 31
"""distances from the face that are tried"""
TIMESTEP = 0.002
"""s"""


@dataclass(frozen=True)
class Tables:
    """Where things are in the arrays of the model; hashable, so that compiled functions may take it as static."""

    trunk_body: tuple[int, ...]
    """[N_r]"""
    trunk_qpos: tuple[int, ...]
    """[N_r] first address of the free joint"""
    trunk_dof: tuple[int, ...]
    """[N_r]"""
    joint_qpos: tuple[tuple[int, ...], ...]
    """[N_r, 12] leg by leg"""
    joint_dof: tuple[tuple[int, ...], ...]
    """[N_r, 12]"""
    actuator: tuple[tuple[int, ...], ...]
    """[N_r, 12]"""
    foot_geom: tuple[tuple[int, ...], ...]
    """[N_r, 4]"""
    pusher_geom: tuple[int, ...]
    """[N_r]"""
    object_body: int
    object_qpos: int
    object_dof: int
    bodies: tuple[int, ...]
    """[n_b] the object's and all robots' bodies, for recording"""


@dataclass(frozen=True)
class Structure:
    """What scenes must share to be lanes of one batch."""

    robots: tuple[str, ...]
    """type or file of each robot"""
    corners: int
    """corners of the object's footprint"""
    box: bool
    """the footprint is a rectangle"""
    joint_limits: bool


@dataclass(frozen=True)
class Scene:
    """A model with its index tables and its start."""

    model: mujoco.MjModel
    tables: Tables
    structure: Structure
    qpos: Floats
    """[nq] at the start"""
    heading: float
    """rad, of the object at the start, not wrapped"""
    body_names: tuple[str, ...]
    """[n_b] names of `tables.bodies`; those of robot i begin with `r<i>/`"""
    mocap: tuple[int, ...]
    """[N_o] number of each obstacle among the mocap bodies, -1 where it does not move"""


def build_scene(
    scenario: Scenario,
    *,
    robots: Sequence[str | Path] | None = None,
    standoff: float = STANDOFF,
    timestep: float = TIMESTEP,
    joint_limits: bool = True,
    scenery: bool = True,
) -> Scene:
    """The scene of one scenario, robots standing before their faces and the object at rest.

    Args:
      scenario: without batch axis.
      robots: MJCF file of each robot, with the names of the packaged ones; those of the team's types by default.
      standoff: m, from the pushers to their faces, >= 0; less for a robot with an obstacle behind it (`standoffs`).
      timestep: s.
      joint_limits: keep the joints' ranges. They cost nothing in MuJoCo C, where only a limit that is reached adds a
        constraint, and 10 to 20 % of a batch's speed in MJX, which carries one for each joint.
      scenery: lights, sky, a checkered floor and the obstacles. None of it acts; the lanes of a batch leave it out,
        because their models must be alike.

    Raises:
      InputError: a batch, a bad number, or an MJCF that is missing, broken or without the names.
    """
    checked_arrays.single("scenario", scenario)
    checked.number("standoff", standoff, 0.0, 10.0)
    team = [read_robot_part(source) for source in _sources(scenario, robots)]
    spec = mujoco.MjSpec()
    _set_options(spec, timestep, joint_limits)
    floor = scene_shapes.add_floor(spec)
    _add_object(spec, scenario)
    for i, robot in enumerate(team):
        add_robot(spec, robot, f"r{i}/")
    mocap: tuple[int, ...] = ()
    if scenery:
        scene_shapes.add_scenery(spec, floor, scenario)
        mocap = scene_shapes.add_obstacles(spec, scenario.obstacles)
    model = spec.compile()
    tables, corners = _tables(model, len(team)), scene_shapes.footprint(scenario.object)
    box = scene_shapes.as_rectangle(corners) is not None
    return Scene(
        model=model,
        tables=tables,
        structure=Structure(tuple(robot.source for robot in team), len(corners), box, joint_limits),
        qpos=_start(model, tables, scenario, team, standoff),
        heading=float(scenario.start[2]),
        body_names=tuple(model.body(b).name for b in tables.bodies),
        mocap=mocap,
    )


def _sources(scenario: Scenario, robots: Sequence[str | Path] | None) -> list[str]:
    kinds = [ROBOT_TYPES[int(k)] for k in np.asarray(scenario.team.kind)]
    if robots is None:
        return kinds
    if isinstance(robots, str | Path) or len(robots) != len(kinds):
        raise InputError(f"robots = {robots!r}: must be {len(kinds)} MJCF files, one for each robot of the team")
    return [str(path) for path in robots]


def _set_options(spec: mujoco.MjSpec, timestep: float, joint_limits: bool) -> None:
    option, disable = spec.option, mujoco.mjtDisableBit
    option.timestep = checked.number("timestep", timestep, 1e-4, 0.005)
    option.gravity = [0.0, 0.0, -GRAVITY]
    option.solver = mujoco.mjtSolver.mjSOL_NEWTON
    # A pyramidal cone slides early in the diagonal; fewer iterations let the object creep; a higher impratio would
    # hold it better at rest, but with so few iterations biases the forces on trotting feet.
    option.cone = mujoco.mjtCone.mjCONE_ELLIPTIC
    option.iterations, option.ls_iterations, option.impratio = 4, 8, 1.0
    # No reset to the model's default pose: a simulation that blew up must end in NaN, not go on somewhere else.
    flags = [disable.mjDSBL_EULERDAMP, disable.mjDSBL_AUTORESET, *([] if joint_limits else [disable.mjDSBL_LIMIT])]
    option.disableflags = sum(int(flag) for flag in flags)


def _add_object(spec: mujoco.MjSpec, scenario: Scenario) -> None:
    """The object with its true mechanics, and its contact with the floor."""
    truth = scenario.truth
    mass, sliding = float(truth.mass), float(truth.friction_force)
    com, about_p = np.asarray(truth.com, dtype=float), float(truth.inertia)
    # The floor is that of `Body.central_inertia`, so that all worlds take the same object from one truth.
    inertia = max(about_p - mass * float(com @ com), 0.05 * about_p)
    for geom in scene_shapes.add_object(spec, scenario.object, mass, com, inertia):
        add_pair(spec, "floor", geom, [sliding / (mass * GRAVITY), 0.0, 0.0])


def standoffs(scenario: Scenario, most: float) -> Floats:
    """[N_r] m, from each pusher to its face at the start.

    A scenario promises room for robots that touch the object, not for what lies behind them. So a robot starts less
    than `most` away where it would come within `ROOM_BEHIND` of an obstacle, or nearer to it than at its face.
    """
    obstacles, team = scenario.obstacles, scenario.team
    present = np.asarray(obstacles.mask)
    shapes = np.asarray(obstacles.vertices, dtype=float) + np.asarray(obstacles.at(jnp.zeros(())), dtype=float)[:, None]
    poses = np.asarray(team.robot_poses(scenario.start, team.offset), dtype=float)
    backward = -np.stack([np.cos(poses[:, 2]), np.sin(poses[:, 2])], axis=-1)
    corners = np.array([[-1.0, -1.0], [1.0, -1.0], [1.0, 1.0], [-1.0, 1.0]])
    rectangles = corners * np.stack([team.half_length, team.half_width], axis=-1)[:, None]
    tried = np.linspace(0.0, most, STEPS_BACK)
    moved = poses + tried[:, None, None] * np.pad(backward, ((0, 0), (0, 1)))
    gaps = polygon_gap(placed(moved, rectangles)[:, :, None], shapes, np.asarray(obstacles.radius))
    room = np.where(present, gaps, np.inf).min(axis=2)
    enough = room >= np.minimum(room[0], ROOM_BEHIND)
    # The first step that lacks room ends the way back, whatever is behind it.
    return tried[np.cumprod(enough, axis=0, dtype=int).sum(axis=0) - 1]


def _start(
    model: mujoco.MjModel, tables: Tables, scenario: Scenario, team: Sequence[RobotPart], standoff: float
) -> Floats:
    """[nq] the object at its start pose, each robot at its stand pose before its contact point and facing it."""
    away = standoffs(scenario, standoff)
    qpos = model.qpos0.copy()
    pose = np.asarray(scenario.start, dtype=float)
    qpos[tables.object_qpos :][:7] = [pose[0], pose[1], 0.0, *_upright(pose[2])]
    c, s = np.cos(pose[2]), np.sin(pose[2])
    turn = np.array([[c, -s], [s, c]])
    points = pose[:2] + np.asarray(scenario.team.contact_points(scenario.team.offset), dtype=float) @ turn.T
    normals = np.asarray(scenario.team.normal, dtype=float) @ turn.T
    for i, robot in enumerate(team):
        x, y = points[i] - (robot.front + away[i]) * normals[i]
        heading = np.arctan2(normals[i, 1], normals[i, 0])
        qpos[tables.trunk_qpos[i] :][:7] = [x, y, robot.height, *_upright(heading)]
        qpos[list(tables.joint_qpos[i])] = robot.stand
    return qpos


def _upright(yaw: float) -> tuple[float, float, float, float]:
    """Quaternion wxyz of a turn about the vertical."""
    return float(np.cos(0.5 * yaw)), 0.0, 0.0, float(np.sin(0.5 * yaw))


def _tables(model: mujoco.MjModel, count: int) -> Tables:
    prefixes = [f"r{i}/" for i in range(count)]
    trunks = [model.body(f"{p}trunk") for p in prefixes]
    free = [model.joint(int(body.jntadr[0])) for body in trunks]
    hinges = [[model.joint(f"{p}{name}_joint") for name in JOINT_NAMES] for p in prefixes]
    box = model.joint("object")
    names = [model.body(b).name for b in range(model.nbody)]
    return Tables(
        trunk_body=tuple(body.id for body in trunks),
        trunk_qpos=tuple(int(j.qposadr[0]) for j in free),
        trunk_dof=tuple(int(j.dofadr[0]) for j in free),
        joint_qpos=tuple(tuple(int(j.qposadr[0]) for j in row) for row in hinges),
        joint_dof=tuple(tuple(int(j.dofadr[0]) for j in row) for row in hinges),
        actuator=tuple(tuple(model.actuator(f"{p}{name}").id for name in JOINT_NAMES) for p in prefixes),
        foot_geom=tuple(tuple(model.geom(f"{p}{leg}_foot").id for leg in LEGS) for p in prefixes),
        pusher_geom=tuple(model.geom(f"{p}pusher").id for p in prefixes),
        object_body=model.body("object").id,
        object_qpos=int(box.qposadr[0]),
        object_dof=int(box.dofadr[0]),
        bodies=tuple(b for b, name in enumerate(names) if name == "object" or name.startswith(tuple(prefixes))),
    )
