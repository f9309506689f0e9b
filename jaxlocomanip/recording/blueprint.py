"""How the Rerun viewer lays a recording out: the scene on the left, tabs of time series on the right."""

from __future__ import annotations

from typing import Any

import numpy as np
import rerun.blueprint as rrb
from numpy.typing import NDArray

from jaxlocomanip.recording.series import Plot

Floats = NDArray[np.floating[Any]]

TIMELINE = "sim_time"
"""Name of the recordings' timeline, in seconds."""

_ELEVATION = 0.85
"""rad, how steeply the camera looks down"""
_ASIDE = 1.15
"""rad, how far left of the way from start to goal the camera looks: the team moves to the right and away"""
_OPENING = (0.54, 0.44)
"""tangents of the half-angles that the scene may fill, sideways and upwards; the viewer opens 55 degrees"""


def layout(plots: list[Plot], places: Floats, way: Floats) -> rrb.Blueprint:
    """The blueprint of a recording.

    Args:
      plots: its time series.
      places: [n, 2] m, what the camera shall show.
      way: [2] m, from start to goal.
    """
    tabs = []
    for tab in dict.fromkeys(plot.tab for plot in plots):
        views = [_plot_view(plot) for plot in plots if plot.tab == tab]
        tabs.append(rrb.Vertical(*views, name=tab))
    about = rrb.TextDocumentView(origin="about", name="About")
    return rrb.Blueprint(
        rrb.Horizontal(_scene_view(places, way), rrb.Tabs(*tabs, about, active_tab=0), column_shares=[5, 3]),
        rrb.BlueprintPanel(state="collapsed"),
        rrb.SelectionPanel(state="collapsed"),
        rrb.TimePanel(state="collapsed", timeline=TIMELINE),
    )


def _scene_view(places: Floats, way: Floats) -> rrb.Spatial3DView:
    eye, target = camera(places, way)
    past = rrb.VisibleTimeRanges(
        timeline=TIMELINE, start=rrb.TimeRangeBoundary.infinite(), end=rrb.TimeRangeBoundary.cursor_relative()
    )
    return rrb.Spatial3DView(
        origin="world",
        name="Scene",
        background=rrb.Background(color=(250, 251, 252)),
        line_grid=rrb.LineGrid3D(visible=False),
        eye_controls=rrb.EyeControls3D(
            kind=rrb.Eye3DKind.Orbital, position=eye, look_target=target, eye_up=(0.0, 0.0, 1.0)
        ),
        overrides={"world/trail": past},  # pyright: ignore[reportArgumentType]
    )


def camera(places: Floats, way: Floats) -> tuple[Floats, Floats]:
    """Position and target [3], m, of a camera that sees all places and no more ground than it must.

    Args:
      places: [n, 2] m, on the ground.
      way: [2] m, motion that the camera shall see from the side.
    """
    azimuth = np.arctan2(way[1], way[0]) + _ASIDE
    level = np.array([np.cos(azimuth), np.sin(azimuth), 0.0])
    forward = np.cos(_ELEVATION) * level - np.array([0.0, 0.0, np.sin(_ELEVATION)])
    right = np.array([level[1], -level[0], 0.0])
    up = np.cross(right, forward)
    points = np.column_stack([places, np.zeros(len(places))])
    eye = points.mean(axis=0) - 3.0 * np.ptp(points, axis=0).max() * forward
    # Each round centres the picture and scales the distance; perspective makes them depend on each other.
    for _ in range(20):
        depth = (points - eye) @ forward
        seen = np.stack([(points - eye) @ right, (points - eye) @ up]) / depth
        distance = eye[2] / np.sin(_ELEVATION)
        middle = (seen.max(axis=1) + seen.min(axis=1)) / 2.0
        eye = eye + distance * (middle[0] * right + middle[1] * up)
        too_far = 1.0 - np.max(np.ptp(seen, axis=1) / 2.0 / np.array(_OPENING))
        eye = eye + 0.5 * too_far * distance * forward
    return eye, eye + eye[2] / np.sin(_ELEVATION) * forward


def _plot_view(plot: Plot) -> rrb.TimeSeriesView:
    axis = None if plot.extent is None else rrb.ScalarAxis(range=plot.extent)
    return rrb.TimeSeriesView(
        origin=plot.path, name=plot.title, axis_y=axis, plot_legend=rrb.PlotLegend(rrb.Corner2D.RightTop)
    )
