"""How the Rerun viewer lays a recording out: the scene on the left, tabs of time series on the right.

Of a world with bodies there are two views of the scene: all of it, and one that goes along with the object.
"""

from __future__ import annotations

from typing import Any, NamedTuple

import numpy as np
import rerun.blueprint as rrb
from numpy.typing import NDArray

from jaxlocomanip.recording.bodies import LABELS
from jaxlocomanip.recording.series import Plot

Floats = NDArray[np.floating[Any]]

TIMELINE = "sim_time"
"""Name of the recordings' timeline, in seconds."""

_ABOVE = (0.85, 1.15)
"""rad, the camera of flat bodies: how steeply it looks down, and how far left of the way from start to goal, so that
the team moves to the right and away"""
_OPENING = (0.54, 0.44)
"""tangents of the half-angles that the scene may fill, sideways and upwards; the viewer opens 55 degrees"""
_SIDEWAYS, _WIDE = (0.7, 1.4), (1.2, 0.46)
"""the same of the whole scene under a close-up: from the side of the way, in a view that is wide and low"""
_BEHIND, _NEAR = (0.5, 0.42), (0.75, 0.42)
"""the same of the close-up: from behind the team, low enough that obstacles show before it"""


class CloseUp(NamedTuple):
    """What a second view of the scene shows."""

    entity: str
    """that it goes along with"""
    center: Floats
    """[3] m, of that entity at the start"""
    points: Floats
    """[n, 3] m, what it shall show at the start"""


def layout(plots: list[Plot], places: Floats, way: Floats, close_up: CloseUp | None = None) -> rrb.Blueprint:
    """The blueprint of a recording.

    Args:
      plots: its time series.
      places: [n, 2] m, what the camera shall show.
      way: [2] m, from start to goal.
      close_up: what a second view shall show; there is none by default.
    """
    if close_up is None:
        scene: Any = _scene_view("Scene", *camera(places, way))
    else:
        near = _scene_view("Close-up, goes along with the object", *companion(close_up, way), close_up.entity)
        whole = _scene_view("The whole scene", *camera(places, way, _SIDEWAYS, _WIDE), labels=False)
        scene = rrb.Vertical(near, whole, row_shares=[3, 2])
    tabs = []
    for tab in dict.fromkeys(plot.tab for plot in plots):
        views = [_plot_view(plot) for plot in plots if plot.tab == tab]
        tabs.append(rrb.Vertical(*views, name=tab))
    about = rrb.TextDocumentView(origin="about", name="About")
    return rrb.Blueprint(
        rrb.Horizontal(scene, rrb.Tabs(*tabs, about, active_tab=0), column_shares=[5, 3]),
        rrb.BlueprintPanel(state="collapsed"),
        rrb.SelectionPanel(state="collapsed"),
        rrb.TimePanel(state="collapsed", timeline=TIMELINE),
    )


def _scene_view(
    name: str, eye: Floats, target: Floats, tracking: str | None = None, labels: bool = True
) -> rrb.Spatial3DView:
    """A view of the scene; from far away names would hide what they name."""
    past = rrb.VisibleTimeRanges(
        timeline=TIMELINE, start=rrb.TimeRangeBoundary.infinite(), end=rrb.TimeRangeBoundary.cursor_relative()
    )
    return rrb.Spatial3DView(
        origin="world",
        contents="$origin/**" if labels else ["$origin/**", f"- /{LABELS}/**"],
        name=name,
        background=rrb.Background(color=(250, 251, 252)),
        line_grid=rrb.LineGrid3D(visible=False),
        eye_controls=rrb.EyeControls3D(
            kind=rrb.Eye3DKind.Orbital,
            position=eye,
            look_target=target,
            eye_up=(0.0, 0.0, 1.0),
            tracking_entity=tracking,
        ),
        overrides={"world/trail": past},  # pyright: ignore[reportArgumentType]
    )


def camera(
    places: Floats, way: Floats, direction: tuple[float, float] = _ABOVE, opening: tuple[float, float] = _OPENING
) -> tuple[Floats, Floats]:
    """Position and target [3], m, of a camera that sees all places and no more ground than it must.

    Args:
      places: [n, 2] m, on the ground.
      way: [2] m, from start to goal.
      direction: rad, how steeply the camera looks down, and how far left of the way.
      opening: tangents of the half-angles that the places may fill, sideways and upwards.
    """
    forward, right, up = _axes(way, direction)
    points = np.column_stack([places, np.zeros(len(places))])
    eye = points.mean(axis=0) - 3.0 * np.ptp(points, axis=0).max() * forward
    # Each round centres the picture and scales the distance; perspective makes them depend on each other.
    for _ in range(20):
        depth = (points - eye) @ forward
        seen = np.stack([(points - eye) @ right, (points - eye) @ up]) / depth
        distance = -eye[2] / forward[2]
        middle = (seen.max(axis=1) + seen.min(axis=1)) / 2.0
        eye = eye + distance * (middle[0] * right + middle[1] * up)
        too_far = 1.0 - np.max(np.ptp(seen, axis=1) / 2.0 / np.array(opening))
        eye = eye + 0.5 * too_far * distance * forward
    return eye, eye + -eye[2] / forward[2] * forward


def companion(close_up: CloseUp, way: Floats) -> tuple[Floats, Floats]:
    """Position and target [3], m, of a camera that looks at the centre from just so far that it sees all points.

    Args:
      close_up: what to see.
      way: [2] m, from start to goal.
    """
    forward, right, up = _axes(way, _BEHIND)
    points = close_up.points - close_up.center
    needed = np.abs(np.stack([points @ right, points @ up])) / np.array(_NEAR)[:, None] - points @ forward
    return close_up.center - float(needed.max()) * forward, close_up.center


def _axes(way: Floats, direction: tuple[float, float]) -> tuple[Floats, Floats, Floats]:
    """Unit vectors [3] forward, to the right and up of a camera that looks in a direction relative to the way."""
    elevation, aside = direction
    azimuth = np.arctan2(way[1], way[0]) + aside
    level = np.array([np.cos(azimuth), np.sin(azimuth), 0.0])
    forward = np.cos(elevation) * level - np.array([0.0, 0.0, np.sin(elevation)])
    right = np.array([level[1], -level[0], 0.0])
    return forward, right, np.cross(right, forward)


def _plot_view(plot: Plot) -> rrb.TimeSeriesView:
    vertical = None if plot.extent is None else rrb.ScalarAxis(range=plot.extent)
    horizontal = None
    if plot.window is not None:
        edges = [rrb.TimeRangeBoundary.cursor_relative(seconds=side * plot.window) for side in (-1.0, 1.0)]
        horizontal = rrb.TimeAxis(view_range=rrb.TimeRange(*edges))
    legend = rrb.PlotLegend(rrb.Corner2D.RightTop)
    return rrb.TimeSeriesView(origin=plot.path, name=plot.title, axis_x=horizontal, axis_y=vertical, plot_legend=legend)
