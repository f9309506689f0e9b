"""The planner's optimal control problem, discretised (paper, "Nonlinear MPC").

State x = [p, theta, v, omega, d] [6 + N_r], input u = [f, ddot] [2 N_r]. The prediction is the implicit friction step of the
adapted model; inequalities enter as relaxed barriers.
"""

from __future__ import annotations

import jax.numpy as jnp
from jax import Array

from jaxlocomanip.numerics import pytree, wrap_angle
from jaxlocomanip.planar import dynamics
from jaxlocomanip.planar.dynamics import Body
from jaxlocomanip.planar.geometry import rotate
from jaxlocomanip.planner import constraints
from jaxlocomanip.planner.config import PlannerConfig
from jaxlocomanip.planner.constraints import Motion
from jaxlocomanip.planner.estimation import ObstacleEstimate
from jaxlocomanip.planner.penalty import relaxed_barrier
from jaxlocomanip.planner.reference import Targets
from jaxlocomanip.planner.shapes import Shapes
from jaxlocomanip.solver.ocp import Penalty, Stage


@pytree
class StageData:
    """What changes from stage to stage."""

    pose: Array
    """[N, 3] reference"""
    twist: Array
    """[N, 3]"""
    force: Array
    """[N, N_r] friction-compensating feed-forward, N"""
    offset: Array
    """[N, N_r] feed-forward of the contact offsets, m"""
    obstacle_position: Array
    """[N, N_o, 2] predicted"""


@pytree
class PushProblem:
    """Implements `solver.ocp.Problem`."""

    stages: StageData
    final_pose: Array
    """[3]"""
    final_twist: Array
    """[3]"""
    body: Body
    """the object as estimated"""
    shapes: Shapes
    obstacle_velocity: Array
    """[N_o, 2] m/s"""
    config: PlannerConfig
    weights: Array
    """[nh] barrier weights"""
    switches: Array
    """[nh] barrier switches"""

    def stage(self, x: Array, u: Array, data: StageData) -> Stage:
        """Prediction, weighted residual and inequalities of one stage."""
        config, horizon, team = self.config, self.config.horizon, self.shapes.team
        n = team.offset.shape[0]
        force, rate = u[:n], u[n:]
        points = team.contact_points(x[6:])
        wrench_B = dynamics.body_wrench(points, team.normal, force)
        pose, twist = dynamics.step(self.body, x[:3], x[3:6], wrench_B, horizon.dt, horizon.smoothing)
        motion = Motion(x[:3], x[3:6], (twist - x[3:6]) / horizon.dt, force, x[6:], rate)
        wrench = jnp.concatenate([rotate(x[2], wrench_B[:2]), wrench_B[2:]])
        where, speed = data.obstacle_position, self.obstacle_velocity
        clf = constraints.lyapunov_condition(
            motion, wrench, self.body, data.pose, data.twist, config, horizon.smoothing
        )
        cbf = [
            config.constraints.cbf_scale * constraints.object_barrier(motion, self.shapes, where, speed, config),
            config.constraints.cbf_scale * constraints.robot_barrier(motion, self.shapes, where, speed, config),
        ]
        inequality = jnp.concatenate([*constraints.bounds(motion, self.shapes), clf, *cbf])
        weights = config.weights
        residual = jnp.concatenate(
            [
                _error(x, data.pose, data.twist) * _roots(weights.pose, weights.twist),
                jnp.sqrt(weights.offset) * (x[6:] - data.offset),
                jnp.sqrt(weights.force) * (force - data.force),
                jnp.sqrt(weights.offset_rate) * rate,
            ]
        )
        following = jnp.concatenate([pose, twist, x[6:] + horizon.dt * rate])
        return Stage(following, jnp.sqrt(horizon.dt) * residual, inequality)

    def penalty(self, h: Array, data: StageData) -> Penalty:
        """Relaxed barriers, per second of horizon."""
        return relaxed_barrier(h, self.config.horizon.dt * self.weights, self.switches)

    def terminal(self, x: Array) -> Array:
        """Weighted terminal error."""
        weights = self.config.weights
        error = _error(x, self.final_pose, self.final_twist)
        return error * _roots(weights.final_pose, weights.final_twist)


def assemble(
    targets: Targets, body: Body, shapes: Shapes, obstacles: ObstacleEstimate, config: PlannerConfig
) -> PushProblem:
    """The problem of one tick.

    Penalising forces against the steady push along the reference, not against zero, is what makes the plan push at once
    against stiction.

    Args:
      targets: reference over the horizon [N + 1].
      body: the object as estimated.
      shapes: geometry.
      obstacles: estimated positions and velocities, extrapolated at constant velocity.
      config: settings.
    """
    steps = targets.pose.shape[0] - 1
    times = config.horizon.dt * jnp.arange(steps, dtype=targets.pose.dtype)
    positions = obstacles.position + times[:, None, None] * obstacles.velocity
    force = jnp.minimum(targets.force[:-1] * body.friction_force, shapes.team.force_max)
    weights, switches = constraints.barriers(shapes, config)
    return PushProblem(
        stages=StageData(targets.pose[:-1], targets.twist[:-1], force, targets.offset[:-1], positions),
        final_pose=targets.pose[-1],
        final_twist=targets.twist[-1],
        body=body,
        shapes=shapes,
        obstacle_velocity=obstacles.velocity,
        config=config,
        weights=weights,
        switches=switches,
    )


def _error(x: Array, pose: Array, twist: Array) -> Array:
    off = x[:3] - pose
    return jnp.concatenate([off[:2], wrap_angle(off[2:]), x[3:6] - twist])


def _roots(first: tuple, second: tuple) -> Array:
    return jnp.sqrt(jnp.stack([jnp.asarray(w, jnp.result_type(float)) for w in (*first, *second)]))
