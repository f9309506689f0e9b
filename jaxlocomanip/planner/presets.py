"""Named planner configurations."""

from __future__ import annotations

from jaxlocomanip.checked import one_of
from jaxlocomanip.planner.config import (
    Adaptation,
    Barrier,
    Constraints,
    Horizon,
    PlannerConfig,
    Reference,
    SafetyFilter,
    Weights,
)
from jaxlocomanip.planner.penalty import UNBOUNDED


def paper() -> PlannerConfig:
    """The paper's table as printed, but for F_max, which belongs to the robots.

    Straight-line reference, four-column regressor against the reference, no friction in the prediction, soft
    barriers only.
    """
    bounds = Barrier(0.1, 0.01, UNBOUNDED)
    return PlannerConfig(
        horizon=Horizon(steps=50, tick=0.01),
        weights=Weights(
            pose=(2.0, 2.2, 0.2),
            twist=(0.3, 0.3, 0.1),
            final_pose=(150.0, 150.0, 3.0),
            final_twist=(3.0, 3.0, 8.0),
            offset=0.1,
            force=0.01,
            offset_rate=0.01,
        ),
        constraints=Constraints(
            force=bounds,
            offset=bounds,
            offset_rate=bounds,
            team=Barrier(0.0, 0.01, UNBOUNDED),
            object_cbf=Barrier(0.8, 0.5, UNBOUNDED),
            robot_cbf=Barrier(0.8, 0.5, UNBOUNDED),
            clf=Barrier(1.0, 0.5, UNBOUNDED),
            cbf_scale=1.0,
            margin=0.0,
            clf_normalised=0.0,
        ),
        reference=Reference(change_faces=0.0, plan_path=0.0, second_start=0.0, arrive=0.0, leave=0.0),
        adaptation=Adaptation(
            gain=(300.0, 200.0, 100.0, 100.0, 0.0, 0.0),
            on_prediction=0.0,
            breakaway=0.0,
            prior_friction=0.0,
            mass_range=10.0,
        ),
        safety=SafetyFilter(enabled=0.0),
    )


PRESETS = {"robust": PlannerConfig, "paper": paper}
"""Makers of configurations by name."""


def preset(name: str) -> PlannerConfig:
    """A named configuration.

    Raises:
      InputError: unknown name.
    """
    return PRESETS[one_of("config", name, list(PRESETS))]()
