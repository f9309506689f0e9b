"""A path that the team can push: a rough one bent until there is a wrench for every step of it.

Solved by a few SQP iterations on the quasi-static problem of `quasistatic`; local, so that which way around the
obstacles is the rough path's choice. A path in force begins with its own pushes and contact offsets: from poses alone
the iterations get stuck at costs up to a third higher. The end may differ from the goal by a part of its tolerances
where that saves a detour.
"""

from __future__ import annotations

import jax
import jax.numpy as jnp
from jax import Array

from jaxlocomanip.numerics import Floats, projected_least_squares, pytree, safe_norm
from jaxlocomanip.planar.dynamics import Body
from jaxlocomanip.planar.geometry import rotate
from jaxlocomanip.planner.authority import offset_ends
from jaxlocomanip.planner.config import PlannerConfig
from jaxlocomanip.planner.estimation import PREDICTED, ObstacleEstimate
from jaxlocomanip.planner.path import UNPLANNED, Path, resample
from jaxlocomanip.planner.quasistatic import Friction, PathProblem, PathStage, friction_of, motion
from jaxlocomanip.planner.shapes import Shapes
from jaxlocomanip.scenario import Goal, Team
from jaxlocomanip.solver import sqp
from jaxlocomanip.solver.ocp import Plan
from jaxlocomanip.solver.sqp import Iterate

STEPS = 48
"""of a refined path"""
_ITERATIONS = 10
"""at most"""
_SETTLED = 3e-3
"""relative change of the cost below which further iterations are not worth their time"""
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


@pytree
class Guess:
    """A path to start from, in steps of about the same length."""

    poses: Array
    """[STEPS + 1, 3], from where the object is, with continuous headings"""
    offset: Array
    """[STEPS + 1, N_r] m, contact offsets, from where the robots are"""
    push: Array
    """[STEPS, N_r] m, in terms of the motion that they make"""
    length: Array
    """[] m"""


def unrefined(guess: Guess) -> Refined:
    """Stands where no path is known: it costs more than any."""
    none = jnp.zeros_like(guess.push)
    return Refined(guess.poses, none, none, none[:, 0], jnp.full((), UNPLANNED, none.dtype))


def guess_along(
    path: Path, progress: Array, pose: Array, offset: Array, shapes: Shapes, body: Body, config: PlannerConfig
) -> Guess:
    """The rest of a path in force with its own pushes and offsets: from these few iterations are enough.

    Args:
      path: in force.
      progress: [] m, how far along it the object is.
      pose: [3] of the object now.
      offset: [N_r] m, contact offsets now.
      shapes: geometry and team.
      body: the object as estimated.
      config: settings.
    """
    left, friction = path.length - progress, friction_of(shapes, body)
    arc = progress + left * jnp.linspace(0.0, 1.0, STEPS + 1, dtype=pose.dtype)
    force, _ = path.feed_forward(0.5 * (arc[:-1] + arc[1:]))
    _, stand = path.feed_forward(arc)
    stand = stand.at[0].set(offset)
    units = _units(config.reference.turn_radius, left)

    def scaled(force: Array, offset: Array) -> Array:
        move = units * motion(force, offset, friction, shapes.team)[0]
        return force * left / STEPS / jnp.maximum(safe_norm(move), 1e-3)

    return Guess(path.at(arc).at[0].set(pose), stand, jax.vmap(scaled)(force, stand[:-1]), left)


def guess_from(rough: Array, offset: Array, shapes: Shapes, body: Body, config: PlannerConfig) -> Guess:
    """A searched path, poses [n, 3] alone, with pushes and contact offsets that nearly make it; arguments as above."""
    turn_radius = config.reference.turn_radius
    poses, arc = resample(rough, turn_radius, STEPS + 1)
    step = jnp.maximum(arc[-1] / STEPS, 1e-3)
    push, stand = first_pushes(poses, step, turn_radius, friction_of(shapes, body), shapes.team)
    return Guess(poses, jnp.concatenate([offset[None], stand]), push, arc[-1])


def first_pushes(guess: Array, step: Array, turn_radius: Floats, friction: Friction, team: Team) -> tuple[Array, Array]:
    """Pushes [n, N_r] and contact offsets [n, N_r] that nearly move the object along poses [n + 1, 3].

    A robot that may choose its contact offset pushes like two at the ends of its range.
    """
    ends = offset_ends(team)
    each = jax.vmap(lambda push, offset: motion(push, offset, friction, team)[0], in_axes=(0, None))
    ones = jnp.eye(ends.shape[1], dtype=guess.dtype)
    twists = jnp.concatenate([each(ones, ends[0]), each(ones, ends[1])]).T
    weight = _units(turn_radius, step)

    def split(a: Array, b: Array) -> tuple[Array, Array]:
        move = jnp.concatenate([rotate(-0.5 * (a[2] + b[2]), (b - a)[:2]), (b - a)[2:]])
        inputs = projected_least_squares(twists * weight[:, None], weight * move / step, jax.nn.relu, _SPREAD)
        pushes = jnp.maximum(inputs.reshape(2, -1), 0.0)
        total = jnp.sum(pushes, axis=0)
        offset = (jnp.sum(pushes * ends, axis=0) + _EVEN * jnp.mean(ends, axis=0)) / (total + _EVEN)
        return step * total, offset

    return jax.vmap(split)(guess[:-1], guess[1:])


def _units(turn_radius: Floats, like: Array) -> Array:
    """[3] m per unit of a pose's change, of the dtype of `like`."""
    return jnp.stack([jnp.ones_like(like), jnp.ones_like(like), jnp.asarray(turn_radius, like.dtype)])


def refine(
    guess: Guess, goal: Goal, shapes: Shapes, obstacles: ObstacleEstimate, body: Body, config: PlannerConfig
) -> Refined:
    """A path near a guess that the team can push.

    Args:
      guess: where to begin.
      goal: where to.
      shapes: geometry and team.
      obstacles: as estimated, extrapolated at constant velocity.
      body: the object as estimated.
      config: settings.
    """
    problem = _problem(guess, goal, shapes, obstacles, body, config)
    options = sqp.Options(iterations=1)
    inputs = jnp.concatenate([guess.push, jnp.diff(guess.offset, axis=0)], axis=1)
    first = sqp.start(Plan(jnp.concatenate([guess.poses, guess.offset], axis=1), inputs), options)

    def goes_on(carry: tuple[Array, Iterate, Array]) -> Array:
        count, now, before = carry
        settled = jnp.abs(before - _cost(now)) < _SETTLED * _cost(now)
        return (count < _ITERATIONS) & ((count < 2) | ~settled)

    def iterate(carry: tuple[Array, Iterate, Array]) -> tuple[Array, Iterate, Array]:
        count, now, _ = carry
        return count + 1, sqp.solve(problem, now.plan.xs[0], now, options), _cost(now)

    _, done, _ = jax.lax.while_loop(goes_on, iterate, (jnp.zeros((), jnp.int32), first, first.cost))
    poses, offsets = jnp.split(done.plan.xs, [3], axis=1)
    pushes = jnp.maximum(done.plan.us[:, : offsets.shape[1]], 0.0)
    sliding = jax.vmap(lambda u, d: motion(u, d, problem.friction, shapes.team)[1])(pushes, offsets[:-1])
    force = pushes / jnp.sqrt(jnp.sum(sliding**2, axis=1, keepdims=True) + 1e-6 * problem.step**2)
    room = jnp.min(problem.rooms(done.plan.xs[:-1]), axis=1)
    return Refined(poses, force, offsets[:-1], room + config.constraints.margin, _cost(done))


def _cost(iterate: Iterate) -> Array:
    """[] m."""
    return iterate.cost + _DEFECT * iterate.defect


def _problem(
    guess: Guess, goal: Goal, shapes: Shapes, obstacles: ObstacleEstimate, body: Body, config: PlannerConfig
) -> PathProblem:
    turn_radius, poses = config.reference.turn_radius, guess.poses
    turns = jnp.rint((poses[-1, 2] - goal.pose[2]) / (2.0 * jnp.pi))
    end = goal.pose + jnp.array([0.0, 0.0, 2.0 * jnp.pi], poses.dtype) * turns
    arc = guess.length * jnp.arange(STEPS, dtype=poses.dtype) / STEPS
    closeness = jnp.maximum(1.0 - (guess.length - arc) / _RUN_UP, 0.0)
    time = jnp.minimum(arc / config.reference.speed, PREDICTED)
    stages = PathStage(poses[:-1], turn_radius * jnp.sqrt(1.0 + _LATE * closeness), time)
    tolerance = jnp.stack([goal.position_tolerance, goal.position_tolerance, goal.heading_tolerance])
    step = jnp.maximum(guess.length / STEPS, 1e-3)
    return PathProblem(stages, end, tolerance, step, friction_of(shapes, body), shapes, obstacles, config)
