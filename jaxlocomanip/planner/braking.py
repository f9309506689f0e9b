"""The way to rest once nobody pushes, and the room that it leaves: many inputs side by side.

Arrays are laid out as in `room`: components first, inputs last.
"""

from __future__ import annotations

import dataclasses

import jax
import jax.numpy as jnp
from jax import Array

from jaxlocomanip.numerics import pytree, safe_norm
from jaxlocomanip.planar import dynamics
from jaxlocomanip.planar.dynamics import Body, State
from jaxlocomanip.planar.vector import Vector, unit, vector
from jaxlocomanip.planner.config import PlannerConfig
from jaxlocomanip.planner.estimation import ObjectEstimate
from jaxlocomanip.planner.room import bodies_of, contacts, rooms_at
from jaxlocomanip.planner.shapes import Shapes
from jaxlocomanip.planner.situation import Situation
from jaxlocomanip.scenario import Team
from jaxlocomanip.solver.layout import added

SAMPLES = 6
"""steps of the braking motion, each checked at its end"""
WAITS = 3
"""instants after the stop at which moving obstacles are looked at"""
STIRRING = 0.02, 0.04
"""m/s, mean speed from which on an object may, and does, move"""
LIGHTER = 1.3
"""an object may be so many times lighter than estimated: a push then moves it further"""


@pytree
class Brake:
    """What braking is reckoned with."""

    body: Body
    """friction is what is left of it in the worst case"""
    torsion_radius: Array
    """[] m, M_c / F_c of the footprint"""
    tick: Array
    """[] s, for which an input acts"""
    lag: Array
    """[] s, for which it goes on acting"""
    look_ahead: Array
    """[] s, over which obstacles that move are looked at after the stop"""


def brake_of(body: Body, proven: Array, shapes: Shapes, config: PlannerConfig) -> Brake:
    """A pessimist's reckoning: braking may take longer than expected (a smoother floor).

    Args:
      body: the object as estimated.
      proven: [] N, friction that the floor has shown to have.
      shapes: geometry.
      config: settings.
    """
    resisting = jnp.minimum(proven, body.friction_force)
    smooth = Body(body.mass, body.inertia, body.com, resisting, resisting * shapes.torsion_radius)
    times = config.horizon.tick, config.safety.lag, config.safety.look_ahead
    return Brake(smooth, shapes.torsion_radius, *(jnp.asarray(time, resisting.dtype) for time in times))


@pytree
class BrakeRooms:
    """Least room beyond the margin that inputs [C] leave on the way to rest and of a wait there, m."""

    standing: Array
    """to obstacles that stand"""
    team: Array
    """between robots"""
    moving: Array
    """to obstacles that move, until everything is at rest"""
    later: Array
    """to obstacles that move, while the team waits at rest"""

    @property
    def safe(self) -> Array:
        """[C] bool: room on the way and at rest."""
        return jnp.minimum(self.on_the_way, self.later) >= 0.0

    @property
    def to_obstacles(self) -> Array:
        """[C] m."""
        return jnp.minimum(jnp.minimum(self.standing, self.moving), self.later)

    @property
    def on_the_way(self) -> Array:
        """[C] m, until everything is at rest."""
        return jnp.minimum(jnp.minimum(self.standing, self.team), self.moving)


def braking_rooms(
    forces: Array, rates: Array, lever: Array, situation: Situation, shapes: Shapes, config: PlannerConfig
) -> BrakeRooms:
    """The room on the way to rest after one tick of each input.

    Args:
      forces: [C, N_r] N.
      rates: [C, N_r] m/s, of the contact offsets.
      lever: [C] m, by which the pushes' resultant passes the centre of mass beside where it is expected to.
      situation: what is known.
      shapes: geometry.
      config: settings.
    """
    brake = brake_of(situation.body, situation.proven, shapes, config)
    motion = braking_motion(forces.T, rates.T, lever, believed(situation), situation.offset, brake, shapes.team)
    # Instants and inputs along one axis.
    poses, offsets, times = (v.reshape(*v.shape[:-2], -1) for v in motion)
    obstacles = situation.obstacles
    places = obstacles.position[..., None] + times * obstacles.velocity[..., None]
    rooms = rooms_at(poses, offsets, places, bodies_of(shapes, config), situation.kept[..., None])
    rooms = jax.tree.map(lambda room: room.reshape(motion[2].shape), rooms)
    # Until it is at rest the team answers for what it runs into: what moves may turn round in the meantime.
    swerve = 0.5 * config.safety.swerve * motion[2][:-WAITS] ** 2
    return BrakeRooms(
        standing=jnp.min(rooms.standing, axis=0),
        team=jnp.min(rooms.team, axis=0) - config.safety.margin,
        moving=jnp.min(rooms.moving[:-WAITS] - swerve, axis=0),
        later=jnp.min(rooms.moving[-WAITS:], axis=0),
    )


def believed(situation: Situation) -> ObjectEstimate:
    """The estimate without the velocity that is noise: as long as an object lies still, all of it is."""
    moves = jnp.clip((situation.stirring - STIRRING[0]) / (STIRRING[1] - STIRRING[0]), 0.0, 1.0)
    share = jnp.where(situation.waiting, moves, 1.0)
    return dataclasses.replace(situation.estimate, twist=share * situation.estimate.twist)


def braking_motion(
    forces: Array,
    rates: Array,
    lever: Array,
    estimate: ObjectEstimate,
    offset: Array,
    brake: Brake,
    team: Team,
) -> tuple[Array, Array, Array]:
    """Poses [3, n, C], contact offsets [N_r, n, C] and times [n, C] s to rest and of a wait there.

    Args:
      forces: [N_r, C] N.
      rates: [N_r, C] m/s.
      lever: [C] m, by which the pushes' resultant passes the centre of mass beside where it is expected to.
      estimate: the object's state.
      offset: [N_r] m.
      brake: what braking is reckoned with.
      team: the robots.
    """
    body, after = brake.body, brake.tick + brake.lag
    pose, twist, offset = (v[:, None] + jnp.zeros_like(forces[:1]) for v in (estimate.pose, estimate.twist, offset))
    # A push may move more than expected (a lighter object).
    light = Body(body.mass / LIGHTER, body.inertia / LIGHTER, body.com, body.friction_force, body.friction_moment)
    push, moment = _wrench(forces, offset, team)
    moment = moment + lever * safe_norm(jnp.stack([push.x, push.y]), axis=0)
    pushed = dynamics.advance(light, _state(pose, twist), push, moment, after, 0.0)
    first = offset + rates * brake.tick + after * slip(pose, twist, offset, rates, team)
    h = jnp.minimum(stopping_time(pushed, brake), 2.5) / SAMPLES
    none = jnp.zeros_like(h)

    def braking(carry: tuple[State, Array], _: None) -> tuple[tuple[State, Array], tuple[Array, Array]]:
        state, slid = carry
        q, velocity = _arrays(state)
        slid = slid + h * slip(q, velocity, slid, jnp.zeros_like(slid), team)
        state = dynamics.advance(body, state, Vector(none, none), none, h, 0.0)
        return (state, slid), (_arrays(state)[0], slid)

    _, (poses, offsets) = jax.lax.scan(braking, (pushed, first), None, length=SAMPLES)
    poses, offsets = (
        jnp.stack([start, *rest, *[rest[-1]] * WAITS], axis=1)
        for start, rest in ((_arrays(pushed)[0], poses), (first, offsets))
    )
    stops = [after + h * k for k in range(SAMPLES + 1)]
    waits = [stops[-1] + brake.look_ahead * ((k + 1) / WAITS) for k in range(WAITS)]
    return poses, offsets, jnp.stack(stops + waits)


def stopping_time(state: State, brake: Brake) -> Array:
    """[...] s, at most, until friction alone has stopped the object."""
    body = brake.body
    slowing = jnp.maximum(body.friction_force / body.mass, 0.3)
    turning = slowing * brake.torsion_radius * body.mass / body.inertia
    speed = safe_norm(jnp.stack([state.velocity.x, state.velocity.y]), axis=0)
    # Translation and rotation share one friction budget: braking both takes at most the sum of the times for either.
    return speed / slowing + jnp.abs(state.omega) / jnp.maximum(turning, 1e-3)


def slip(pose: Array, twist: Array, offset: Array, rate: Array, team: Team) -> Array:
    """[N_r, C] m/s, offset rates beyond the commanded [N_r, C], of an object at pose and twist [3, C].

    Faces that move aside faster than a robot walks slip away.
    """
    point, normal = contacts(offset, team)
    velocity = vector(twist).rotated(unit(-pose[2]))
    walk = rate + normal.turned.dot(velocity + point.turned * twist[2])
    fastest = team.slide_speed_max[:, None]
    return jnp.clip(walk, -fastest, fastest) - walk


def _wrench(forces: Array, offset: Array, team: Team) -> tuple[Vector, Array]:
    """Force and moment [C] of pushes [N_r, C] at contact offsets [N_r, C], in body axes."""
    point, normal = contacts(offset, team)
    pushes = normal * forces
    return Vector(added([*pushes.x]), added([*pushes.y])), added([*(point.cross(normal) * forces)])


def _state(pose: Array, twist: Array) -> State:
    return State(vector(pose), pose[2], vector(twist), twist[2])


def _arrays(state: State) -> tuple[Array, Array]:
    """Pose and twist [3]."""
    pose = jnp.stack([state.position.x, state.position.y, state.heading])
    return pose, jnp.stack([state.velocity.x, state.velocity.y, state.omega])
