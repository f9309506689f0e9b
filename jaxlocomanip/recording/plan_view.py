"""The plan view of an episode: where everything was, in one Matplotlib panel."""

from __future__ import annotations

from typing import Any

import numpy as np
from matplotlib.axes import Axes
from matplotlib.lines import Line2D
from matplotlib.patches import Patch, Polygon
from numpy.typing import NDArray

from jaxlocomanip.recording import geometry, palette
from jaxlocomanip.recording.history import History, rectangle, robot_names, scene_points, to_world
from jaxlocomanip.recording.palette import RGB, unit

Floats = NDArray[np.floating[Any]]

SNAPSHOTS = 7
"""number of instants at which bodies are drawn"""
PROPORTION = 1.2
"""height of the panel over its width"""
TURN_LENGTH = 0.3
"""m, way that a turn by one rad counts for"""
FAINTEST = 0.22
"""opacity of the first snapshot; the last is opaque"""


def draw_plan_view(axes: Axes, episode: History) -> None:
    """Draw an episode from above: bodies at even intervals of the way, fading into the past."""
    scenario, log = episode
    rows = snapshot_rows(log.view.pose)
    fades = np.linspace(FAINTEST, 1.0, len(rows))
    for path in log.path:
        axes.plot(path[:, 0], path[:, 1], color=unit(palette.PATH), lw=0.7, alpha=0.45, zorder=2)
    _draw_obstacles(axes, episode, rows, fades)
    _draw_goal(axes, episode)
    axes.plot(*log.view.pose[:, :2].T, color=unit(palette.TRAIL), lw=1.6, zorder=6)
    axes.plot(*log.view.pose[0, :2], "o", ms=6, mfc="white", mec=unit(palette.TRAIL), mew=1.6, zorder=7)
    footprint = geometry.outline(scenario.object.vertices, 0.0)
    half_length, half_width = scenario.team.half_length, scenario.team.half_width
    for row, fade in zip(rows, fades, strict=True):
        layer = 3.0 + fade
        _fill(axes, to_world(log.view.pose[row], footprint), palette.OBJECT, fade, layer)
        for i, pose in enumerate(log.view.robots[row]):
            _draw_robot(axes, pose, rectangle(half_length[i], half_width[i]), palette.robot_color(i), fade, layer)
    _label_times(axes, episode, rows)
    low, high = _fitted(scene_points(episode))
    axes.set(xlim=(low[0], high[0]), ylim=(low[1], high[1]), xlabel="x [m]", ylabel="y [m]")
    axes.set_aspect("equal", adjustable="box")
    axes.grid(color="0.92", lw=0.8)
    axes.set_axisbelow(True)
    axes.legend(handles=_legend(episode), loc="upper center", bbox_to_anchor=(0.5, -0.06), ncols=5, frameon=False)


def snapshot_rows(pose: Floats) -> NDArray[np.integer[Any]]:
    """Rows of poses [T, 3] at even intervals of the way, on which a rad of turn counts as `TURN_LENGTH`."""
    scaled = pose * np.array([1.0, 1.0, TURN_LENGTH])
    way = np.cumsum(np.linalg.norm(np.diff(scaled, axis=0, prepend=scaled[:1]), axis=1))
    return np.unique(np.searchsorted(way, np.linspace(0.0, way[-1], SNAPSHOTS)).clip(max=len(pose) - 1))


def _fitted(places: Floats) -> tuple[Floats, Floats]:
    """Lower and upper corner [2] of the least rectangle of the panel's proportions about places [n, 2]."""
    low, high = places.min(axis=0), places.max(axis=0)
    size = high - low
    wanted = np.maximum(size, np.array([size[1] / PROPORTION, size[0] * PROPORTION]))
    middle = (low + high) / 2.0
    return middle - wanted / 2.0, middle + wanted / 2.0


def _fill(axes: Axes, corners: Floats, color: RGB, fade: float, layer: float) -> None:
    """A body: filled faintly and outlined in its colour, both by `fade` in 0..1."""
    fill, edge = (*unit(color), 0.45 * fade), (*(0.72 * np.array(unit(color))), fade)
    axes.add_patch(Polygon(corners, closed=True, fc=fill, ec=edge, lw=1.1, zorder=layer))


def _draw_robot(axes: Axes, pose: Floats, corners: Floats, color: RGB, fade: float, layer: float) -> None:
    """A robot's rectangle with a triangle that points along its heading."""
    _fill(axes, to_world(pose, corners), color, fade, layer)
    length, width = corners[2]
    nose = np.array([[0.45 * length, -0.55 * width], [0.92 * length, 0.0], [0.45 * length, 0.55 * width]])
    axes.add_patch(Polygon(to_world(pose, nose), fc=(*unit(color), fade), ec="none", zorder=layer))


def _draw_obstacles(axes: Axes, episode: History, rows: NDArray[np.integer[Any]], fades: Floats) -> None:
    scenario, log = episode
    obstacles = scenario.obstacles
    for k in np.flatnonzero(obstacles.mask):
        shape = geometry.outline(obstacles.vertices[k], float(obstacles.radius[k]))
        if not obstacles.dynamic[k]:
            color = unit(palette.OBSTACLE)
            patch = Polygon(
                shape + log.obstacles[0, k], fc=color, ec=(*(0.6 * np.array(color)), 1.0), lw=1.1, zorder=2.5
            )
            axes.add_patch(patch)
            continue
        way = log.obstacles[: rows[-1] + 1, k]
        axes.plot(way[:, 0], way[:, 1], color=unit(palette.MOVING_OBSTACLE), lw=1.0, ls=":", zorder=2.4)
        for row, fade in zip(rows, fades, strict=True):
            _fill(axes, shape + log.obstacles[row, k], palette.MOVING_OBSTACLE, 0.9 * fade, 2.5 + 0.1 * fade)


def _draw_goal(axes: Axes, episode: History) -> None:
    goal, color = episode.scenario.goal, unit(palette.GOAL)
    footprint = to_world(goal.pose, geometry.outline(episode.scenario.object.vertices, 0.0))
    axes.add_patch(Polygon(footprint, fc="none", ec=color, lw=1.8, ls=(0, (4, 2)), zorder=7))
    circle = geometry.outline(np.zeros((1, 2)), float(goal.position_tolerance)) + goal.pose[:2]
    axes.add_patch(Polygon(circle, fc="none", ec=color, lw=1.2, zorder=7))
    length = 0.75 * float(np.max(np.linalg.norm(episode.scenario.object.vertices, axis=1)))
    tip = goal.pose[:2] + length * np.array([np.cos(goal.pose[2]), np.sin(goal.pose[2])])
    style = {"arrowstyle": "-|>", "color": color, "lw": 1.6, "shrinkA": 0, "shrinkB": 0}
    axes.annotate("", xy=tuple(tip), xytext=tuple(goal.pose[:2]), arrowprops=style, zorder=8)


def _label_times(axes: Axes, episode: History, rows: NDArray[np.integer[Any]]) -> None:
    """Write each snapshot's time on the object, unless it would cover the label before it."""
    log = episode.log
    size = float(np.max(np.linalg.norm(episode.scenario.object.vertices, axis=1)))
    taken: list[Floats] = []
    for row in rows:
        place = log.view.pose[row, :2]
        if all(np.linalg.norm(place - other) > 0.9 * size for other in taken):
            taken.append(place)
            box = {"boxstyle": "round,pad=0.18", "fc": "white", "ec": "none", "alpha": 0.75}
            text = f"{log.time[row]:.0f} s"
            axes.annotate(
                text,
                tuple(place),
                (0, 9),
                textcoords="offset points",
                ha="center",
                fontsize=8,
                zorder=9,
                bbox=box,
            )


def _legend(episode: History) -> list[Any]:
    scenario = episode.scenario
    dynamic = scenario.obstacles.dynamic[scenario.obstacles.mask]

    def body(color: RGB, label: str) -> Patch:
        return Patch(fc=(*unit(color), 0.6), ec=unit(color), label=label)

    handles: list[Any] = [body(palette.OBJECT, "object")]
    handles += [body(palette.robot_color(i), name) for i, name in enumerate(robot_names(scenario))]
    if np.any(~dynamic):
        handles.append(body(palette.OBSTACLE, "obstacle"))
    if np.any(dynamic):
        handles.append(body(palette.MOVING_OBSTACLE, "moving obstacle"))
    trail = unit(palette.TRAIL)
    handles.append(Line2D([], [], color=trail, lw=1.6, marker="o", mfc="white", mec=trail, label="object's way, start"))
    handles.append(Line2D([], [], color=unit(palette.PATH), lw=0.8, label="paths searched"))
    handles.append(Line2D([], [], color=unit(palette.GOAL), lw=1.8, ls=(0, (4, 2)), label="goal, tolerance"))
    return handles
