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
from jaxlocomanip.planar.geometry import cross, feature_distance, nearest_feature, outline, perpendicular, rotate
from jaxlocomanip.planar.vector import Vector
from jaxlocomanip.planner.authority import CAPACITY, usable_offsets
from jaxlocomanip.planner.config import PlannerConfig
from jaxlocomanip.planner.estimation import ObstacleEstimate
from jaxlocomanip.planner.penalty import relaxed_barrier
from jaxlocomanip.planner.pose_grid import FREE, MISS
from jaxlocomanip.planner.shapes import ROBOT_DISCS, Shapes
from jaxlocomanip.scenario import Team
from jaxlocomanip.solver.ocp import Penalty, Stage, StageModel, forward_model

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
            jnp.concatenate([*inequality, self.room(pose, offset, data.time)]),
        )

    def room(self, pose: Array, offset: Array, time: Array) -> Array:
        """[n] m, distances of all discs to their nearest obstacles, beyond radius and margin."""
        shapes = self.shapes
        robots = shapes.robot_centers(offset).reshape(-1, 2)
        centers = pose[:2] + rotate(pose[2], jnp.concatenate([shapes.object_centers, robots]))
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
        """Gauss-Newton model."""
        return forward_model(self, x, u, data)

    def terminal(self, x: Array) -> Array:
        """Miss of the goal beyond what costs nothing."""
        off = (x[:3] - self.goal) / self.tolerance
        distance = jnp.stack([safe_norm(off[:2]), jnp.abs(off[2])])
        beyond = jnp.maximum(distance - FREE, 0.0) / ((1.0 - FREE) * jnp.maximum(distance, FREE))
        inside = _INSIDE * off
        return jnp.sqrt(2.0 * MISS) * jnp.concatenate([off * beyond[jnp.array([0, 0, 1])], inside])


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
