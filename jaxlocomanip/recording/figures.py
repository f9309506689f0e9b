"""The still figure of an episode: plan view and signals, as a PNG."""

from __future__ import annotations

import io
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from jaxlocomanip.checked import InputError, installing
from jaxlocomanip.closed_loop import Result
from jaxlocomanip.files import write_whole
from jaxlocomanip.outcome import CLEAR, Outcome
from jaxlocomanip.planar.regressor import FRICTION, MASS
from jaxlocomanip.recording import palette
from jaxlocomanip.recording.history import (
    STRIDE,
    History,
    as_numpy,
    finite_clearance,
    goal_errors,
    history,
    robot_names,
    stride_mean,
)
from jaxlocomanip.recording.palette import unit
from jaxlocomanip.scenario import Scenario

if TYPE_CHECKING:
    from matplotlib.axes import Axes

Floats = NDArray[np.floating[Any]]

SIZE_INCHES = (16.0, 10.0)
DPI = 150

_STYLE: dict[str, Any] = {
    "font.family": "DejaVu Sans",
    "font.size": 9.5,
    "axes.spines.top": False,
    "axes.spines.right": False,
    "axes.edgecolor": "0.35",
    "axes.labelcolor": "0.15",
    "xtick.color": "0.3",
    "ytick.color": "0.3",
    "legend.fontsize": 8.5,
    "legend.handlelength": 1.6,
    "lines.linewidth": 1.3,
}
_OBJECT, _ROBOTS, _TEAM = (0.45, 0.28, 0.08), (0.16, 0.17, 0.20), (0.20, 0.62, 0.42)
_LIMIT: dict[str, Any] = {"color": "0.45", "lw": 0.9, "ls": "--"}


def draw_figure(path: Path, name: str, scenario: Scenario, result: Result) -> None:
    """Draw an episode as a PNG of 2400 x 1500 pixels, written whole or not at all.

    Args:
      path: the .png file; an existing one is replaced.
      name: of the episode.
      scenario: without batch axis.
      result: its outcome and trajectory, without batch axis.

    Raises:
      InputError: Matplotlib is not installed, the result has no trajectory, or the file cannot be written.
    """
    try:
        from matplotlib import style
        from matplotlib.figure import Figure
    except ImportError as error:
        raise InputError(f"figures need Matplotlib: {installing('view')}") from error
    from jaxlocomanip.recording.plan_view import draw_plan_view

    if result.log is None:
        raise InputError("result.log = None: a figure needs a trajectory (simulate with record=True)")
    episode = history(scenario, result.log)
    outcome = as_numpy(result.outcome)
    panels = (_forces, _offsets, _clearances, _barriers, _estimates, _errors)
    picture = io.BytesIO()
    with style.context(["default", _STYLE]):
        figure = Figure(figsize=SIZE_INCHES, dpi=DPI, layout="constrained")
        grid = figure.add_gridspec(len(panels), 2, width_ratios=(1.12, 1.0))
        draw_plan_view(figure.add_subplot(grid[:, 0]), episode)
        first = None
        for i, draw in enumerate(panels):
            axes = figure.add_subplot(grid[i, 1], sharex=first)
            first = first or axes
            _frame(axes, episode, outcome, last=i == len(panels) - 1)
            draw(axes, episode)
            axes.legend(loc="center left", bbox_to_anchor=(1.0, 0.5), frameon=False)
            axes.set_xlim(*_shown(episode, outcome))
        figure.align_ylabels()
        figure.suptitle(f"{name}:  {verdict(outcome)}", fontsize=13, x=0.012, ha="left")
        figure.savefig(picture, format="png")
    write_whole(Path(path), picture.getvalue())


def verdict(outcome: Outcome) -> str:
    """One line for people about how an episode ended."""
    if outcome.reached:
        ending = f"goal reached at {float(outcome.reach_time_s):.1f} s"
    else:
        ending = f"goal not reached ({float(outcome.final_position_error_m):.2f} m away)"
    pairs = {
        "object": outcome.min_object_clearance_m,
        "robots": outcome.min_robot_clearance_m,
        "robot to robot": outcome.min_team_clearance_m,
    }
    kept = ", ".join(f"{what} {float(value):.2f} m" for what, value in pairs.items() if value < 0.5 * CLEAR)
    touched = (", collided" if outcome.collided else "") + (", a robot fell" if outcome.fell else "")
    return f"{ending}{touched};  least clearance: {kept}" if kept else ending


def _shown(episode: History, outcome: Outcome) -> tuple[float, float]:
    """The time axes [s]: until soon after the arrival, since nothing happens from then on."""
    last = max(float(episode.log.time[-1]), 1e-3)
    return 0.0, min(last, 1.1 * float(outcome.reach_time_s) + 1.0) if outcome.reached else last


def _frame(axes: Axes, episode: History, outcome: Outcome, last: bool) -> None:
    """What the time series have in common: the time axis, the grid and the instant of arrival."""
    axes.grid(color="0.92", lw=0.8)
    axes.set_axisbelow(True)
    axes.margins(x=0.0)
    axes.tick_params(labelbottom=last)
    if outcome.reached:
        axes.axvline(float(outcome.reach_time_s), color=unit(palette.GOAL), lw=1.0, ls=":")
    if last:
        axes.set_xlabel("time [s]")


def _forces(axes: Axes, episode: History) -> None:
    scenario, log = episode
    walking = log.view.bodies is not None
    for i, name in enumerate(robot_names(scenario)):
        color = unit(palette.robot_color(i))
        if walking:
            _measured_force(axes, episode, i, name)
        else:
            axes.plot(log.time, log.view.force[:, i], color=color, lw=2.4, alpha=0.45, label=name)
            axes.plot(log.time, log.command.force[:, i], color=_darker(color), lw=0.9)
        axes.axhline(float(scenario.team.force_max[i]), color=color, lw=0.9, ls="--")
    if walking:
        axes.plot([], [], color="0.4", lw=0.5, label="measured")
        axes.plot([], [], color="0.4", lw=1.8, label=f"its {STRIDE:g} s mean")
        axes.plot([], [], color="0.2", lw=1.0, label="commanded")
    else:
        axes.plot([], [], color="0.2", lw=0.9, label="commanded")
    axes.plot([], [], **_LIMIT, label=r"$F_{\max}$")
    axes.set_ylim(top=1.08 * float(max(np.max(log.view.force), np.max(scenario.team.force_max))))
    axes.set_ylabel("push force\n[N]")


def _measured_force(axes: Axes, episode: History, i: int, name: str) -> None:
    """What a walking robot exerts: its footfalls faintly, and the mean over a stride beside what was asked for."""
    log = episode.log
    color = unit(palette.robot_color(i))
    axes.plot(log.time, log.view.force[:, i], color=color, lw=0.5, alpha=0.35, zorder=1.5)
    axes.plot(log.time, stride_mean(log.view.force[:, i], log.time), color=color, lw=1.8, label=name)
    axes.plot(log.time, log.command.force[:, i], color=_darker(color), lw=1.0, zorder=2.5)


def _darker(color: tuple[float, float, float]) -> tuple[float, float, float]:
    red, green, blue = color
    return 0.5 * red, 0.5 * green, 0.5 * blue


def _offsets(axes: Axes, episode: History) -> None:
    scenario, log = episode
    for i, name in enumerate(robot_names(scenario)):
        color = unit(palette.robot_color(i))
        axes.plot(log.time, log.view.offset[:, i], color=color, label=name)
    axes.axhline(0.0, color="0.75", lw=0.8, zorder=0)
    axes.set_ylabel("contact\noffset [m]")


def _clearances(axes: Axes, episode: History) -> None:
    log = episode.log
    apart = log.clearances
    shown = (
        (apart.object, _OBJECT, "object, obstacles"),
        (apart.robots, _ROBOTS, "robots, obstacles"),
        (apart.team, _TEAM, "robot, robot"),
    )
    for distance, color, label in shown:
        finite = finite_clearance(distance)
        if np.isfinite(finite).any():
            axes.plot(log.time, finite, color=color, label=label)
    _shade(axes, log.time, log.report.waits, "waits")
    axes.axhline(0.0, **_LIMIT, label="contact")
    axes.set_ylabel("clearance\n[m]")


def _shade(axes: Axes, time: Floats, where: NDArray[np.bool_], label: str) -> None:
    """Shade the times at which something holds, if there are any."""
    if np.any(where):
        span = axes.get_xaxis_transform()
        axes.fill_between(time, 0, 1, where=where, transform=span, color="0.85", lw=0, step="post", label=label)


def _barriers(axes: Axes, episode: History) -> None:
    """Barrier conditions near their limit; ticks at which the safety filter stepped in are shaded."""
    log = episode.log
    values = np.stack([finite_clearance(log.report.object_cbf), finite_clearance(log.report.robot_cbf)])
    if np.isfinite(values).any():
        axes.plot(log.time, values[0], color=_OBJECT, label=r"object [m/s$^2$]")
        axes.plot(log.time, values[1], color=_ROBOTS, label="robots [m/s]")
        low, high = float(np.nanmin(values)), float(np.nanmax(values))
        axes.set_ylim(min(low - 0.2, -0.5), max(min(high, 6.0), low + 1.0))
    _shade(axes, log.time, log.report.filter_choice != 0, "filter acts")
    axes.axhline(0.0, **_LIMIT, label="limit")
    axes.set_ylabel("CBF\ncondition")


def _estimates(axes: Axes, episode: History) -> None:
    scenario, log = episode
    truth = scenario.truth
    axes.plot(log.time, log.parameters[:, MASS] / truth.mass, color=(0.35, 0.35, 0.75), label="mass")
    if truth.friction_force > 0.0:
        ratio = log.parameters[:, FRICTION] / truth.friction_force
        axes.plot(log.time, ratio, color=(0.80, 0.35, 0.20), label=r"friction $F_c$")
    axes.axhline(1.0, **_LIMIT, label="truth")
    axes.set_ylabel("estimate\n/ truth")


def _errors(axes: Axes, episode: History) -> None:
    scenario, log = episode
    distance, turn = goal_errors(scenario, log.view.pose)
    position, heading = unit(palette.GOAL), (0.62, 0.50, 0.10)
    axes.plot(log.time, np.maximum(distance, 1e-3), color=position, label="position [m]")
    axes.plot(log.time, np.maximum(turn, 1e-3), color=heading, label="heading [rad]")
    axes.axhline(float(scenario.goal.position_tolerance), color=position, lw=0.9, ls="--")
    axes.axhline(float(scenario.goal.heading_tolerance), color=heading, lw=0.9, ls="--")
    axes.plot([], [], **_LIMIT, label="tolerances")
    axes.set_yscale("log")
    axes.set_ylim(bottom=max(5e-3, 0.5 * float(min(distance.min(), 1.0))))
    axes.set_ylabel("goal error")
