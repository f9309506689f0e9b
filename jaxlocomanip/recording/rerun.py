"""Recordings for the Rerun viewer: the scene in 3D and every signal of an episode, as one .rrd file."""

from __future__ import annotations

import uuid
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from jaxlocomanip.checked import InputError, installing
from jaxlocomanip.closed_loop import Log
from jaxlocomanip.files import write_whole
from jaxlocomanip.recording import bodies, geometry, palette
from jaxlocomanip.recording.entities import closed, lifted, send_columns, send_line, send_mesh, send_poses
from jaxlocomanip.recording.history import (
    History,
    contact_points,
    history,
    push_directions,
    robot_names,
    scene_points,
    to_world,
)
from jaxlocomanip.recording.quadruped import quadruped
from jaxlocomanip.recording.series import plots
from jaxlocomanip.robots.model import ROBOT_TYPES
from jaxlocomanip.scenario import Scenario

if TYPE_CHECKING:
    from rerun import RecordingStream

Floats = NDArray[np.floating[Any]]

FORCE_SCALE = 0.01
"""m of arrow per N of force"""
OBSTACLE_HEIGHT = 0.5
"""m, obstacles are drawn this high; the planner knows no height"""
BULKY_PERIOD = 0.04
"""s, least time between two drawn plans"""
TRAIL_PERIOD = 0.2
"""s, length of the pieces of the object's trail"""


def write_recording(path: Path, name: str, scenario: Scenario, log: Log) -> None:
    """Write an episode as a Rerun recording, whole or not at all.

    Args:
      path: the .rrd file; an existing one is replaced.
      name: of the episode, shown by the viewer.
      scenario: without batch axis.
      log: its trajectory, without batch axis.

    Raises:
      InputError: Rerun is not installed, or the file cannot be written.
    """
    try:
        import rerun as rr
    except ImportError as error:
        raise InputError(f"recordings need Rerun: {installing('view')}") from error
    from jaxlocomanip.recording.blueprint import CloseUp, layout

    episode = history(scenario, log)
    recording = rr.RecordingStream("jaxlocomanip", recording_id=str(uuid.uuid4()))
    memory = recording.memory_recording()
    recording.send_recording_name(name)
    curves = plots(episode)
    places = scene_points(episode)
    way = episode.scenario.goal.pose[:2] - episode.scenario.start[:2]
    close_up = None
    if episode.log.view.bodies is not None:
        close_up = CloseUp("world/object", *bodies.start_points(episode))
    recording.send_blueprint(layout(curves, places, way, close_up))
    recording.log("about", rr.TextDocument(_about(name, episode), media_type="text/markdown"), static=True)
    _send_ground(recording, episode, places)
    _send_bodies(recording, episode)
    _send_obstacles(recording, episode)
    _send_forces(recording, episode)
    _send_intentions(recording, episode)
    for plot in curves:
        for line in plot.lines:
            send_line(recording, f"{plot.path}/{line.key}", line, episode.log.time)
    content = memory.drain_as_bytes()
    recording.disconnect()
    write_whole(Path(path), content)


_PUSHES = f"""\
| arrows in the robots' colours | pushes that act, {FORCE_SCALE:g} m per N |"""
_BODIES = f"""\
| arrows over the object in the robots' colours | contact forces measured, {FORCE_SCALE:g} m per N |
| magenta arrows beside them | contact forces commanded, to the same scale |
| yellow arrows | forces of the ground on the feet, {bodies.FOOT_SCALE:g} m per N |"""


def _about(name: str, episode: History) -> str:
    scenario, log = episode
    team = ", ".join(robot_names(scenario))
    x, y, heading = scenario.goal.pose
    return f"""# {name}

Team: {team}. Duration: {log.time[-1]:.1f} s. Goal: ({x:.2f} m, {y:.2f} m, {heading:.2f} rad).

| In the scene | Meaning |
|---|---|
| tan body, brown line | the pushed object and the way it came |
| green outline, arrow, circle | goal footprint, heading and position tolerance |
| grey bodies | obstacles at rest |
| red bodies | moving obstacles |
{_PUSHES if log.view.bodies is None else _BODIES}
| slate line | path in force |
| magenta line | planned motion of the object over the horizon |
| violet outline | reference pose now |
| black and magenta dots on the object | centre of mass: truth and estimate |
"""


def _send_ground(recording: RecordingStream, episode: History, places: Floats) -> None:
    import rerun as rr

    scenario = episode.scenario
    low, high = np.floor(places.min(axis=0)), np.ceil(places.max(axis=0))
    plane = geometry.prism(np.array([low, [high[0], low[1]], high, [low[0], high[1]]]), -0.02, 0.0, palette.GROUND)
    send_mesh(recording, "world/ground", plane)
    lines = [[[x, low[1], 0.002], [x, high[1], 0.002]] for x in np.arange(low[0], high[0] + 0.5)]
    lines += [[[low[0], y, 0.002], [high[0], y, 0.002]] for y in np.arange(low[1], high[1] + 0.5)]
    recording.log("world/ground/grid", rr.LineStrips3D(lines, radii=0.004, colors=(196, 201, 208)), static=True)

    pose, goal = scenario.goal.pose, "world/goal"
    footprint = geometry.outline(scenario.object.vertices, 0.0)
    circle = geometry.outline(np.zeros((1, 2)), float(scenario.goal.position_tolerance)) + pose[:2]
    strips = [closed(to_world(pose, footprint), 0.006), closed(circle, 0.006)]
    recording.log(goal, rr.LineStrips3D(strips, radii=[0.015, 0.007], colors=palette.GOAL), static=True)
    length = 0.8 * float(np.max(np.linalg.norm(footprint, axis=1)))
    arrow = rr.Arrows3D(
        origins=[*pose[:2], 0.012],
        vectors=[length * np.cos(pose[2]), length * np.sin(pose[2]), 0.0],
        colors=palette.GOAL,
        radii=0.015,
    )
    recording.log(f"{goal}/heading", arrow, static=True)


def _send_bodies(recording: RecordingStream, episode: History) -> None:
    """The object with its centre of mass, and the robots."""
    import rerun as rr

    scenario, log = episode
    height = float(scenario.object.height)
    footprint = geometry.outline(scenario.object.vertices, 0.0)
    send_mesh(recording, "world/object", geometry.prism(footprint, 0.0, height, palette.OBJECT))
    edges = [closed(footprint, height), closed(footprint, 0.004)]
    edges += [np.array([[*p, 0.0], [*p, height]]) for p in footprint]
    recording.log("world/object/edges", rr.LineStrips3D(edges, radii=0.006, colors=palette.TRAIL), static=True)
    if log.view.bodies is None:
        send_poses(recording, "world/object", log.time, log.view.pose)
    else:
        bodies.send_object_motion(recording, "world/object", episode)
    top = height + 0.01
    truth = rr.Points3D([*scenario.truth.com, top], radii=0.03, colors=palette.INK)
    recording.log("world/object/com_truth", truth, static=True)
    estimate = "world/object/com_estimate"
    recording.log(estimate, rr.Points3D.from_fields(radii=0.024, colors=palette.PLAN), static=True)
    com = log.parameters[:, 2:4] / log.parameters[:, :1]
    send_columns(recording, estimate, log.time, rr.Points3D.columns(positions=lifted(com, top + 0.02)))
    if log.view.bodies is not None:
        bodies.send_robots(recording, episode)
        bodies.send_labels(recording, episode, OBSTACLE_HEIGHT)
        return
    for i, name in enumerate(robot_names(scenario)):
        path = f"world/robots/{name}"
        send_mesh(recording, path, quadruped(ROBOT_TYPES[int(scenario.team.kind[i])], palette.robot_color(i)))
        send_poses(recording, path, log.time, log.view.robots[:, i])


def _send_obstacles(recording: RecordingStream, episode: History) -> None:
    scenario, log = episode
    obstacles = scenario.obstacles
    for k in np.flatnonzero(obstacles.mask):
        moving = bool(obstacles.dynamic[k])
        path = f"world/obstacles/{k}_{'moving' if moving else 'still'}"
        shape = geometry.outline(obstacles.vertices[k], float(obstacles.radius[k]))
        color = palette.MOVING_OBSTACLE if moving else palette.OBSTACLE
        send_mesh(recording, path, geometry.prism(shape, 0.0, OBSTACLE_HEIGHT, color))
        rows = slice(None) if moving else slice(0, 1)
        poses = np.pad(log.obstacles[rows, k], ((0, 0), (0, 1)))
        send_poses(recording, path, log.time[rows], poses)


def _send_forces(recording: RecordingStream, episode: History) -> None:
    """Pushes that act, as arrows from the contact points over the object's top."""
    import rerun as rr

    scenario, log = episode
    if log.view.bodies is not None:
        bodies.send_contact_forces(recording, episode, FORCE_SCALE)
        bodies.send_foot_forces(recording, episode)
        return
    height = float(scenario.object.height) + 0.05
    points = lifted(contact_points(scenario, log.view), height)
    directions = lifted(push_directions(scenario, log.view), 0.0)
    vectors = FORCE_SCALE * log.view.force[..., None] * directions
    for i, name in enumerate(robot_names(scenario)):
        path = f"world/forces/{name}"
        recording.log(path, rr.Arrows3D.from_fields(colors=palette.robot_color(i), radii=0.028), static=True)
        send_columns(recording, path, log.time, rr.Arrows3D.columns(origins=points[:, i], vectors=vectors[:, i]))


def _send_intentions(recording: RecordingStream, episode: History) -> None:
    """Path, plan and reference, and the trail of what became of them."""
    import rerun as rr

    scenario, log = episode
    period = float(log.time[1] - log.time[0]) if len(log.time) > 1 else BULKY_PERIOD

    def strips(path: str, times: Floats, points: Floats, color: palette.RGB, radius: float) -> None:
        recording.log(path, rr.LineStrips3D.from_fields(colors=color, radii=radius), static=True)
        send_columns(recording, path, times, rr.LineStrips3D.columns(strips=points.astype(np.float32)))

    strips("world/path", log.path_time, lifted(log.path, 0.012), palette.PATH, 0.008)
    rows = slice(None, None, max(1, round(BULKY_PERIOD / period)))
    strips("world/plan", log.time[rows], lifted(log.plan[rows], 0.025), palette.PLAN, 0.014)
    rows = slice(None, None, max(1, round(TRAIL_PERIOD / period)))
    places = lifted(log.view.pose[rows], 0.018)
    pieces = np.stack([places[:-1], places[1:]], axis=1)
    if len(pieces) > 0:
        strips("world/trail", log.time[rows][1:], pieces, palette.TRAIL, 0.012)
    footprint = geometry.outline(scenario.object.vertices, 0.0)
    outline = rr.LineStrips3D([closed(footprint, 0.02)], radii=0.008, colors=palette.REFERENCE)
    recording.log("world/reference", outline, static=True)
    send_poses(recording, "world/reference", log.time, log.report.target)
