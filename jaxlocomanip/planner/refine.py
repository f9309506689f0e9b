"""A path that the team can push: a rough one bent until there is a wrench for every step of it.

Inputs are pushes u >= 0 at the two ends of each robot's range of contact offsets, and the dynamics are quasi-static:
on the ellipsoidal limit surface the twist about the centre of mass is proportional to (f_x, f_y, tau / rho^2) with
rho = M_c / F_c. So what comes out can be pushed, forwards only, with no more than the robots can push. With steps of
even length their squares sum up to the path's length, in which a radian counts `turn_radius`; relaxed barriers keep
object and robots, at the offsets that the pushes call for, off obstacles. The end may differ from the goal by a part
of its tolerances where that saves a detour.

Solved by a fixed number of SQP iterations; local, so that which way around the obstacles is the rough path's choice.
"""

from __future__ import annotations

import jax
import jax.numpy as jnp
from jax import Array

from jaxlocomanip.numerics import projected_least_squares, pytree, safe_norm
from jaxlocomanip.planar.dynamics import Body
from jaxlocomanip.planar.geometry import cross, feature_distance, nearest_feature, outline, perpendicular, rotate
from jaxlocomanip.planar.vector import Vector
from jaxlocomanip.planner.authority import CAPACITY, offset_ends
from jaxlocomanip.planner.config import PlannerConfig
from jaxlocomanip.planner.estimation import ObstacleEstimate
from jaxlocomanip.planner.path import UNPLANNED, resample
from jaxlocomanip.planner.penalty import relaxed_barrier
from jaxlocomanip.planner.pose_grid import FREE, MISS
from jaxlocomanip.planner.shapes import ROBOT_DISCS, Shapes
from jaxlocomanip.scenario import Goal
from jaxlocomanip.solver import sqp
from jaxlocomanip.solver.ocp import Penalty, Plan, Stage, StageModel, forward_model

STEPS = 48
"""of a refined path"""
_ITERATIONS = 10
_EFFORT = 0.1
"""weight of squared pushes beside that of squared steps: the robots share, and keep off the ends of their ranges"""
_INSIDE = 0.1
"""share of the same weight that a miss within it has"""
_EVENLY = 20.0
"""weight of steps of uneven length: obstacles cost per step, and a long one would pass through"""
_GUESS = 0.2
"""1/m^2, pull towards the rough path"""
_CONE = 0.2
"""weight of the barriers of pushes and of what robots can push"""
_NEAR = 5.0
"""weight of the barriers of obstacles"""
_LATE = 5.0
"""times dearer, less one, are turns just before the goal"""
_RUN_UP = 1.0
"""m before the goal over which turns get dearer"""
_STANDS = 0.1
"""of a step's length, sliding motion below which the object hardly slides"""
_EVEN = 0.05
"""of a step's length, push under which a robot stands at the middle of its range"""
_SPREAD = 1e-2
"""ridge with which the first guess splits a step among the robots"""
_DEFECT = 50.0
"""cost of steps that do not join, per m and rad"""
_SWITCH, _REACH = 0.02, 0.2
"""of the barriers of pushes, in multiples of what the motion takes"""
_SWITCH_NEAR = 0.05
"""m, of the barriers of obstacles, whose reach is the clearance that paths keep"""


@pytree
class Cone:
    """What pushes at the ends of the robots' ranges do, ends first."""

    ends: Array
    """[2, N_r] m, contact offsets"""
    twists: Array
    """[3, 2 N_r] m, m, rad of the object about its body point, body axes, per m of input"""
    norm: Array
    """[3, 2 N_r] the same forces in the norm of the limit surface, whose length is that of the sliding motion"""
    capacity: Array
    """[N_r] largest push in multiples of F_c"""


@pytree
class PathStage:
    """What changes along the path."""

    guess: Array
    """[STEPS, 3] rough path"""
    turning: Array
    """[STEPS] m, length of a radian here"""
    time: Array
    """[STEPS] s, when the team gets here"""


@pytree
class PathProblem:
    """Implements `solver.ocp.Problem`: states are poses [3], inputs [2 N_r] pushes in m of motion."""

    stages: PathStage
    goal: Array
    """[3], with the heading nearest to the rough path's end"""
    tolerance: Array
    """[3]"""
    step: Array
    """[] m, mean length of a step"""
    cone: Cone
    shapes: Shapes
    obstacles: ObstacleEstimate
    config: PlannerConfig

    def stage(self, x: Array, u: Array, data: PathStage) -> Stage:
        """One step of quasi-static motion."""
        move = self.cone.twists @ u
        following = x + jnp.concatenate([rotate(x[2] + 0.5 * move[2], move[:2]), move[2:]])
        per_step = jnp.sqrt(2.0 / self.step)
        way = jnp.concatenate([move[:2], data.turning * move[2:]])
        length = safe_norm(jnp.concatenate([move[:2], self.config.reference.turn_radius * move[2:]]))
        residual = jnp.concatenate(
            [
                per_step * way,
                jnp.sqrt(_EVENLY) * per_step * (length - self.step)[None],
                jnp.sqrt(_EFFORT) * per_step * u,
                jnp.sqrt(_GUESS * self.step) * (x - data.guess),
            ]
        )
        # Relative to the sliding motion, of which a turn on the spot has little: a little pull is a pull.
        pushes = u / jnp.sqrt(jnp.sum((self.cone.norm @ u) ** 2) + (_STANDS * self.step) ** 2)
        spare = self.cone.capacity - jnp.sum(pushes.reshape(2, -1), axis=0)
        return Stage(following, residual, jnp.concatenate([pushes, spare, self.room(x, u, data.time)]))

    def room(self, x: Array, u: Array, time: Array) -> Array:
        """[n] m, distances of all discs to their nearest obstacles, beyond radius and margin."""
        shapes = self.shapes
        robots = shapes.robot_centers(self._offsets(u)).reshape(-1, 2)
        centers = x[:2] + rotate(x[2], jnp.concatenate([shapes.object_centers, robots]))
        held = jax.lax.stop_gradient(centers)
        radii = jnp.concatenate([shapes.object_radii, jnp.repeat(shapes.robot_radii, ROBOT_DISCS)])
        places = self.obstacles.position + time * self.obstacles.velocity
        berth = jnp.where(shapes.obstacle_dynamic, self.config.reference.caution * time, 0.0)

        def nearest(center: Array) -> tuple[Array, Array]:
            def to(place: Array, vertices: Array) -> tuple[Array, Array]:
                point, corners = (Vector(v[..., 0], v[..., 1]) for v in (center - place, vertices))
                distance, normal, _ = feature_distance(point, nearest_feature(point, outline(corners)))
                return distance, jnp.stack([normal.x, normal.y])

            distance, normal = jax.vmap(to)(places, shapes.obstacle_vertices)
            distance = jnp.where(shapes.obstacle_mask, distance - shapes.obstacle_radius - berth, 1e3)
            best = jnp.argmin(distance)
            return distance[best], normal[best]

        distance, normal = jax.lax.stop_gradient(jax.vmap(nearest)(held))
        along = jnp.sum(normal * (centers - held), axis=1)
        return distance + along - radii - self.config.constraints.margin

    def _offsets(self, u: Array) -> Array:
        """[N_r] m, contact offsets at which robots push; one that hardly pushes stands at the middle of its range."""
        pushes, rest = jnp.maximum(u.reshape(2, -1), 0.0), _EVEN * self.step
        middle = jnp.mean(self.cone.ends, axis=0)
        return (jnp.sum(pushes * self.cone.ends, axis=0) + rest * middle) / (jnp.sum(pushes, axis=0) + rest)

    def push(self, u: Array) -> tuple[Array, Array]:
        """Pushes [N_r], in multiples of F_c, and contact offsets [N_r] m that inputs [2 N_r] stand for."""
        inputs = jnp.maximum(u, 0.0)
        sliding = jnp.sqrt(jnp.sum((self.cone.norm @ inputs) ** 2) + 1e-6 * self.step**2)
        return jnp.sum(inputs.reshape(2, -1), axis=0) / sliding, self._offsets(u)

    def penalty(self, h: Array, data: PathStage) -> Penalty:
        """Relaxed barriers, per metre of path."""
        n, protection = self.shapes.team.offset.shape[0], self.config.protection
        objects, robots = self.shapes.object_radii.shape[0], n * ROBOT_DISCS
        ones = jnp.ones_like(h)
        weight = jnp.concatenate(
            [
                _CONE * ones[: 3 * n],
                _NEAR * protection.object * ones[:objects],
                _NEAR * protection.robots * ones[:robots],
            ]
        )
        pushes = jnp.arange(h.shape[0]) < 3 * n
        reach = jnp.where(pushes, _REACH, self.config.reference.clearance)
        return relaxed_barrier(h, self.step * weight, jnp.where(pushes, _SWITCH, _SWITCH_NEAR), reach)

    def model(self, x: Array, u: Array, data: PathStage) -> StageModel:
        """Gauss-Newton model."""
        return forward_model(self, x, u, data)

    def terminal(self, x: Array) -> Array:
        """Miss of the goal beyond what costs nothing."""
        off = (x - self.goal) / self.tolerance
        distance = jnp.stack([safe_norm(off[:2]), jnp.abs(off[2])])
        beyond = jnp.maximum(distance - FREE, 0.0) / ((1.0 - FREE) * jnp.maximum(distance, FREE))
        inside = _INSIDE * off
        return jnp.sqrt(2.0 * MISS) * jnp.concatenate([off * beyond[jnp.array([0, 0, 1])], inside])


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


def cone_of(shapes: Shapes, body: Body) -> Cone:
    """The team's cone of wrenches as motions of the object."""
    team = shapes.team
    ends = offset_ends(team)
    points = team.origin + ends[..., None] * team.tangent
    normals = jnp.broadcast_to(team.normal, points.shape)
    ratio = body.friction_moment / jnp.maximum(body.friction_force, 1e-3)
    rho = jnp.maximum(ratio, 0.5 * shapes.torsion_radius)
    levers = cross(points - body.com, normals) / rho
    turn = (levers / rho)[..., None]
    twists = jnp.concatenate([normals - turn * perpendicular(body.com), turn], axis=-1)
    norm = jnp.concatenate([normals, levers[..., None]], axis=-1)
    capacity = CAPACITY * team.force_max / jnp.maximum(body.friction_force, 1.0)
    return Cone(ends, twists.reshape(-1, 3).T, norm.reshape(-1, 3).T, capacity)


def refine(
    rough: Array, goal: Goal, shapes: Shapes, obstacles: ObstacleEstimate, body: Body, config: PlannerConfig
) -> Refined:
    """A path near a rough one that the team can push.

    Args:
      rough: [n, 3] poses with continuous headings, from where the object is.
      goal: where to.
      shapes: geometry and team.
      obstacles: as estimated, extrapolated at constant velocity.
      body: the object as estimated.
      config: settings.
    """
    turn_radius = config.reference.turn_radius
    guess, arc = resample(rough, turn_radius, STEPS + 1)
    cone, step = cone_of(shapes, body), jnp.maximum(arc[-1] / STEPS, 1e-3)
    turns = jnp.rint((guess[-1, 2] - goal.pose[2]) / (2.0 * jnp.pi))
    end = goal.pose + jnp.array([0.0, 0.0, 2.0 * jnp.pi], guess.dtype) * turns
    closeness = jnp.maximum(1.0 - (arc[-1] - arc[:-1]) / _RUN_UP, 0.0)
    time = jnp.minimum(arc[:-1] / config.reference.speed, 3.0)
    stages = PathStage(guess[:-1], turn_radius * jnp.sqrt(1.0 + _LATE * closeness), time)
    tolerance = jnp.stack([goal.position_tolerance, goal.position_tolerance, goal.heading_tolerance])
    problem = PathProblem(stages, end, tolerance, step, cone, shapes, obstacles, config)
    weight = jnp.stack([jnp.ones_like(step), jnp.ones_like(step), jnp.asarray(turn_radius, step.dtype)])

    def split(a: Array, b: Array) -> Array:
        move = jnp.concatenate([rotate(-0.5 * (a[2] + b[2]), (b - a)[:2]), (b - a)[2:]])
        inputs = projected_least_squares(cone.twists * weight[:, None], weight * move / step, jax.nn.relu, _SPREAD)
        return step * inputs

    options = sqp.Options(iterations=_ITERATIONS)
    start = sqp.start(Plan(guess, jax.vmap(split)(guess[:-1], guess[1:])), options)
    done = sqp.solve(problem, guess[0], start, options)
    force, offset = jax.vmap(problem.push)(done.plan.us)
    margin = config.constraints.margin
    room = margin + jax.vmap(lambda x, u, t: jnp.min(problem.room(x, u, t)))(
        done.plan.xs[:-1], done.plan.us, stages.time
    )
    return Refined(done.plan.xs, force, offset, room, done.cost + _DEFECT * done.defect)
