"""Recordings for the Rerun viewer: the scene in 3D and every signal of an episode, as one .rrd file."""

from __future__ import annotations

import uuid
from collections.abc import Iterable
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from jaxlocomanip.checked import InputError
from jaxlocomanip.closed_loop import Log
from jaxlocomanip.files import write_whole
from jaxlocomanip.recording import geometry, palette
from jaxlocomanip.recording.geometry import Mesh
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
from jaxlocomanip.recording.series import Line, plots
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
        raise InputError('recordings need Rerun: pip install "jaxlocomanip[view]"') from error
    from jaxlocomanip.recording.blueprint import layout

    episode = history(scenario, log)
    recording = rr.RecordingStream("jaxlocomanip", recording_id=str(uuid.uuid4()))
    memory = recording.memory_recording()
    recording.send_recording_name(name)
    curves = plots(episode)
    places = scene_points(episode)
    way = episode.scenario.goal.pose[:2] - episode.scenario.start[:2]
    recording.send_blueprint(layout(curves, places, way))
    recording.log("about", rr.TextDocument(_about(name, episode), media_type="text/markdown"), static=True)
    _send_ground(recording, episode, places)
    _send_bodies(recording, episode)
    _send_obstacles(recording, episode)
    _send_forces(recording, episode)
    _send_intentions(recording, episode)
    for plot in curves:
        for line in plot.lines:
            _send_line(recording, f"{plot.path}/{line.key}", line, episode.log.time)
    content = memory.drain_as_bytes()
    recording.disconnect()
    write_whole(Path(path), content)


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
| arrows in the robots' colours | pushes that act, {FORCE_SCALE:g} m per N |
| slate line | path in force |
| magenta line | planned motion of the object over the horizon |
| violet outline | reference pose now |
| black and magenta dots on the object | centre of mass: truth and estimate |
"""


def _columns(recording: RecordingStream, path: str, times: Floats, columns: Iterable[Any]) -> None:
    import rerun as rr

    from jaxlocomanip.recording.blueprint import TIMELINE

    recording.send_columns(path, indexes=[rr.TimeColumn(TIMELINE, duration=times.astype(float))], columns=columns)


def _send_line(recording: RecordingStream, path: str, line: Line, times: Floats) -> None:
    import rerun as rr

    mode = rr.components.InterpolationMode.StepAfter if line.steps else rr.components.InterpolationMode.Linear
    # From afar several ticks share a pixel: the mean of two states would be a state that never was.
    policy = rr.components.AggregationPolicy.MinMax if line.steps else rr.components.AggregationPolicy.Average
    style = rr.SeriesLines(
        colors=line.color,
        widths=line.width,
        names=line.label,
        interpolation_mode=mode,
        aggregation_policy=policy,
    )
    recording.log(path, style, static=True)
    if line.values.ndim == 0:
        times = times[[0, -1]] if len(times) > 1 else times
    values = np.broadcast_to(line.values, times.shape).astype(float)
    _columns(recording, path, times, rr.Scalars.columns(scalars=values))


def _send_mesh(recording: RecordingStream, path: str, mesh: Mesh) -> None:
    import rerun as rr

    archetype = rr.Mesh3D(
        vertex_positions=mesh.vertices.astype(np.float32),
        vertex_normals=mesh.normals.astype(np.float32),
        vertex_colors=mesh.colors,
        triangle_indices=mesh.triangles.astype(np.uint32),
    )
    recording.log(path, archetype, static=True)


def _send_poses(recording: RecordingStream, path: str, times: Floats, poses: Floats) -> None:
    """Move an entity by poses [T, 3]: m, m, rad."""
    import rerun as rr

    zero = np.zeros(len(poses))
    half = poses[:, 2] / 2.0
    translation = np.column_stack([poses[:, :2], zero])
    quaternion = np.column_stack([zero, zero, np.sin(half), np.cos(half)])
    _columns(recording, path, times, rr.Transform3D.columns(translation=translation, quaternion=quaternion))


def _closed(points: Floats, height: float) -> Floats:
    """A closed strip [V + 1, 3] through points [V, 2] at a height, m."""
    ring = np.concatenate([points, points[:1]])
    return np.column_stack([ring, np.full(len(ring), height)])


def _lifted(points: Floats, height: float) -> Floats:
    """Points [..., 2] in the plane, at a height: [..., 3] m."""
    return np.concatenate([points[..., :2], np.full((*points.shape[:-1], 1), height)], axis=-1)


def _send_ground(recording: RecordingStream, episode: History, places: Floats) -> None:
    import rerun as rr

    scenario = episode.scenario
    low, high = np.floor(places.min(axis=0)), np.ceil(places.max(axis=0))
    plane = geometry.prism(np.array([low, [high[0], low[1]], high, [low[0], high[1]]]), -0.02, 0.0, palette.GROUND)
    _send_mesh(recording, "world/ground", plane)
    lines = [[[x, low[1], 0.002], [x, high[1], 0.002]] for x in np.arange(low[0], high[0] + 0.5)]
    lines += [[[low[0], y, 0.002], [high[0], y, 0.002]] for y in np.arange(low[1], high[1] + 0.5)]
    recording.log("world/ground/grid", rr.LineStrips3D(lines, radii=0.004, colors=(196, 201, 208)), static=True)

    pose, goal = scenario.goal.pose, "world/goal"
    footprint = geometry.outline(scenario.object.vertices, 0.0)
    circle = geometry.outline(np.zeros((1, 2)), float(scenario.goal.position_tolerance)) + pose[:2]
    strips = [_closed(to_world(pose, footprint), 0.006), _closed(circle, 0.006)]
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
    _send_mesh(recording, "world/object", geometry.prism(footprint, 0.0, height, palette.OBJECT))
    edges = [_closed(footprint, height), _closed(footprint, 0.004)]
    edges += [np.array([[*p, 0.0], [*p, height]]) for p in footprint]
    recording.log("world/object/edges", rr.LineStrips3D(edges, radii=0.006, colors=palette.TRAIL), static=True)
    _send_poses(recording, "world/object", log.time, log.view.pose)
    top = height + 0.01
    truth = rr.Points3D([*scenario.truth.com, top], radii=0.03, colors=palette.INK)
    recording.log("world/object/com_truth", truth, static=True)
    estimate = "world/object/com_estimate"
    recording.log(estimate, rr.Points3D.from_fields(radii=0.024, colors=palette.PLAN), static=True)
    com = log.parameters[:, 2:4] / log.parameters[:, :1]
    _columns(recording, estimate, log.time, rr.Points3D.columns(positions=_lifted(com, top + 0.02)))
    for i, name in enumerate(robot_names(scenario)):
        path = f"world/robots/{name}"
        _send_mesh(recording, path, quadruped(ROBOT_TYPES[int(scenario.team.kind[i])], palette.robot_color(i)))
        _send_poses(recording, path, log.time, log.view.robots[:, i])


def _send_obstacles(recording: RecordingStream, episode: History) -> None:
    scenario, log = episode
    obstacles = scenario.obstacles
    for k in np.flatnonzero(obstacles.mask):
        moving = bool(obstacles.dynamic[k])
        path = f"world/obstacles/{k}_{'moving' if moving else 'still'}"
        shape = geometry.outline(obstacles.vertices[k], float(obstacles.radius[k]))
        color = palette.MOVING_OBSTACLE if moving else palette.OBSTACLE
        _send_mesh(recording, path, geometry.prism(shape, 0.0, OBSTACLE_HEIGHT, color))
        rows = slice(None) if moving else slice(0, 1)
        poses = np.pad(log.obstacles[rows, k], ((0, 0), (0, 1)))
        _send_poses(recording, path, log.time[rows], poses)


def _send_forces(recording: RecordingStream, episode: History) -> None:
    """Pushes that act, as arrows from the contact points over the object's top."""
    import rerun as rr

    scenario, log = episode
    height = float(scenario.object.height) + 0.05
    points = _lifted(contact_points(scenario, log.view.pose, log.view.offset), height)
    directions = _lifted(push_directions(scenario, log.view.pose), 0.0)
    vectors = FORCE_SCALE * log.view.force[..., None] * directions
    for i, name in enumerate(robot_names(scenario)):
        path = f"world/forces/{name}"
        recording.log(path, rr.Arrows3D.from_fields(colors=palette.robot_color(i), radii=0.028), static=True)
        _columns(recording, path, log.time, rr.Arrows3D.columns(origins=points[:, i], vectors=vectors[:, i]))


def _send_intentions(recording: RecordingStream, episode: History) -> None:
    """Path, plan and reference, and the trail of what became of them."""
    import rerun as rr

    scenario, log = episode
    period = float(log.time[1] - log.time[0]) if len(log.time) > 1 else BULKY_PERIOD

    def strips(path: str, times: Floats, points: Floats, color: palette.RGB, radius: float) -> None:
        recording.log(path, rr.LineStrips3D.from_fields(colors=color, radii=radius), static=True)
        _columns(recording, path, times, rr.LineStrips3D.columns(strips=points.astype(np.float32)))

    strips("world/path", log.path_time, _lifted(log.path, 0.012), palette.PATH, 0.008)
    rows = slice(None, None, max(1, round(BULKY_PERIOD / period)))
    strips("world/plan", log.time[rows], _lifted(log.plan[rows], 0.025), palette.PLAN, 0.014)
    rows = slice(None, None, max(1, round(TRAIL_PERIOD / period)))
    places = _lifted(log.view.pose[rows], 0.018)
    pieces = np.stack([places[:-1], places[1:]], axis=1)
    if len(pieces) > 0:
        strips("world/trail", log.time[rows][1:], pieces, palette.TRAIL, 0.012)
    footprint = geometry.outline(scenario.object.vertices, 0.0)
    outline = rr.LineStrips3D([_closed(footprint, 0.02)], radii=0.008, colors=palette.REFERENCE)
    recording.log("world/reference", outline, static=True)
    _send_poses(recording, "world/reference", log.time, log.report.target)
