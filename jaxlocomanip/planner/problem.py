"""The planner's optimal control problem, discretised (paper, "Nonlinear MPC").

State x = [p, theta, v, omega, d] [6 + N_r], input u = [f, ddot] [2 N_r]. The prediction is the implicit friction
step of the adapted model; inequalities enter as relaxed barriers.
"""

from __future__ import annotations

import dataclasses

import jax
import jax.numpy as jnp
from jax import Array

from jaxlocomanip.numerics import Floats, pytree, safe_norm, static, wrap_angle
from jaxlocomanip.planar import dynamics
from jaxlocomanip.planar.dynamics import Body
from jaxlocomanip.planar.geometry import cross
from jaxlocomanip.planar.vector import trailing, unit, vector
from jaxlocomanip.planner import barriers, constraints, curvature, linearisation
from jaxlocomanip.planner.barriers import Obstacles
from jaxlocomanip.planner.config import Number, PlannerConfig
from jaxlocomanip.planner.constraints import BarrierRows, Motion
from jaxlocomanip.planner.estimation import ObstacleEstimate
from jaxlocomanip.planner.penalty import relaxed_barrier
from jaxlocomanip.planner.reference import Targets
from jaxlocomanip.planner.shapes import Shapes
from jaxlocomanip.solver import sqp
from jaxlocomanip.solver.ocp import Penalty, Plan, Stage, StageModel


@pytree
class StageData:
    """What changes from stage to stage; the last axis of every leaf [..., N] counts stages, or is absent for one."""

    pose: Array
    """[3, N] reference"""
    twist: Array
    """[3, N]"""
    force: Array
    """[N_r, N] friction-compensating feed-forward, N"""
    offset: Array
    """[N_r, N] feed-forward of the contact offsets, m"""
    obstacles: Obstacles
    """where they are predicted and which of their features are near"""


@pytree
class PushProblem:
    """Implements `solver.ocp.Problem`, and evaluates all stages of a horizon side by side."""

    horizon: StageData
    """stages last"""
    final_pose: Array
    """[3]"""
    final_twist: Array
    """[3]"""
    body: Body
    """the object as estimated"""
    shapes: Shapes
    config: PlannerConfig
    barriers: BarrierRows
    steps: int = static(0)
    """N; the horizon's data go on for a few stages, see `wide`"""

    @property
    def stages(self) -> StageData:
        """The same data with stages first."""
        count = self.horizon.pose.shape[-1]

        def first(leaf: Array) -> Array:
            return jnp.moveaxis(jnp.broadcast_to(leaf, (*leaf.shape[:-1], count)), -1, 0)[: self.steps]

        return jax.tree.map(first, self.horizon)

    def stage(self, x: Array, u: Array, data: StageData) -> Stage:
        """Prediction, weighted residual and inequalities of one stage, or of all: x [nx, ...], u [nu, ...]."""
        following, groups = self._conditions(x, u, data)
        residual = jnp.sqrt(self.config.horizon.dt) * _times(jnp.sqrt(self.weights()), self.errors(x, u, data))
        flat = [h.reshape(-1, *x.shape[1:]) for h in groups]
        return Stage(following, residual, jnp.concatenate(flat))

    def _conditions(self, x: Array, u: Array, data: StageData) -> tuple[Array, tuple[Array, ...]]:
        """Next states [nx, ...] and the inequalities [m, ...] or [m, N_o, ...] in groups."""
        horizon, settings, shapes = self.config.horizon, self.config.constraints, self.shapes
        n = x.shape[0] - 6
        force, rate = u[:n], u[n:]
        wrench_B = self.wrench(x, u)
        pose, twist = dynamics.step(self.body, x[:3], x[3:6], wrench_B, horizon.dt, horizon.smoothing)
        motion = Motion(x[:3], x[3:6], (twist - x[3:6]) / horizon.dt, force, x[6:], rate)
        groups = (
            *constraints.bounds(motion, shapes),
            self.lyapunov(x[:3], x[3:6], wrench_B, data)[None],
            barriers.conditions(motion, shapes, data.obstacles, settings),
        )
        return jnp.concatenate([pose, twist, x[6:] + horizon.dt * rate]), groups

    def arms(self, offset: Array) -> Array:
        """[N_r, ...] m, moment of a unit push of each robot at contact offsets [N_r, ...]."""
        team = self.shapes.team
        fixed, changing = cross(team.origin, team.normal), cross(team.tangent, team.normal)
        return trailing(fixed, offset) + trailing(changing, offset) * offset

    def wrench(self, x: Array, u: Array) -> Array:
        """[3, ...] wrench of the pushes about p, body axes."""
        n = x.shape[0] - 6
        force, normal = u[:n], self.shapes.team.normal
        parts = [_times(normal[:, 0], force), _times(normal[:, 1], force), self.arms(x[6:]) * force]
        return jnp.stack([jnp.sum(part, axis=0) for part in parts])

    def errors(self, x: Array, u: Array, data: StageData) -> Array:
        """[nz, ...] deviations from the reference, in the order of states and inputs."""
        n = x.shape[0] - 6
        tracked = tracking_error(x, data.pose, data.twist)
        return jnp.concatenate([tracked, x[6:] - data.offset, u[:n] - data.force, u[n:]])

    def weights(self) -> Array:
        """[nz] quadratic weights of the `errors`, per second."""
        weights, n = self.config.weights, self.shapes.team.offset.shape[0]
        every = [*weights.pose, *weights.twist, *[weights.offset] * n, *[weights.force] * n, *[weights.offset_rate] * n]
        return jnp.stack([jnp.asarray(w, self.final_pose.dtype) for w in every])

    def lyapunov(self, pose: Array, twist: Array, wrench_B: Array, data: StageData) -> Array:
        """[...] CLF condition at states under a wrench [3, ...] in body axes."""
        force = vector(wrench_B).rotated(unit(pose[2]))
        wrench = jnp.stack([force.x, force.y, wrench_B[2]])
        settings, smoothing = self.config.constraints, self.config.horizon.smoothing
        return constraints.lyapunov_condition(
            pose, twist, wrench, self.body, data.pose, data.twist, settings, smoothing
        )

    def penalty(self, h: Array, data: StageData) -> Penalty:
        """Relaxed barriers of inequalities [nh, ...], per second of horizon."""
        del data
        rows = jax.tree.map(lambda v: trailing(v, h), self.barriers)
        return relaxed_barrier(h, self.config.horizon.dt * rows.weight, rows.switch, rows.reach)

    def model(self, x: Array, u: Array, data: StageData) -> StageModel:
        """Gauss-Newton model of one stage."""
        alone = jax.tree.map(lambda leaf: leaf[..., None], (x, u, data))
        return jax.tree.map(lambda leaf: leaf[0], linearisation.model(self, *alone))

    def values(self, plan: Plan) -> tuple[Array, Array]:
        """Cost [N] and next state [N, nx] of every stage."""
        x, u = wide(plan.xs[:-1]), wide(plan.us)
        following, groups = self._spread(x.shape[1])._conditions(x, u, self.horizon)
        cost = 0.5 * self.config.horizon.dt * jnp.sum(_times(self.weights(), self.errors(x, u, self.horizon) ** 2), 0)
        first = 0
        for h in groups:
            many = h.shape[0] if h.ndim == x.ndim else h.shape[0] * h.shape[1]
            rows = jax.tree.map(
                lambda v, h=h, a=first, b=first + many: jnp.broadcast_to(
                    trailing(v[a:b].reshape(h.shape[: h.ndim - 1]), h), h.shape
                ),
                self.barriers,
            )
            value = relaxed_barrier(h, self.config.horizon.dt * rows.weight, rows.switch, rows.reach).value
            cost = cost + jnp.sum(value, axis=tuple(range(h.ndim - 1)))
            first += many
        return cost[: self.steps], following[:, : self.steps].T

    def _spread(self, stages: int) -> PushProblem:
        """The same with a number for every stage of what is one for all, so that derivatives are summed only once."""
        config = self.config

        def spread(value: Floats) -> Array:
            value = jnp.asarray(value, self.final_pose.dtype)
            return jnp.broadcast_to(value[..., None], (*value.shape, stages))

        horizon = dataclasses.replace(config.horizon, smoothing=spread(config.horizon.smoothing))
        return dataclasses.replace(
            self,
            body=jax.tree.map(spread, self.body),
            config=dataclasses.replace(config, horizon=horizon),
        )

    def models(self, plan: Plan) -> StageModel:
        """Gauss-Newton models of all stages, leaves [N, ...]; equal to `solver.ocp.forward_model` of each."""
        every = linearisation.model(self, wide(plan.xs[:-1]), wide(plan.us), self.horizon)
        return jax.tree.map(lambda leaf: leaf[: self.steps], every)

    def curvature(self, plan: Plan, multipliers: Array) -> Array:
        """What the models' Hessians leave out (`solver.implicit.Curved`)."""
        every = curvature.curvature(self, wide(plan.xs[:-1]), wide(plan.us), wide(multipliers), self.horizon)
        return jnp.moveaxis(every, -1, 0)[: self.steps]

    def terminal(self, x: Array) -> Array:
        """Weighted terminal error."""
        weights = self.config.weights
        error = tracking_error(x, self.final_pose, self.final_twist)
        return error * roots(weights.final_pose, weights.final_twist)


TOGETHER = 8
"""stages that are computed at once: single precision numbers in a register of the processor"""


def wide(values: Array) -> Array:
    """[n, M] from [N, n]: stages last, and the last of them repeated until M is a multiple of `TOGETHER`.

    A loop over 30 numbers takes three steps of eight and then six more, so that two idle stages more than pay.
    """
    rows = values.T
    return jnp.concatenate([rows, jnp.repeat(rows[:, -1:], -values.shape[0] % TOGETHER, axis=1)], axis=1)


def _times(factors: Array, values: Array) -> Array:
    """Values [n, ...] times factors [n]."""
    return trailing(factors, values) * values


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
    pose, twist, force, offset, x = (
        wide(v[:-1]) for v in (targets.pose, targets.twist, targets.force, targets.offset, plan.xs)
    )
    steps, stages = targets.pose.shape[0] - 1, pose.shape[1]
    force = jnp.minimum(force * body.friction_force, shapes.team.force_max[:, None])
    times = config.horizon.dt * jnp.minimum(jnp.arange(stages, dtype=pose.dtype), steps - 1.0)
    drift = obstacles.velocity[..., None]
    places = obstacles.position[..., None] + times * drift
    seen = barriers.look(x[:3], x[6:], places, drift, shapes, config.constraints)
    return PushProblem(
        horizon=StageData(pose, twist, force, offset, seen),
        final_pose=targets.pose[-1],
        final_twist=targets.twist[-1],
        body=body,
        shapes=shapes,
        config=config,
        barriers=constraints.barrier_rows(shapes, config),
        steps=steps,
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
    """[6, ...] difference of states' [nx, ...] pose and twist to a reference [3, ...], the heading wrapped."""
    off = x[:3] - pose
    return jnp.concatenate([off[:2], wrap_angle(off[2:]), x[3:6] - twist])


def roots(first: tuple[Number, ...], second: tuple[Number, ...]) -> Array:
    """[6] square roots of pose and twist weights."""
    return jnp.sqrt(jnp.stack([jnp.asarray(w, jnp.result_type(float)) for w in (*first, *second)]))
