"""Every setting of the planner, as one pytree of numbers.

Numbers are leaves, so that presets, ablations and tuned variants share one compilation and can be batched; the few
fields that fix array shapes are static. The defaults are the `robust` preset; `presets.py` has the paper's.
"""

from __future__ import annotations

from dataclasses import field

from jax import Array

from jaxlocomanip.numerics import pytree, static

Number = float | Array


def _triple(*values: float) -> tuple[Number, ...]:
    return field(default=tuple(values))


@pytree
class Horizon:
    """Discretisation of the optimal control problem and rate of the planner."""

    steps: int = static(30)
    """N, stages"""
    tick: float = static(0.02)
    """s, period of the planner; one command is held for it"""
    sqp_iterations: int = static(1)
    """iterations a tick"""
    rest_skips: bool = static(True)
    """plan only in lanes that have not arrived; off where gradients of whole episodes are wanted in reverse mode"""
    dt: Number = 0.1
    """s, length of a stage"""
    smoothing: Number = 0.02
    """m/s, width of the transition between sticking and sliding in the prediction"""


@pytree
class Weights:
    """Quadratic cost (paper: Q_x, Q_f, Q_d, R_u); stage weights are per second."""

    pose: tuple[Number, ...] = _triple(40.0, 40.0, 8.0)
    twist: tuple[Number, ...] = _triple(5.0, 5.0, 1.0)
    final_pose: tuple[Number, ...] = _triple(150.0, 150.0, 60.0)
    final_twist: tuple[Number, ...] = _triple(3.0, 3.0, 8.0)
    offset: Number = 2.0
    """1/m^2, contact offset about its feed-forward"""
    force: Number = 4e-3
    """1/N^2, force about its feed-forward"""
    offset_rate: Number = 0.2


@pytree
class Barrier:
    """Relaxed barrier of a group of inequalities."""

    weight: Number
    """rho >= 0, per second; 0 switches the group off"""
    switch: Number
    """eps > 0, in the units of the inequality"""
    reach: Number
    """h_0 > eps, beyond which the barrier is zero; 1e6 for the paper's plain logarithm"""


@pytree
class Constraints:
    """Inequalities of the optimal control problem."""

    force: Barrier = Barrier(0.02, 1.0, 5.0)
    """0 <= f <= F_max, N"""
    offset: Barrier = Barrier(0.1, 0.01, 0.05)
    """|d| <= limit, m"""
    offset_rate: Barrier = Barrier(0.1, 0.02, 0.1)
    """|ddot| <= limit, m/s"""
    team: Barrier = Barrier(1.0, 0.05, 0.2)
    """room between robots of neighbouring contacts, m"""
    object_cbf: Barrier = Barrier(0.4, 0.05, 0.2)
    robot_cbf: Barrier = Barrier(0.4, 0.05, 0.2)
    clf: Barrier = Barrier(0.005, 0.5, 5.0)
    object_alpha: Number = 4.0
    """1/s^2, ECBF B'' + beta B' + alpha B >= 0"""
    object_beta: Number = 4.0
    """1/s"""
    robot_alpha: Number = 4.0
    """1/s, CBF B' + alpha B >= 0"""
    cbf_scale: Number = 0.25
    """the CBF conditions are multiplied by it before they are penalised"""
    margin: Number = 0.05
    """m, added to every radius"""
    clf_rate: Number = 3.0
    """lambda, 1/s, of the composite error in the CLF"""
    clf_gain: Number = 3.0
    """K_D = clf_gain I"""
    clf_normalised: Number = 1.0
    """1: divide the CLF condition by 1 + |s|; 0: as printed"""


@pytree
class Reference:
    """Path and progress along it."""

    speed: Number = 0.5
    """v_avg, m/s"""
    turn_rate: Number = 0.8
    """w_avg, rad/s"""
    walk_fraction: Number = 0.8
    """of a robot's sideways walking speed, at most used to follow the reference"""
    lead: Number = 0.3
    """m, how far the reference may run ahead of the object"""
    settle: Number = 0.2
    """m, length of the exponential approach to the goal"""
    arrive: Number = 0.6
    """fraction of the goal tolerances within which a moving object is let come to rest"""
    leave: Number = 0.95
    """fraction of the goal tolerances beyond which an object at rest is pushed on"""
    second_start: Number = 1.0
    """1: each tick, try a plan that pushes at once beside the warm start; 0: warm start only"""
    change_faces: Number = 1.0
    """1: the team walks around the object to other faces where it may and it pays; 0: it keeps its faces"""
    plan_path: Number = 1.0
    """1: obstacle-aware path; 0: straight line from the start"""
    clearance: Number = 0.3
    """m, the path keeps this far from obstacles where it costs little"""
    caution: Number = 0.2
    """m/s, rate at which the path's berth around a moving obstacle grows with the time until the team is there"""
    replan: float = static(1.0)
    """s, between two path searches"""

    @property
    def turn_radius(self) -> Number:
        """m, length of a radian: as long as it takes at the usual speeds."""
        return self.speed / self.turn_rate


@pytree
class Adaptation:
    """Adaptation law for Psi = [m, I, m c_x, m c_y, F_c, M_c]."""

    gain: tuple[Number, ...] = _triple(3.0, 0.3, 1.0, 1.0, 300.0, 10.0)
    """diagonal of Gamma; all zero: no adaptation"""
    rate: Number = 3.0
    """lambda, 1/s, of the composite error"""
    on_prediction: Number = 1.0
    """1: error against the one-tick prediction; 0: against the reference (paper)"""
    breakaway: Number = 1.0
    """1: the push at which the object breaks away bounds its friction; 0: only the law above"""
    low_pass: Number = 0.1
    """s, time constant of what reaches the prediction"""
    prior_friction: Number = 0.35
    """Coulomb coefficient assumed where the scenario states none"""
    max_friction: Number = 0.9
    """largest Coulomb coefficient of the projection box, at the believed mass"""
    mass_range: Number = 2.5
    """the estimated mass stays within [1/mass_range, mass_range] of the belief"""


@pytree
class Estimation:
    """State estimation."""

    pose_gain: Number = 0.4
    """fraction of the pose innovation that corrects the pose each tick"""
    twist_gain: Number = 0.1
    """fraction of it, per tick length, that corrects the velocity"""
    obstacle_noise: Number = 0.02
    """m, standard deviation that the obstacle filter expects of a position"""
    obstacle_acceleration: Number = 0.8
    """m/s^2, standard deviation of a dynamic obstacle's acceleration"""


@pytree
class SafetyFilter:
    """Last-line check of the first input."""

    enabled: Number = 1.0
    friction: Number = 0.12
    """Coulomb coefficient that the team certainly brakes with"""
    belief: Number = 0.7
    """share of the friction seen on the way that it brakes with beyond that"""
    margin: Number = 0.03
    """m, free space kept by the true shapes while braking"""
    team_margin: Number = 0.03
    """m between robots, to which they slide together at most; where they sway, that much more (`World.sway`)"""
    lag: Number = 0.06
    """s, after which a withdrawn push has faded"""
    look_ahead: Number = 2.5
    """s, moving obstacles are avoided over this time by a team that waits"""
    swerve: Number = 0.8
    """m/s^2, with which an obstacle may change its velocity while the team brakes"""


@pytree
class Protection:
    """Which bodies are kept away from obstacles, by path, barriers and filter alike (1 or 0)."""

    object: Number = 1.0
    robots: Number = 1.0


@pytree
class PlannerConfig:
    """All settings; the default is the `robust` preset."""

    horizon: Horizon = Horizon()
    weights: Weights = Weights()
    constraints: Constraints = Constraints()
    reference: Reference = Reference()
    adaptation: Adaptation = Adaptation()
    estimation: Estimation = Estimation()
    safety: SafetyFilter = SafetyFilter()
    protection: Protection = Protection()
