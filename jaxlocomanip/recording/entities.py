"""Small steps of writing a recording: columns of values over time, meshes that stay, poses that move them."""

from __future__ import annotations

from collections.abc import Iterable
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from jaxlocomanip.recording.geometry import Mesh
from jaxlocomanip.recording.series import Line

if TYPE_CHECKING:
    from rerun import RecordingStream

Floats = NDArray[np.floating[Any]]


def send_columns(recording: RecordingStream, path: str, times: Floats, columns: Iterable[Any]) -> None:
    """Send rows at times [T] s."""
    import rerun as rr

    from jaxlocomanip.recording.blueprint import TIMELINE

    recording.send_columns(path, indexes=[rr.TimeColumn(TIMELINE, duration=times.astype(float))], columns=columns)


def send_line(recording: RecordingStream, path: str, line: Line, times: Floats) -> None:
    """Send a curve of a plot at times [T] s, with its looks."""
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
    send_columns(recording, path, times, rr.Scalars.columns(scalars=values))


def send_mesh(recording: RecordingStream, path: str, mesh: Mesh) -> None:
    """Send a mesh that stays as it is; poses may move it."""
    import rerun as rr

    archetype = rr.Mesh3D(
        vertex_positions=mesh.vertices.astype(np.float32),
        vertex_normals=mesh.normals.astype(np.float32),
        vertex_colors=mesh.colors,
        triangle_indices=mesh.triangles.astype(np.uint32),
    )
    recording.log(path, archetype, static=True)


def send_poses(recording: RecordingStream, path: str, times: Floats, poses: Floats) -> None:
    """Move an entity by poses [T, 3]: m, m, rad."""
    import rerun as rr

    zero = np.zeros(len(poses))
    half = poses[:, 2] / 2.0
    translation = np.column_stack([poses[:, :2], zero])
    quaternion = np.column_stack([zero, zero, np.sin(half), np.cos(half)])
    send_columns(recording, path, times, rr.Transform3D.columns(translation=translation, quaternion=quaternion))


def send_placements(recording: RecordingStream, path: str, times: Floats, position: Floats, quaternion: Floats) -> None:
    """Move an entity in space by positions [T, 3] m and quaternions [T, 4], w, x, y, z."""
    import rerun as rr

    xyzw = np.roll(quaternion, -1, axis=-1)
    send_columns(recording, path, times, rr.Transform3D.columns(translation=position, quaternion=xyzw))


def closed(points: Floats, height: float) -> Floats:
    """A closed strip [V + 1, 3] through points [V, 2] at a height, m."""
    ring = np.concatenate([points, points[:1]])
    return np.column_stack([ring, np.full(len(ring), height)])


def lifted(points: Floats, height: float) -> Floats:
    """Points [..., 2] in the plane, at a height: [..., 3] m."""
    return np.concatenate([points[..., :2], np.full((*points.shape[:-1], 1), height)], axis=-1)
