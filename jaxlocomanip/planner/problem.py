"""The planner's optimal control problem, discretised (paper, "Nonlinear MPC").

State x = [p, theta, v, omega, d] [6 + N_r], input u = [f, ddot] [2 N_r]. The prediction is the implicit friction
step of the adapted model; inequalities enter as relaxed barriers.
"""

from __future__ import annotations

import jax
import jax.numpy as jnp
from jax import Array

from jaxlocomanip.numerics import pytree, safe_norm, wrap_angle
from jaxlocomanip.planar import dynamics
from jaxlocomanip.planar.dynamics import Body
from jaxlocomanip.planar.geometry import rotate
from jaxlocomanip.planner import constraints, curvature, linearisation
from jaxlocomanip.planner.config import Number, PlannerConfig
from jaxlocomanip.planner.constraints import BarrierRows, Motion, Obstacles
from jaxlocomanip.planner.estimation import ObstacleEstimate
from jaxlocomanip.planner.penalty import relaxed_barrier
from jaxlocomanip.planner.reference import Targets
from jaxlocomanip.planner.shapes import Shapes
from jaxlocomanip.solver import sqp
from jaxlocomanip.solver.ocp import Penalty, Plan, Stage, StageModel


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
    obstacles: Obstacles
    """leaves [N, ...], where obstacles are predicted and which of their features are near"""


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
    config: PlannerConfig
    barriers: BarrierRows

    def stage(self, x: Array, u: Array, data: StageData) -> Stage:
        """Prediction, weighted residual and inequalities of one stage."""
        config, horizon, team = self.config, self.config.horizon, self.shapes.team
        n = team.offset.shape[0]
        force, rate = u[:n], u[n:]
        wrench_B = dynamics.body_wrench(team.contact_points(x[6:]), team.normal, force)
        pose, twist = dynamics.step(self.body, x[:3], x[3:6], wrench_B, horizon.dt, horizon.smoothing)
        motion = Motion(x[:3], x[3:6], (twist - x[3:6]) / horizon.dt, force, x[6:], rate)
        settings = config.constraints
        inequality = jnp.concatenate(
            [
                *constraints.bounds(motion, self.shapes),
                self.lyapunov(x[:3], x[3:6], wrench_B, data)[None],
                constraints.object_conditions(motion, self.shapes, data.obstacles, settings),
                constraints.robot_conditions(motion, self.shapes, data.obstacles, settings),
            ]
        )
        weights = config.weights
        residual = jnp.concatenate(
            [
                tracking_error(x, data.pose, data.twist) * roots(weights.pose, weights.twist),
                jnp.sqrt(weights.offset) * (x[6:] - data.offset),
                jnp.sqrt(weights.force) * (force - data.force),
                jnp.sqrt(weights.offset_rate) * rate,
            ]
        )
        following = jnp.concatenate([pose, twist, x[6:] + horizon.dt * rate])
        return Stage(following, jnp.sqrt(horizon.dt) * residual, inequality)

    def lyapunov(self, pose: Array, twist: Array, wrench_B: Array, data: StageData) -> Array:
        """[] CLF condition at a state under a wrench [3] in body axes."""
        wrench = jnp.concatenate([rotate(pose[2], wrench_B[:2]), wrench_B[2:]])
        settings, smoothing = self.config.constraints, self.config.horizon.smoothing
        return constraints.lyapunov_condition(
            pose, twist, wrench, self.body, data.pose, data.twist, settings, smoothing
        )

    def penalty(self, h: Array, data: StageData) -> Penalty:
        """Relaxed barriers, per second of horizon."""
        return relaxed_barrier(
            h, self.config.horizon.dt * self.barriers.weight, self.barriers.switch, self.barriers.reach
        )

    def model(self, x: Array, u: Array, data: StageData) -> StageModel:
        """Gauss-Newton model; equals `solver.ocp.forward_model`, with the known zeros left out."""
        return linearisation.stage_model(self, x, u, data)

    def curvature(self, x: Array, u: Array, multiplier: Array, model: StageModel, data: StageData) -> Array:
        """What the model's Hessian leaves out (`solver.implicit.Curved`)."""
        return curvature.stage_curvature(self, x, u, multiplier, model, data)

    def terminal(self, x: Array) -> Array:
        """Weighted terminal error."""
        weights = self.config.weights
        error = tracking_error(x, self.final_pose, self.final_twist)
        return error * roots(weights.final_pose, weights.final_twist)


def assemble(
    targets: Targets,
    plan: Plan,
    body: Body,
    shapes: Shapes,
    obstacles: ObstacleEstimate,
    config: PlannerConfig,
) -> PushProblem:
    """The problem of one tick.

    Penalising forces against the steady push along the reference, not against zero, is what makes the plan push at once
    against stiction.

    Args:
      targets: reference over the horizon [N + 1].
      plan: the warm start; decides which corner or edge of an obstacle each disc is held against at each stage.
      body: the object as estimated.
      shapes: geometry.
      obstacles: estimated positions and velocities, extrapolated at constant velocity.
      config: settings.
    """
    steps = targets.pose.shape[0] - 1
    times = config.horizon.dt * jnp.arange(steps, dtype=targets.pose.dtype)
    force = jnp.minimum(targets.force[:-1] * body.friction_force, shapes.team.force_max)

    def seen(x: Array, time: Array) -> Obstacles:
        places = obstacles.position + time * obstacles.velocity
        return constraints.look(x[:3], x[6:], places, obstacles.velocity, shapes, config.constraints.margin)

    return PushProblem(
        stages=StageData(
            targets.pose[:-1],
            targets.twist[:-1],
            force,
            targets.offset[:-1],
            jax.vmap(seen)(plan.xs[:-1], times),
        ),
        final_pose=targets.pose[-1],
        final_twist=targets.twist[-1],
        body=body,
        shapes=shapes,
        config=config,
        barriers=constraints.barrier_rows(shapes, config),
    )


def pushing_start(problem: PushProblem, x0: Array) -> Plan:
    """A plan that sets the object moving at once: steady pushes along the reference, larger at first.

    Where the object sticks, a small push changes nothing and has no gradient: a plan that pushes later is a local
    minimum that the warm start would keep. This start is compared with it every tick.
    """
    data, horizon = problem.stages, problem.config.horizon
    wanted = safe_norm(data.twist[0, :2])
    missing = jnp.clip(wanted - safe_norm(x0[3:5]), 0.0, wanted)
    friction = jnp.maximum(problem.body.friction_force, 1.0)
    surge = 1.0 + problem.body.mass * missing / (friction * START_STAGES * horizon.dt)
    stages = jnp.arange(data.force.shape[0])[:, None]
    force = data.force * jnp.where(stages < START_STAGES, surge, 1.0)
    slide = (data.offset - x0[6:]) / (START_STAGES * horizon.dt)
    limit = problem.shapes.team.slide_speed_max
    rate = jnp.where(stages < START_STAGES, jnp.clip(slide, -limit, limit), 0.0)
    us = jnp.concatenate([jnp.minimum(force, problem.shapes.team.force_max), rate], axis=1)
    return sqp.rollout(problem, x0, us)


START_STAGES = 3
"""stages over which `pushing_start` accelerates the object and moves the contacts into place"""


def tracking_error(x: Array, pose: Array, twist: Array) -> Array:
    """[6] difference of a state's pose and twist to a reference, the heading wrapped."""
    off = x[:3] - pose
    return jnp.concatenate([off[:2], wrap_angle(off[2:]), x[3:6] - twist])


def roots(first: tuple[Number, ...], second: tuple[Number, ...]) -> Array:
    """[6] square roots of pose and twist weights."""
    return jnp.sqrt(jnp.stack([jnp.asarray(w, jnp.result_type(float)) for w in (*first, *second)]))
