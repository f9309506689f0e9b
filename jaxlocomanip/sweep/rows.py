"""One row a scenario and planner: what was asked and what came of it, as columns of a table."""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import Any

import numpy as np

from jaxlocomanip.obstacles import moves
from jaxlocomanip.outcome import CLEAR, Outcome
from jaxlocomanip.planar.dynamics import GRAVITY
from jaxlocomanip.sampling.feasibility import REASONS, capacity
from jaxlocomanip.sampling.sampler import Lane
from jaxlocomanip.sampling.study import Study
from jaxlocomanip.specification import ScenarioSpec

Columns = dict[str, list[Any]]

INTEGER, REAL, FLAG, TEXT, REALS, TEXTS = "int64", "float64", "bool", "string", "list of float64", "list of string"

SCENARIO_COLUMNS = {
    "variant_number": INTEGER,
    "variant": TEXT,
    "lane": INTEGER,
    "draw": INTEGER,
    "point": INTEGER,
    "point_name": TEXT,
    "duration_s": REAL,
    "size_x_m": REAL,
    "size_y_m": REAL,
    "believed_mass_kg": REAL,
    "mass_ratio": REAL,
    "mass_kg": REAL,
    "inertia_kgm2": REAL,
    "com_x_m": REAL,
    "com_y_m": REAL,
    "friction": REAL,
    "friction_n": REAL,
    "capacity_n": REAL,
    "start_x_m": REAL,
    "start_y_m": REAL,
    "start_heading_rad": REAL,
    "goal_x_m": REAL,
    "goal_y_m": REAL,
    "goal_heading_rad": REAL,
    "position_tolerance_m": REAL,
    "heading_tolerance_rad": REAL,
    "distance_m": REAL,
    "bearing_rad": REAL,
    "turn_rad": REAL,
    "team_size": INTEGER,
    "robot_types": TEXTS,
    "robot_faces": TEXTS,
    "robot_offsets_m": REALS,
    "obstacle_count": INTEGER,
    "moving_count": INTEGER,
    "obstacle_shapes": TEXTS,
    "obstacle_x_m": REALS,
    "obstacle_y_m": REALS,
    "obstacle_size_x_m": REALS,
    "obstacle_size_y_m": REALS,
    "obstacle_yaw_rad": REALS,
    "obstacle_speed_mps": REALS,
    "obstacle_velocity_x_mps": REALS,
    "obstacle_velocity_y_mps": REALS,
    "obstacle_amplitude_x_m": REALS,
    "obstacle_amplitude_y_m": REALS,
    "obstacle_period_s": REALS,
    "position_std_m": REAL,
    "heading_std_rad": REAL,
    "obstacle_std_m": REAL,
    "command_delay_s": REAL,
    **{f"rejected_{reason}": INTEGER for reason in REASONS},
}
"""What was asked: name and type of each column."""

OUTCOME_COLUMNS = {
    "success": FLAG,
    "reached": FLAG,
    "reach_time_s": REAL,
    "final_position_error_m": REAL,
    "final_heading_error_rad": REAL,
    "min_object_clearance_m": REAL,
    "min_robot_clearance_m": REAL,
    "min_team_clearance_m": REAL,
    "collided": FLAG,
    "run_over": FLAG,
    "fell": FLAG,
    "contact_lost": REAL,
    "max_force_n": REAL,
    "path_length_m": REAL,
    "push_impulse_ns": REAL,
    "estimated_mass_kg": REAL,
    "estimated_inertia_kgm2": REAL,
    "estimated_moment_x_kgm": REAL,
    "estimated_moment_y_kgm": REAL,
    "estimated_friction_n": REAL,
    "estimated_friction_moment_nm": REAL,
    "ticks": INTEGER,
    "nonfinite": INTEGER,
    "converged": INTEGER,
}
"""What came of it; `success`: reached, nothing was touched, nobody fell, and all numbers were finite."""

COLUMNS = SCENARIO_COLUMNS | OUTCOME_COLUMNS
"""All columns of the results in their order."""

_ESTIMATES = [name for name in OUTCOME_COLUMNS if name.startswith("estimated_")]


def columns(study: Study, number: int, lanes: Sequence[Lane], outcome: Outcome) -> Columns:
    """The columns of a chunk.

    Args:
      study: that the lanes are of.
      number: of the study's variant.
      lanes: n scenarios.
      outcome: their outcomes, fields [n, ...] in NumPy.
    """
    rows = [scenario_row(study, number, lane) for lane in lanes]
    made = {name: [row[name] for row in rows] for name in SCENARIO_COLUMNS}
    return made | outcome_columns(outcome)


def scenario_row(study: Study, number: int, lane: Lane) -> dict[str, Any]:
    """What was asked in one lane, by column."""
    spec, points = lane.spec, len(study.points)
    truth, body = spec.truth, spec.object
    mass = body.mass if truth.mass is None else truth.mass
    friction = (body.friction or 0.0) if truth.friction is None else truth.friction
    com = truth.com or (0.0, 0.0)
    way = (spec.goal.pose[0] - spec.start[0], spec.goal.pose[1] - spec.start[1])
    corners = np.array(body.footprint)
    size = corners.max(axis=0) - corners.min(axis=0)
    return {
        "variant_number": number,
        "variant": study.variants[number].name,
        "lane": lane.index,
        "draw": lane.index // points,
        "point": lane.index % points,
        "point_name": study.point(lane.index).name,
        "duration_s": spec.duration,
        "size_x_m": float(size[0]),
        "size_y_m": float(size[1]),
        "believed_mass_kg": body.mass,
        "mass_ratio": mass / body.mass,
        "mass_kg": mass,
        "inertia_kgm2": float(np.asarray(lane.scenario.truth.inertia)),
        "com_x_m": com[0],
        "com_y_m": com[1],
        "friction": friction,
        "friction_n": friction * mass * GRAVITY,
        "capacity_n": capacity(spec),
        **dict(zip(("start_x_m", "start_y_m", "start_heading_rad"), spec.start, strict=True)),
        **dict(zip(("goal_x_m", "goal_y_m", "goal_heading_rad"), spec.goal.pose, strict=True)),
        "position_tolerance_m": spec.goal.position_tolerance,
        "heading_tolerance_rad": spec.goal.heading_tolerance,
        "distance_m": math.hypot(*way),
        "bearing_rad": math.atan2(way[1], way[0]),
        "turn_rad": math.remainder(spec.goal.pose[2] - spec.start[2], 2.0 * math.pi),
        "team_size": len(spec.robots),
        "robot_types": [robot.type for robot in spec.robots],
        "robot_faces": [str(robot.face) for robot in spec.robots],
        "robot_offsets_m": [robot.offset for robot in spec.robots],
        **_obstacles(spec),
        "position_std_m": spec.sensing.position_std,
        "heading_std_rad": spec.sensing.heading_std,
        "obstacle_std_m": spec.sensing.obstacle_std,
        "command_delay_s": spec.sensing.command_delay,
        **{f"rejected_{reason}": lane.rejected.get(reason, 0) for reason in REASONS},
    }


def _obstacles(spec: ScenarioSpec) -> dict[str, Any]:
    every = spec.obstacles
    sizes = [o.size or (2.0 * o.radius, 2.0 * o.radius) for o in every]
    sines = [o.motion if o.motion and o.motion.kind == "sine" else None for o in every]
    return {
        "obstacle_count": len(every),
        "moving_count": sum(moves(o) for o in every),
        "obstacle_shapes": [o.shape for o in every],
        "obstacle_x_m": [o.position[0] for o in every],
        "obstacle_y_m": [o.position[1] for o in every],
        "obstacle_size_x_m": [size[0] for size in sizes],
        "obstacle_size_y_m": [size[1] for size in sizes],
        "obstacle_yaw_rad": [o.yaw for o in every],
        "obstacle_speed_mps": [
            2.0 * math.pi * math.hypot(*sine.amplitude) / sine.period if sine else math.hypot(*o.velocity)
            for o, sine in zip(every, sines, strict=True)
        ],
        "obstacle_velocity_x_mps": [o.velocity[0] for o in every],
        "obstacle_velocity_y_mps": [o.velocity[1] for o in every],
        "obstacle_amplitude_x_m": [sine.amplitude[0] if sine else 0.0 for sine in sines],
        "obstacle_amplitude_y_m": [sine.amplitude[1] if sine else 0.0 for sine in sines],
        "obstacle_period_s": [sine.period if sine else 0.0 for sine in sines],
    }


def outcome_columns(outcome: Outcome) -> Columns:
    """What came of n lanes, by column; None where there is nothing (not reached, nothing to hit)."""
    made: Columns = {}
    success = outcome.reached & ~outcome.collided & ~outcome.fell & (outcome.nonfinite == 0)
    psi = np.asarray(outcome.estimates)
    for name, kind in OUTCOME_COLUMNS.items():
        if name == "success":
            values = success
        elif name in _ESTIMATES:
            values = psi[:, _ESTIMATES.index(name)]
        else:
            values = getattr(outcome, name)
        listed = np.asarray(values).tolist()
        if kind == REAL:
            limit = CLEAR if "clearance" in name else math.inf
            listed = [value if math.isfinite(value) and value < limit else None for value in listed]
        made[name] = listed
    return made
