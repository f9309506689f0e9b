"""The time series of a recording: what is plotted, how it is called and in which tab it stands."""

from __future__ import annotations

from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from jaxlocomanip.planar.regressor import FRICTION, MASS, TORSION, from_body
from jaxlocomanip.recording import palette
from jaxlocomanip.recording.history import (
    STRIDE,
    History,
    finite_clearance,
    goal_errors,
    psi_com,
    robot_names,
    rotated,
    stride_mean,
)
from jaxlocomanip.recording.palette import RGB
from jaxlocomanip.recording.quadruped import stand_height
from jaxlocomanip.recording.team import team

Floats = NDArray[np.floating[Any]]

LIMIT: RGB = (150, 155, 162)
"""lines that stand still: limits, tolerances, the truth"""
FIRST: RGB = (110, 205, 235)
SECOND: RGB = (240, 140, 180)
THIRD: RGB = (130, 205, 140)
OBJECT: RGB = palette.OBJECT
ROBOTS: RGB = (228, 231, 235)

_LEGS: dict[str, RGB] = {"FR": (110, 205, 235), "FL": (240, 140, 180), "RR": (200, 70, 130), "RL": (40, 135, 190)}
"""In the order of the feet; the two legs of a diagonal, which a trot moves together, have one hue."""
WINDOW = 2.0
"""s before and after now in plots of single steps"""


class Line(NamedTuple):
    """One curve."""

    key: str
    """last part of the entity's path"""
    label: str
    values: Floats
    """[T], or a single number for a line that stands still"""
    color: RGB
    width: float = 2.0
    steps: bool = False
    """held from tick to tick instead of joined by slopes"""


class Plot(NamedTuple):
    """Curves that share an axis."""

    tab: str
    path: str
    """entity path of its lines' parent"""
    title: str
    lines: list[Line]
    extent: tuple[float, float] | None = None
    """vertical range, where the data should not decide"""
    window: float | None = None
    """s before and after now that are shown; everything by default"""


def plots(episode: History) -> list[Plot]:
    """Every plot of an episode, in the order of display; curves without a finite value are left out."""
    every = [*_pushing(episode), *_walking(episode), *_safety(episode), *_adaptation(episode), *_solver(episode)]
    return [p._replace(lines=[line for line in p.lines if np.isfinite(line.values).any()]) for p in every]


def _still(key: str, label: str, value: Any) -> Line:
    return Line(key, label, np.asarray(value, dtype=float).reshape(()), LIMIT, 1.0)


def _pushing(episode: History) -> list[Plot]:
    scenario, log = episode
    names = robot_names(scenario)
    forces, offsets = [], []
    for i, name in enumerate(names):
        color = palette.robot_color(i)
        pale = _pale(color)
        forces.append(Line(f"{name}/commanded", f"{name} commanded", log.command.force[:, i], pale, 1.0, True))
        forces.append(Line(f"{name}/exerted", f"{name} exerted", log.view.force[:, i], color))
        offsets.append(Line(name, name, log.view.offset[:, i], color))
    distance, turn = goal_errors(scenario, log.view.pose)
    away = [
        Line("position", "object", distance, THIRD),
        _still("position_tolerance", "tolerance", scenario.goal.position_tolerance),
    ]
    turned = [
        Line("heading", "object", turn, SECOND),
        _still("heading_tolerance", "tolerance", scenario.goal.heading_tolerance),
    ]
    bodies = log.view.bodies is not None
    pushes = _contact_forces(episode) if bodies else [Plot("Pushing", "pushing/force", "Push force, N", forces)]
    return [
        *pushes,
        Plot("Pushing", "pushing/contact_offset", "Contact offset along the face, m", offsets),
        Plot("Goal", "goal/distance", "Distance to the goal, m", away),
        Plot("Goal", "goal/heading", "Heading away from the goal's, rad", turned),
    ]


def _pale(color: RGB) -> RGB:
    red, green, blue = (int(0.45 * c + 0.55 * 235) for c in color)
    return red, green, blue


def _contact_forces(episode: History) -> list[Plot]:
    """Measured against commanded, a plot for each robot: with footfalls in it, several do not go into one."""
    scenario, log = episode
    mean = stride_mean(log.view.force, log.time)
    found = []
    for i, name in enumerate(robot_names(scenario)):
        color = palette.robot_color(i)
        lines = [
            Line("measured", "measured", log.view.force[:, i], _pale(color), 0.7),
            Line("measured_mean", f"measured, mean of {STRIDE:g} s", mean[:, i], color, 2.5),
            Line("commanded", "commanded", log.command.force[:, i], palette.COMMAND, 2.0, True),
        ]
        found.append(Plot("Pushing", f"pushing/force/{name}", f"Contact force of {name}, N", lines))
    return found


def _walking(episode: History) -> list[Plot]:
    """How the robots stand and step; nothing in a world without bodies."""
    scenario, log = episode
    if log.view.bodies is None:
        return []
    steps, heights, tilts = [], [], []
    for i, member in enumerate(team(episode)):
        vertical = log.view.bodies.foot_force[:, i, :, 2]
        feet = [Line(leg, leg, vertical[:, k], color, 1.2) for k, (leg, color) in enumerate(_LEGS.items())]
        title = f"Vertical force on the feet of {member.name}, N"
        steps.append(Plot("Walking", f"walking/feet/{member.name}", title, feet, window=WINDOW))
        height = log.view.bodies.position[:, member.first, 2]
        heights.append(Line(member.name, member.name, height, member.color))
        upright = rotated(log.view.bodies.quaternion[:, member.first], np.array([0.0, 0.0, 1.0]))[:, 2]
        tilts.append(Line(member.name, member.name, np.degrees(np.arccos(np.clip(upright, -1.0, 1.0))), member.color))
    stands = {member.kind: stand_height(member.kind) for member in team(episode)}
    heights += [_still(f"{kind}_stand", f"{kind}, standing", height) for kind, height in stands.items()]
    # Else the wobble of every stride would fill the plot.
    lowest = min(0.75 * min(stands.values()), *(float(np.min(line.values)) for line in heights))
    return [
        *steps,
        Plot("Walking", "walking/height", "Height of the trunks, m", heights, (lowest, 1.2 * max(stands.values()))),
        Plot("Walking", "walking/tilt", "Tilt of the trunks against the vertical, degrees", tilts),
    ]


def _safety(episode: History) -> list[Plot]:
    log = episode.log
    apart, report = log.clearances, log.report
    clearances = [
        Line("object", "object to obstacles", finite_clearance(apart.object), OBJECT),
        Line("robots", "robots to obstacles", finite_clearance(apart.robots), ROBOTS),
        Line("team", "robot to robot", finite_clearance(apart.team), THIRD),
        _still("contact", "contact", 0.0),
    ]
    barriers = [
        Line("object", "object, m/s²", finite_clearance(report.object_cbf), OBJECT),
        Line("robots", "robots, m/s", finite_clearance(report.robot_cbf), ROBOTS),
        _still("limit", "limit", 0.0),
    ]
    lyapunov = [Line("condition", "condition", report.clf, THIRD), _still("limit", "limit", 0.0)]
    choice = [
        Line("choice", "candidate sent", report.filter_choice.astype(float), SECOND, 2.0, True),
        Line("waits", "waits for an obstacle (1)", report.waits.astype(float), THIRD, 1.2, True),
    ]
    return [
        Plot("Safety", "safety/clearance", "Clearance between true shapes, m (contact below 0)", clearances),
        Plot("Safety", "safety/barrier", "Barrier conditions (CBF), at least 0", barriers),
        Plot("Safety", "safety/lyapunov", "Lyapunov condition (CLF), at least 0", lyapunov),
        Plot("Safety", "safety/filter", "Safety filter (0: the planner's own input)", choice, (-0.5, 8.5)),
    ]


def _adaptation(episode: History) -> list[Plot]:
    scenario, log = episode
    psi, truth = log.parameters, scenario.truth
    true_psi = np.asarray(from_body(truth))
    com = psi_com(psi)

    def against_truth(key: str, title: str, index: int) -> Plot:
        lines = [
            Line("estimate", "estimate", psi[:, index], FIRST),
            _still("truth", "truth", true_psi[index]),
        ]
        return Plot("Adaptation", f"adaptation/{key}", title, lines)

    centre = [
        Line("x", "x estimate", com[:, 0], FIRST),
        Line("y", "y estimate", com[:, 1], SECOND),
        _still("x_truth", "x truth", truth.com[0]),
        _still("y_truth", "y truth", truth.com[1]),
    ]
    return [
        against_truth("mass", "Mass, kg", MASS),
        against_truth("friction_force", "Friction force F_c, N", FRICTION),
        against_truth("friction_moment", "Friction moment M_c, N m", TORSION),
        Plot("Adaptation", "adaptation/centre_of_mass", "Centre of mass in the object's frame, m", centre),
    ]


def _solver(episode: History) -> list[Plot]:
    cost, defect, step, length, status = episode.log.solver.T
    return [
        Plot("Solver", "solver/cost", "Objective", [Line("cost", "objective", cost, FIRST)]),
        Plot(
            "Solver",
            "solver/step",
            "Largest step and dynamics defect",
            [Line("step", "max |step|", step, FIRST), Line("defect", "defect (l1)", defect, SECOND)],
        ),
        Plot(
            "Solver",
            "solver/length",
            "Step length taken",
            [Line("length", "length", length, THIRD, 2.0, True)],
            (-0.05, 1.05),
        ),
        Plot(
            "Solver",
            "solver/status",
            "Status (0 converged, 1 iteration limit, 2 no descent, 3 non-finite)",
            [Line("status", "status", status, SECOND, 2.0, True)],
            (-0.3, 3.3),
        ),
    ]
