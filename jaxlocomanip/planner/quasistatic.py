"""The quasi-static motion of an object that a team pushes, as a small optimal control problem along a path.

States are poses and contact offsets, inputs pushes and changes of the offsets. On the ellipsoidal limit surface the
twist about the centre of mass is proportional to (f_x, f_y, tau / rho^2) with rho = M_c / F_c. So what comes out can be
pushed, forwards only, with no more than the robots can push, from where they stand: a sharp turn takes offsets to which
they have to walk first, and walking costs like way. With steps of even length their squares sum up to the path's
length, in which a radian counts `turn_radius`; relaxed barriers keep object and robots off obstacles and the robots out
of each other's way.
"""

from __future__ import annotations

from collections.abc import Callable

import jax
import jax.numpy as jnp
from jax import Array

from jaxlocomanip.numerics import T, apart, pytree, safe_norm
from jaxlocomanip.planar.dynamics import Body
from jaxlocomanip.planar.geometry import (
    Outline,
    cross,
    feature_distance,
    nearest_feature,
    outline,
    perpendicular,
    rotate,
)
from jaxlocomanip.planar.vector import Vector, choose, vectors
from jaxlocomanip.planner.authority import CAPACITY, usable_offsets
from jaxlocomanip.planner.config import PlannerConfig
from jaxlocomanip.planner.estimation import ObstacleEstimate
from jaxlocomanip.planner.penalty import relaxed_barrier
from jaxlocomanip.planner.pose_grid import FREE, MISS
from jaxlocomanip.planner.shapes import ROBOT_DISCS, Shapes
from jaxlocomanip.scenario import Team
from jaxlocomanip.solver.ocp import Penalty, Plan, Stage, StageModel, forward_model, stage_cost

_EFFORT = 0.1
"""weight of squared pushes beside that of squared steps: the robots share, and keep off the ends of their ranges"""
_INSIDE = 0.1
"""share of a miss's price (`pose_grid`) that one within the tolerances has"""
_EVENLY = 20.0
"""weight of steps of uneven length: obstacles cost per step, and a long one would pass through"""
_GUESS = 0.2
"""1/m^2, pull towards the rough path"""
_CONE = 0.2
"""weight of the barriers of pushes and of what robots can push"""
_NEAR = 5.0
"""weight of the barriers of obstacles"""
_SLIDE = 1.0
"""m of way that a robot's walk of one metre along its face is worth: it takes as long"""
_IDLE = 0.5
"""1/m^2, pull of the contact offsets to the middle of their ranges"""
_STANDS = 0.1
"""of a step's length, sliding motion below which the object hardly slides"""
_SWITCH, _REACH = 0.02, 0.2
"""of the barriers of pushes, in multiples of what the motion takes"""
_SWITCH_OFFSET, _REACH_OFFSET = 0.01, 0.05
"""m, of the barriers of contact offsets and of room between robots"""
_SWITCH_NEAR = 0.05
"""m, of the barriers of obstacles, whose reach is the clearance that paths keep"""


@pytree
class Friction:
    """What the object slides on."""

    com: Array
    """[2] m"""
    rho: Array
    """[] m, M_c / F_c"""
    capacity: Array
    """[N_r] largest push in multiples of F_c"""


@pytree
class PathStage:
    """What changes along the path."""

    guess: Array
    """[N, 3] rough path"""
    turning: Array
    """[N] m, length of a radian here"""
    time: Array
    """[N] s, when the team gets here"""


@pytree
class Near:
    """What is nearest to each of D discs, for small changes of their places."""

    distance: Array
    """[D] m, to the nearest obstacle"""
    normal: Array
    """[D, 2] away from it"""
    center: Array
    """[D, 2] m, where the disc was"""


@pytree
class PathProblem:
    """Implements `solver.ocp.Problem`.

    States [3 + N_r] are poses and contact offsets, inputs [2 N_r] pushes, in m of motion, and changes of offsets, in m.
    """

    stages: PathStage
    goal: Array
    """[3], with the heading nearest to the rough path's end"""
    tolerance: Array
    """[3]"""
    step: Array
    """[] m, mean length of a step"""
    friction: Friction
    shapes: Shapes
    obstacles: ObstacleEstimate
    config: PlannerConfig

    def stage(self, x: Array, u: Array, data: PathStage) -> Stage:
        """One step of quasi-static motion."""
        alone = self.nearest(x[None], jax.tree.map(lambda leaf: leaf[None], data))
        return self.stage_near(x, u, data, jax.tree.map(lambda leaf: leaf[0], alone))

    def stage_near(self, x: Array, u: Array, data: PathStage, near: Near) -> Stage:
        """One step of quasi-static motion near known features of obstacles."""
        pose, offset, (push, slide) = x[:3], x[3:], jnp.split(u, 2)
        team = self.shapes.team
        move, norm = motion(push, offset, self.friction, team)
        reached = pose + jnp.concatenate([rotate(pose[2] + 0.5 * move[2], move[:2]), move[2:]])
        per_step = jnp.sqrt(2.0 / self.step)
        way = jnp.concatenate([move[:2], data.turning * move[2:]])
        length = safe_norm(jnp.concatenate([move[:2], self.config.reference.turn_radius * move[2:]]))
        limit = usable_offsets(team)
        residual = jnp.concatenate(
            [
                per_step * way,
                jnp.sqrt(_EVENLY) * per_step * (length - self.step)[None],
                jnp.sqrt(_EFFORT) * per_step * push,
                _SLIDE * per_step * slide,
                jnp.sqrt(_IDLE * self.step) * offset,
                jnp.sqrt(_GUESS * self.step) * (pose - data.guess),
            ]
        )
        # Relative to the sliding motion, of which a turn on the spot has little: a little pull is a pull.
        pushes = push / jnp.sqrt(jnp.sum(norm**2) + (_STANDS * self.step) ** 2)
        between = team.pair_bounds - self.config.constraints.margin - team.pair_rows @ offset
        inequality = [pushes, self.friction.capacity - pushes, limit + offset, limit - offset, between]
        return Stage(
            jnp.concatenate([reached, offset + slide]),
            residual,
            jnp.concatenate([*inequality, self.room(pose, offset, near)]),
        )

    def centers(self, pose: Array, offset: Array) -> Array:
        """[D, 2] m, of all discs: the object's and the robots'."""
        robots = self.shapes.robot_centers(offset).reshape(-1, 2)
        return pose[:2] + rotate(pose[2], jnp.concatenate([self.shapes.object_centers, robots]))

    def room(self, pose: Array, offset: Array, near: Near) -> Array:
        """[D] m, distances of all discs to their nearest obstacles, beyond radius and margin."""
        radii = jnp.concatenate([self.shapes.object_radii, jnp.repeat(self.shapes.robot_radii, ROBOT_DISCS)])
        along = jnp.sum(near.normal * (self.centers(pose, offset) - near.center), axis=1)
        return near.distance + along - radii - self.config.constraints.margin

    def rooms(self, xs: Array) -> Array:
        """[N, D] m, room at states [N, nx] of all stages."""
        near = self.nearest(xs, self.stages)
        return jax.vmap(lambda x, n: self.room(x[:3], x[3:], n))(xs, near)

    def nearest(self, xs: Array, stages: PathStage) -> Near:
        """Leaves [n, D, ...]: what is nearest to each disc at states [n, nx] of so many stages; held fixed."""
        shapes, obstacles = self.shapes, self.obstacles
        held = jax.lax.stop_gradient(jax.vmap(lambda x: self.centers(x[:3], x[3:]))(xs))
        # Stages last, so that every operation on a component is one long loop.
        point = Vector(*jnp.moveaxis(held, (2, 1), (0, 1)))
        places = obstacles.position[..., None] + obstacles.velocity[..., None] * stages.time
        berth = jnp.where(shapes.obstacle_dynamic[:, None], self.config.reference.caution * stages.time, 0.0)
        corners = vectors(jnp.swapaxes(shapes.obstacle_vertices, 0, 1))
        shape = jax.tree.map(lambda leaf: leaf[:, :, None, None], outline(corners))
        away, outwards = _from_obstacles(point[None] - Vector(places[:, None, 0], places[:, None, 1]), shape)
        away = away - (shapes.obstacle_radius[:, None] + berth)[:, None]
        away = jnp.where(shapes.obstacle_mask[:, None, None], away, 1e3)
        distance, normal = away[0], outwards[0]
        for o in range(1, away.shape[0]):
            normal, distance = choose(away[o] < distance, outwards[o], normal), jnp.minimum(away[o], distance)
        facing = jnp.stack([normal.x, normal.y], axis=-1)
        return jax.lax.stop_gradient(Near(distance.T, jnp.swapaxes(facing, 0, 1), held))

    def values(self, plan: Plan) -> tuple[Array, Array]:
        """Cost [N] and next state [N, nx] of every stage."""
        return self._each(stage_cost, plan)

    def models(self, plan: Plan) -> StageModel:
        """Gauss-Newton models of all stages, leaves [N, ...]."""
        return self._each(forward_model, plan)

    def _each(self, function: Callable[..., T], plan: Plan) -> T:
        """A function of problem, state, input and stage at all stages; the nearest features are found once."""
        xs = plan.xs[:-1]
        near = self.nearest(xs, self.stages)
        return jax.vmap(lambda x, u, data, near: function(_Located(self, near), x, u, data))(
            xs, plan.us, self.stages, near
        )

    def penalty(self, h: Array, data: PathStage) -> Penalty:
        """Relaxed barriers, per metre of path."""
        team, protection = self.shapes.team, self.config.protection
        n, pairs = team.offset.shape[0], team.pair_bounds.shape[0]
        objects, near = self.shapes.object_radii.shape[0], (_SWITCH_NEAR, self.config.reference.clearance)
        groups = [
            (2 * n, _CONE, _SWITCH, _REACH),
            (2 * n + pairs, _CONE, _SWITCH_OFFSET, _REACH_OFFSET),
            (objects, _NEAR * protection.object, *near),
            (n * ROBOT_DISCS, _NEAR * protection.robots, *near),
        ]
        weight, switch, reach = (
            jnp.concatenate([jnp.full(group[0], group[i], h.dtype) for group in groups]) for i in (1, 2, 3)
        )
        return relaxed_barrier(h, self.step * weight, switch, reach)

    def model(self, x: Array, u: Array, data: PathStage) -> StageModel:
        """Gauss-Newton model of one stage."""
        return forward_model(self, x, u, data)

    def terminal(self, x: Array) -> Array:
        """Miss of the goal beyond what costs nothing."""
        off = (x[:3] - self.goal) / self.tolerance
        distance = jnp.stack([safe_norm(off[:2]), jnp.abs(off[2])])
        beyond = jnp.maximum(distance - FREE, 0.0) / ((1.0 - FREE) * jnp.maximum(distance, FREE))
        inside = _INSIDE * off
        return jnp.sqrt(2.0 * MISS) * jnp.concatenate([off * beyond[jnp.array([0, 0, 1])], inside])


@pytree
class _Located:
    """One stage of a problem, whose nearest obstacles are known."""

    problem: PathProblem
    near: Near

    def stage(self, x: Array, u: Array, data: PathStage) -> Stage:
        return self.problem.stage_near(x, u, data, self.near)

    def penalty(self, h: Array, data: PathStage) -> Penalty:
        return self.problem.penalty(h, data)


@apart
def _from_obstacles(point: Vector, shape: Outline) -> tuple[Array, Vector]:
    """Signed distances [...] of points from polygons, and their gradients."""
    return feature_distance(point, nearest_feature(point, shape))[:2]


def friction_of(shapes: Shapes, body: Body) -> Friction:
    """The object as estimated."""
    ratio = body.friction_moment / jnp.maximum(body.friction_force, 1e-3)
    rho = jnp.maximum(ratio, 0.5 * shapes.torsion_radius)
    return Friction(body.com, rho, CAPACITY * shapes.team.force_max / jnp.maximum(body.friction_force, 1.0))


def motion(push: Array, offset: Array, friction: Friction, team: Team) -> tuple[Array, Array]:
    """What pushes [N_r] at contact offsets [N_r] do.

    Returns:
      Motion [3] of the body point in body axes, and [3] in the norm of the limit surface: the sliding motion's.
    """
    lever = cross(team.contact_points(offset) - friction.com, team.normal) / friction.rho
    force, moment = jnp.sum(push[:, None] * team.normal, axis=0), jnp.sum(push * lever)
    turn = moment / friction.rho
    return jnp.append(force - turn * perpendicular(friction.com), turn), jnp.append(force, moment)
