"""Figures of a sweep: success over mass and friction, clearances, and where obstacles make scenarios fail."""

from __future__ import annotations

import io
from collections.abc import Callable
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from jaxlocomanip.checked import InputError, installing
from jaxlocomanip.files import write_whole
from jaxlocomanip.sweep.report import Results
from jaxlocomanip.sweep.statistics import clopper_pearson

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

Floats = NDArray[np.floating[Any]]

DPI = 150
COLUMNS = 3
"""panels beside each other at most"""
BINS = 6
"""of mass ratio and of friction where they are drawn and not stepped through"""
LAYOUT_BINS = (14, 10)
"""along and across the straight line"""
FEWEST = 5
"""trials that a share is shown for"""
_OBJECT, _ROBOTS = (0.45, 0.28, 0.08), (0.16, 0.17, 0.20)


def draw_sweep(directory: Path, results: Results, title: str) -> list[Path]:
    """Draw the figures of a sweep, each written whole or not at all.

    Args:
      directory: where `success.png`, `clearance.png` and `failures.png` go; existing ones are replaced.
      results: all rows.
      title: of the figures.

    Returns:
      The files.

    Raises:
      InputError: Matplotlib is not installed, or a file cannot be written.
    """
    try:
        from matplotlib.figure import Figure
    except ImportError as error:
        raise InputError(f"figures need Matplotlib: {installing('view')}") from error
    # One colour means one share in all panels, and few failures still show where they are.
    top = max(0.05, *(float(np.nanmax(_failures(results.of_variant(v)), initial=0.0)) for v in results.variants()))
    kinds: dict[str, Callable[[Axes, Results], Any]] = {
        "success": _success_map,
        "clearance": _clearances,
        "failures": lambda axes, rows: _failure_map(axes, rows, top),
    }
    files = []
    for name, draw in kinds.items():
        variants = results.variants()
        columns = min(COLUMNS, len(variants))
        rows = -(-len(variants) // columns)
        figure = Figure(figsize=(1.2 + 5.2 * columns, 0.8 + 4.2 * rows), dpi=DPI, layout="constrained")
        grid = np.atleast_1d(figure.subplots(rows, columns, squeeze=False)).reshape(-1)
        _panels(figure, grid, draw, results, "failures" if name == "failures" else "successes")
        figure.suptitle(title, fontsize=12, x=0.012, ha="left")
        picture = io.BytesIO()
        figure.savefig(picture, format="png")
        files.append(directory / f"{name}.png")
        write_whole(files[-1], picture.getvalue())
    return files


def _panels(figure: Figure, grid: Any, draw: Callable[[Axes, Results], Any], results: Results, what: str) -> None:
    """One panel a planner; what the draw function returns is explained by a colour bar."""
    shown, variants = None, results.variants()
    for axes, variant in zip(grid, variants, strict=False):
        rows = results.of_variant(variant)
        rate = clopper_pearson(int(rows["success"].sum()), len(rows))
        low, high = f"{100.0 * rate.low:.1f}", f"{100.0 * rate.high:.1f}"
        axes.set_title(f"{variant or 'all'}: {100.0 * rate.share:.1f} % success [{low}, {high}]", fontsize=10)
        shown = draw(axes, rows) or shown
    for axes in grid[len(variants) :]:
        axes.set_axis_off()
    if shown is not None:
        figure.colorbar(shown, ax=grid.tolist(), shrink=0.8, label=f"share of {what}")


def _edges(values: Floats, bins: int) -> Floats:
    """Edges of bins: between the values where they are few, else evenly over their range."""
    distinct = np.unique(values)
    if len(distinct) == 1:
        return distinct[0] + np.array([-0.5, 0.5]) * max(abs(distinct[0]), 1.0) * 0.1
    if len(distinct) <= 2 * bins:
        middles = 0.5 * (distinct[1:] + distinct[:-1])
        return np.concatenate([[2 * distinct[0] - middles[0]], middles, [2 * distinct[-1] - middles[-1]]])
    return np.linspace(distinct[0], distinct[-1], bins + 1)


def _shares(x: Floats, y: Floats, good: NDArray[np.bool_], edges: tuple[Floats, Floats]) -> tuple[Floats, Floats]:
    """Share of good ones and number of all in each bin."""
    every, _, _ = np.histogram2d(x, y, bins=edges)
    kept, _, _ = np.histogram2d(x[good], y[good], bins=edges)
    return np.where(every > 0, kept / np.maximum(every, 1), np.nan), every


def _success_map(axes: Axes, rows: Results) -> Any:
    edges = (_edges(rows["mass_ratio"], BINS), _edges(rows["friction"], BINS))
    share, every = _shares(rows["mass_ratio"], rows["friction"], rows["success"].astype(bool), edges)
    mesh = axes.pcolormesh(*edges, share.T, cmap="viridis", vmin=0.0, vmax=1.0)
    if share.size <= 120:
        middles = [0.5 * (e[1:] + e[:-1]) for e in edges]
        for i, x in enumerate(middles[0]):
            for j, y in enumerate(middles[1]):
                if every[i, j]:
                    text = f"{100.0 * share[i, j]:.0f}\n{int(every[i, j])}"
                    color = "white" if share[i, j] < 0.6 else "black"
                    axes.text(x, y, text, ha="center", va="center", fontsize=6.5, color=color)
    axes.set_xlabel("true / believed mass")
    axes.set_ylabel("friction coefficient")
    return mesh


def _clearances(axes: Axes, rows: Results) -> None:
    kinds = (("min_object_clearance_m", _OBJECT, "object"), ("min_robot_clearance_m", _ROBOTS, "robots"))
    for name, color, label in kinds:
        values = np.sort(rows[name].astype(float)[np.isfinite(rows[name].astype(float))])
        if len(values):
            axes.step(values, (np.arange(len(values)) + 1.0) / len(values), color=color, label=label, where="post")
    axes.axvline(0.0, color="0.45", lw=0.9, ls="--")
    axes.set_xlim(-0.2, 1.0)
    axes.set_ylim(0.0, 1.0)
    axes.grid(color="0.92", lw=0.8)
    axes.set_xlabel("least clearance to obstacles [m]")
    axes.set_ylabel("share of scenarios at or below")
    if axes.lines[:-1]:
        axes.legend(frameon=False)


_PLACES = (np.linspace(-0.2, 1.2, LAYOUT_BINS[0] + 1), np.linspace(-2.0, 2.0, LAYOUT_BINS[1] + 1))
"""edges of bins along the straight line, in parts of its length, and across it, m"""


def _failures(rows: Results) -> Floats:
    """[bins along, bins across] share of failures among the scenarios that have an obstacle in a place."""
    along, across, failed = [], [], []
    for i in range(len(rows)):
        bearing = rows["bearing_rad"][i]
        x = np.array(rows["obstacle_x_m"][i]) - rows["start_x_m"][i]
        y = np.array(rows["obstacle_y_m"][i]) - rows["start_y_m"][i]
        along += ((np.cos(bearing) * x + np.sin(bearing) * y) / max(rows["distance_m"][i], 1e-6)).tolist()
        across += (np.cos(bearing) * y - np.sin(bearing) * x).tolist()
        failed += [not rows["success"][i]] * len(x)
    share, every = _shares(np.array(along), np.array(across), np.array(failed, bool), _PLACES)
    return np.where(every >= FEWEST, share, np.nan)


def _failure_map(axes: Axes, rows: Results, top: float) -> Any:
    """Shares of failures up to `top`, start and goal of all scenarios in one frame."""
    axes.plot([0.0, 1.0], [0.0, 0.0], color="0.3", lw=1.0, zorder=3)
    axes.plot(0.0, 0.0, "s", color="0.3", zorder=3)
    axes.plot(1.0, 0.0, "*", color="0.3", zorder=3, ms=10)
    axes.set_xlabel("obstacle along the straight line (0: start, 1: goal)")
    axes.set_ylabel("to the left of it [m]")
    return axes.pcolormesh(*_PLACES, _failures(rows).T, cmap="magma_r", vmin=0.0, vmax=top)
