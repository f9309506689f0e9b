"""A path that the team can push: a rough one bent until there is a wrench for every step of it.

Solved by a fixed number of SQP iterations on the quasi-static problem of `quasistatic`; local, so that which way around
the obstacles is the rough path's choice. The end may differ from the goal by a part of its tolerances where that saves
a detour.
"""

from __future__ import annotations

import jax
import jax.numpy as jnp
from jax import Array

from jaxlocomanip.numerics import Floats, projected_least_squares, pytree
from jaxlocomanip.planar.dynamics import Body
from jaxlocomanip.planar.geometry import rotate
from jaxlocomanip.planner.authority import offset_ends
from jaxlocomanip.planner.config import PlannerConfig
from jaxlocomanip.planner.estimation import ObstacleEstimate
from jaxlocomanip.planner.path import UNPLANNED, resample
from jaxlocomanip.planner.quasistatic import Friction, PathProblem, PathStage, friction_of, motion
from jaxlocomanip.planner.shapes import Shapes
from jaxlocomanip.scenario import Goal, Team
from jaxlocomanip.solver import sqp
from jaxlocomanip.solver.ocp import Plan

STEPS = 48
"""of a refined path"""
_ITERATIONS = 10
_LATE = 5.0
"""times dearer, less one, are turns just before the goal"""
_RUN_UP = 1.0
"""m before the goal over which turns get dearer"""
_EVEN = 0.05
"""of a step's length, push under which the first guess has a robot stand at the middle of its range"""
_SPREAD = 1e-2
"""ridge with which the first guess splits a step among the robots"""
_DEFECT = 50.0
"""cost of steps that do not join, per m and rad"""


@pytree
class Refined:
    """A path that can be pushed."""

    poses: Array
    """[STEPS + 1, 3]"""
    force: Array
    """[STEPS, N_r] pushes in multiples of F_c"""
    offset: Array
    """[STEPS, N_r] m, contact offsets of these pushes"""
    room: Array
    """[STEPS] m, least distance of a disc to an obstacle"""
    cost: Array
    """[] m, length and what comes on top of it"""


def unrefined(rough: Array, shapes: Shapes) -> Refined:
    """Stands where no path is known: it costs more than any."""
    pushes = jnp.zeros((STEPS, shapes.team.offset.shape[0]), rough.dtype)
    return Refined(rough[: STEPS + 1], pushes, pushes, pushes[:, 0], jnp.full((), UNPLANNED, rough.dtype))


def first_pushes(guess: Array, step: Array, turn_radius: Floats, friction: Friction, team: Team) -> tuple[Array, Array]:
    """Pushes [n, N_r] and contact offsets [n, N_r] that nearly move the object along poses [n + 1, 3].

    A robot that may choose its contact offset pushes like two at the ends of its range.
    """
    ends = offset_ends(team)
    each = jax.vmap(lambda push, offset: motion(push, offset, friction, team)[0], in_axes=(0, None))
    ones = jnp.eye(ends.shape[1], dtype=guess.dtype)
    twists = jnp.concatenate([each(ones, ends[0]), each(ones, ends[1])]).T
    weight = jnp.stack([jnp.ones_like(step), jnp.ones_like(step), jnp.asarray(turn_radius, step.dtype)])

    def split(a: Array, b: Array) -> tuple[Array, Array]:
        move = jnp.concatenate([rotate(-0.5 * (a[2] + b[2]), (b - a)[:2]), (b - a)[2:]])
        inputs = projected_least_squares(twists * weight[:, None], weight * move / step, jax.nn.relu, _SPREAD)
        pushes = jnp.maximum(inputs.reshape(2, -1), 0.0)
        total = jnp.sum(pushes, axis=0)
        offset = (jnp.sum(pushes * ends, axis=0) + _EVEN * jnp.mean(ends, axis=0)) / (total + _EVEN)
        return step * total, offset

    return jax.vmap(split)(guess[:-1], guess[1:])


def refine(
    rough: Array,
    offset: Array,
    goal: Goal,
    shapes: Shapes,
    obstacles: ObstacleEstimate,
    body: Body,
    config: PlannerConfig,
) -> Refined:
    """A path near a rough one that the team can push.

    Args:
      rough: [n, 3] poses with continuous headings, from where the object is.
      offset: [N_r] m, contact offsets now.
      goal: where to.
      shapes: geometry and team.
      obstacles: as estimated, extrapolated at constant velocity.
      body: the object as estimated.
      config: settings.
    """
    turn_radius = config.reference.turn_radius
    guess, arc = resample(rough, turn_radius, STEPS + 1)
    friction, step = friction_of(shapes, body), jnp.maximum(arc[-1] / STEPS, 1e-3)
    turns = jnp.rint((guess[-1, 2] - goal.pose[2]) / (2.0 * jnp.pi))
    end = goal.pose + jnp.array([0.0, 0.0, 2.0 * jnp.pi], guess.dtype) * turns
    closeness = jnp.maximum(1.0 - (arc[-1] - arc[:-1]) / _RUN_UP, 0.0)
    time = jnp.minimum(arc[:-1] / config.reference.speed, 3.0)
    stages = PathStage(guess[:-1], turn_radius * jnp.sqrt(1.0 + _LATE * closeness), time)
    tolerance = jnp.stack([goal.position_tolerance, goal.position_tolerance, goal.heading_tolerance])
    problem = PathProblem(stages, end, tolerance, step, friction, shapes, obstacles, config)
    push, stand = first_pushes(guess, step, turn_radius, friction, shapes.team)
    stand = jnp.concatenate([offset[None], stand])
    first = Plan(jnp.concatenate([guess, stand], axis=1), jnp.concatenate([push, jnp.diff(stand, axis=0)], axis=1))
    options = sqp.Options(iterations=_ITERATIONS)
    done = sqp.solve(problem, first.xs[0], sqp.start(first, options), options)
    poses, offsets = done.plan.xs[:, :3], done.plan.xs[:, 3:]
    pushes = jnp.maximum(done.plan.us[:, : offset.shape[0]], 0.0)
    sliding = jax.vmap(lambda u, d: motion(u, d, friction, shapes.team)[1])(pushes, offsets[:-1])
    force = pushes / jnp.sqrt(jnp.sum(sliding**2, axis=1, keepdims=True) + 1e-6 * step**2)
    room = jax.vmap(lambda q, d, t: jnp.min(problem.room(q, d, t)))(poses[:-1], offsets[:-1], stages.time)
    cost = done.cost + _DEFECT * done.defect
    return Refined(poses, force, offsets[:-1], room + config.constraints.margin, cost)
