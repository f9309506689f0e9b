"""The quasi-static motion of an object that a team pushes, as a small optimal control problem along a path.

States are poses and contact offsets, inputs pushes and changes of the offsets. On the ellipsoidal limit surface the
twist about the centre of mass is proportional to (f_x, f_y, tau / rho^2) with rho = M_c / F_c. So what comes out can be
pushed, forwards only, with no more than the robots can push, from where they stand: a sharp turn takes offsets to which
they have to walk first, and walking costs like way. With steps of even length their squares sum up to the path's
length, in which a radian counts `turn_radius`; relaxed barriers keep object and robots off obstacles and the robots out
of each other's way.
"""

from __future__ import annotations

import jax
import jax.numpy as jnp
from jax import Array

from jaxlocomanip.numerics import pytree, safe_norm
from jaxlocomanip.planar.dynamics import Body
from jaxlocomanip.planar.geometry import cross, perpendicular, point_distance, rotate
from jaxlocomanip.planar.vector import trailing
from jaxlocomanip.planner import path_model, path_room
from jaxlocomanip.planner.authority import CAPACITY, usable_offsets
from jaxlocomanip.planner.config import PlannerConfig
from jaxlocomanip.planner.estimation import ObstacleEstimate
from jaxlocomanip.planner.path_model import EVENLY, STANDS
from jaxlocomanip.planner.penalty import relaxed_barrier
from jaxlocomanip.planner.pose_grid import FREE, MISS
from jaxlocomanip.planner.shapes import ROBOT_DISCS, Shapes
from jaxlocomanip.scenario import Team
from jaxlocomanip.solver.layout import stages_inside
from jaxlocomanip.solver.ocp import Penalty, Plan, Stage, StageModel, forward_model

_EFFORT = 0.1
"""weight of squared pushes beside that of squared steps: the robots share, and keep off the ends of their ranges"""
_INSIDE = 0.1
"""share of a miss's price (`pose_grid`) that one within the tolerances has"""
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
        pose, offset, (push, slide) = x[:3], x[3:], jnp.split(u, 2)
        team = self.shapes.team
        move, norm = motion(push, offset, self.friction, team)
        reached = pose + jnp.concatenate([rotate(pose[2] + 0.5 * move[2], move[:2]), move[2:]])
        per_step = jnp.sqrt(2.0 / self.step)
        way = jnp.concatenate([move[:2], data.turning * move[2:]])
        length = safe_norm(jnp.concatenate([move[:2], self.config.reference.turn_radius * move[2:]]))
        limit = usable_offsets(team)
        separable = jnp.concatenate([pose - data.guess, offset, push, slide])
        uneven = jnp.sqrt(EVENLY) * per_step * (length - self.step)
        residual = jnp.concatenate([per_step * way, uneven[None], jnp.sqrt(self.weights()) * separable])
        # Relative to the sliding motion, of which a turn on the spot has little: a little pull is a pull.
        pushes = push / jnp.sqrt(jnp.sum(norm**2) + (STANDS * self.step) ** 2)
        between = team.pair_bounds - self.config.constraints.margin - team.pair_rows @ offset
        inequality = [pushes, self.friction.capacity - pushes, limit + offset, limit - offset, between]
        return Stage(
            jnp.concatenate([reached, offset + slide]),
            residual,
            jnp.concatenate([*inequality, self.room(pose, offset, data.time)]),
        )

    def weights(self) -> Array:
        """[nz] of the squares of deviation from the rough path, offsets, pushes and changes of offsets."""
        step = self.step
        each = jnp.stack([_GUESS * step, _IDLE * step, 2.0 * _EFFORT / step, 2.0 * _SLIDE**2 / step])
        n = self.shapes.team.offset.shape[0]
        return jnp.repeat(each, jnp.array([3, n, n, n]), total_repeat_length=3 + 3 * n)

    def room(self, pose: Array, offset: Array, time: Array) -> Array:
        """[D] m, distances of all discs to their nearest obstacles at a time [] s, beyond radius and margin."""
        shapes, obstacles = self.shapes, self.obstacles
        robots = shapes.robot_centers(offset).reshape(-1, 2)
        centers = pose[:2] + rotate(pose[2], jnp.concatenate([shapes.object_centers, robots]))
        radii = jnp.concatenate([shapes.object_radii, jnp.repeat(shapes.robot_radii, ROBOT_DISCS)])
        berth = jnp.where(shapes.obstacle_dynamic, self.config.reference.caution * time, 0.0)
        places = obstacles.position + obstacles.velocity * time

        def least(center: Array) -> Array:
            away = jax.vmap(point_distance)(center - places, shapes.obstacle_vertices, shapes.obstacle_radius + berth)
            return jnp.min(jnp.where(shapes.obstacle_mask, away, 1e3))

        return jax.vmap(least)(centers) - radii - self.config.constraints.margin

    def rooms(self, xs: Array) -> Array:
        """[N, D] m, room at states [N, nx] of all stages."""
        return path_room.rooms(self, stages_inside(xs)).T

    def values(self, plan: Plan) -> tuple[Array, Array]:
        """Cost [N] and next state [N, nx] of every stage."""
        cost, following = path_model.values(self, *_stages_last(plan))
        return cost, following.T

    def models(self, plan: Plan) -> StageModel:
        """Gauss-Newton models of all stages, leaves [N, ...]; equal to `model` of each."""
        return path_model.models(self, *_stages_last(plan))

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
            trailing(jnp.concatenate([jnp.full(group[0], group[i], h.dtype) for group in groups]), h) for i in (1, 2, 3)
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


def _stages_last(plan: Plan) -> tuple[Array, Array]:
    """States [nx, N] and inputs [nu, N]."""
    return stages_inside(plan.xs[:-1]), stages_inside(plan.us)


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
