"""Robots as bodies in space, in a recording of a world that has them: meshes once, motion and forces over time."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from jaxlocomanip.recording import geometry, palette
from jaxlocomanip.recording.entities import lifted, send_columns, send_mesh, send_placements
from jaxlocomanip.recording.history import History, push_directions, rectangle, robot_names, rotated, to_world
from jaxlocomanip.recording.quadruped import feet
from jaxlocomanip.recording.real_meshes import real_meshes
from jaxlocomanip.recording.team import team

if TYPE_CHECKING:
    from rerun import RecordingStream

Floats = NDArray[np.floating[Any]]

FOOT_SCALE = 0.002
"""m of arrow per N of force on a foot"""
LOADED = 2.0
"""N, a foot with less has no arrow"""
ASIDE = 0.045
"""m, from the contact point to the measured force on one side and the commanded one on the other"""
ABOVE = 0.06
"""m, of these arrows over the object, which would hide them"""
LABELS = "world/labels"
"""entity path of the names of things"""
LABEL_HEIGHT = 0.25
"""m, of a name over what it names"""


def start_points(episode: History) -> tuple[Floats, Floats]:
    """Centre [3] of the object at the start, and corners [n, 3] of boxes about it and about the robots, m."""
    scenario, log = episode
    height, pose = float(scenario.object.height), log.view.pose[0]
    half = zip(scenario.team.half_length, scenario.team.half_width, strict=True)
    ground = [to_world(robot, rectangle(*size)) for robot, size in zip(log.view.robots[0], half, strict=True)]
    ground = np.concatenate([to_world(pose, geometry.outline(scenario.object.vertices, 0.0)), *ground])
    trunks = log.view.bodies.position[0, [member.first for member in team(episode)], 2]
    top = max(height, float(trunks.max()))
    return np.array([*pose[:2], 0.5 * height]), np.concatenate([lifted(ground, 0.0), lifted(ground, top)])


def send_object_motion(recording: RecordingStream, path: str, episode: History) -> None:
    """Move the object, which may tilt."""
    log = episode.log
    send_placements(recording, path, log.time, log.view.bodies.position[:, 0], log.view.bodies.quaternion[:, 0])


def send_robots(recording: RecordingStream, episode: History) -> None:
    """A mesh for each body of each robot, moved: its real shape where one is installed, else primitive solids."""
    log = episode.log
    bodies = log.view.bodies
    for member in team(episode):
        real = real_meshes(member.kind, member.color)
        # Not a mixture, of which some bodies would look like those of another robot.
        whole = all(part.name in real for part in member.parts)
        for row, part in enumerate(member.parts, start=member.first):
            path = f"world/robots/{member.name}/{part.name}"
            send_mesh(recording, path, real[part.name] if whole else part.mesh)
            send_placements(recording, path, log.time, bodies.position[:, row], bodies.quaternion[:, row])


def send_labels(recording: RecordingStream, episode: History, obstacle_height: float) -> None:
    """Names written over the robots, the obstacles and the goal.

    Args:
      recording: where to.
      episode: of a world with bodies.
      obstacle_height: m, of the obstacles as they are drawn.
    """
    import rerun as rr

    scenario, log = episode
    obstacles = scenario.obstacles
    shown = [("goal", "goal", lifted(scenario.goal.pose[None], 0.0))]
    for k in np.flatnonzero(obstacles.mask):
        text, count = ("moving obstacle", len(log.time)) if obstacles.dynamic[k] else ("obstacle", 1)
        shown.append((f"obstacle_{k}", text, lifted(log.obstacles[:count, k], obstacle_height)))
    for member in team(episode):
        shown.append((member.name, member.name, log.view.bodies.position[:, member.first]))
    for key, text, places in shown:
        path = f"{LABELS}/{key}"
        point = rr.Points3D.from_fields(radii=0.0, colors=(255, 255, 255), labels=text, show_labels=True)
        recording.log(path, point, static=True)
        columns = rr.Points3D.columns(positions=places + np.array([0.0, 0.0, LABEL_HEIGHT]))
        send_columns(recording, path, log.time[: len(places)], columns)


def send_foot_forces(recording: RecordingStream, episode: History) -> None:
    """The ground's forces on the feet that carry something, as arrows from their soles."""
    import rerun as rr

    log = episode.log
    bodies = log.view.bodies
    for i, member in enumerate(team(episode)):
        path = f"world/foot_forces/{member.name}"
        recording.log(path, rr.Arrows3D.from_fields(colors=palette.FOOT_FORCE, radii=0.012), static=True)
        shape = feet(member.kind)
        rows = member.first + shape.body
        center = bodies.position[:, rows] + rotated(bodies.quaternion[:, rows], shape.center)
        soles = center - np.multiply.outer(shape.radius, [0.0, 0.0, 1.0])
        force = bodies.foot_force[:, i]
        loaded = np.linalg.norm(force, axis=-1) >= LOADED
        columns = rr.Arrows3D.columns(origins=soles[loaded], vectors=FOOT_SCALE * force[loaded])
        send_columns(recording, path, log.time, columns.partition(np.sum(loaded, axis=1)))


def send_contact_forces(recording: RecordingStream, episode: History, scale: float) -> None:
    """Measured and commanded push of each robot, side by side over the point where it touches the object.

    Args:
      recording: where to.
      episode: of a world with bodies.
      scale: m of arrow per N.
    """
    import rerun as rr

    scenario, log = episode
    directions = lifted(push_directions(scenario, log.view), 0.0)
    left = np.stack([-directions[..., 1], directions[..., 0], directions[..., 2]], axis=-1)
    points = log.view.bodies.contact_point.astype(float)
    points[..., 2] = np.maximum(points[..., 2], float(scenario.object.height)) + ABOVE
    for i, name in enumerate(robot_names(scenario)):
        shown = (
            ("measured", log.view.force, ASIDE, palette.robot_color(i)),
            ("commanded", log.command.force, -ASIDE, palette.COMMAND),
        )
        for key, force, aside, color in shown:
            path = f"world/forces/{name}/{key}"
            recording.log(path, rr.Arrows3D.from_fields(colors=color, radii=0.022), static=True)
            origins = points[:, i] + aside * left[:, i]
            vectors = scale * force[:, i, None] * directions[:, i]
            send_columns(recording, path, log.time, rr.Arrows3D.columns(origins=origins, vectors=vectors))
