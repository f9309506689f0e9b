"""Foot forces over a horizon of one gait cycle: the single rigid body tracks a reference while it is pushed back.

Forces are solved in axes turned with the robot's heading (see `srbd`) and handed out in the world's.
"""

from __future__ import annotations

import jax.numpy as jnp
from jax import Array

from jaxlocomanip.locomotion import srbd
from jaxlocomanip.locomotion.algebra import inverse, yaw_matrix, yaw_of
from jaxlocomanip.locomotion.qp import ForceProblem
from jaxlocomanip.locomotion.robot import BodyState, LeggedRobot, Motion
from jaxlocomanip.locomotion.srbd import GRAVITY, PushedBody, PushedState
from jaxlocomanip.numerics import Floats, pytree, static, wrap_angle


@pytree
class ForceSettings:
    """Numbers of the force MPC."""

    steps: int = static(10)
    """N, intervals of the horizon"""
    iterations: int = static(20)
    """of the QP solver"""
    dt: Floats = 0.05
    """s, length of an interval"""
    angle: Array | tuple[Floats, ...] = (8.0, 5.0, 10.0)
    """weights on roll, pitch, yaw, 1/rad^2; these and `position` must be positive"""
    position: Array | tuple[Floats, ...] = (1.5, 1.5, 15.0)
    """1/m^2"""
    angular_velocity: Array | tuple[Floats, ...] = (0.0, 0.0, 0.3)
    velocity: Array | tuple[Floats, ...] = (0.4, 0.4, 0.4)
    force: Floats = 1e-6
    """1/N^2, on forces about an even share of weight and push"""
    penalty: Floats = 5.0
    """of the QP solver, over `force`"""
    friction: Floats = 0.5
    """assumed between feet and floor"""
    force_max: Floats = 250.0
    """N, largest normal force of a foot"""


@pytree
class Reference:
    """What the body shall do, in the world."""

    position: Array
    """[3] m, trunk's origin now"""
    velocity: Array
    """[2] m/s"""
    heading: Array
    """[] rad, now"""
    yaw_rate: Array
    """[] rad/s"""


def in_world(force: Array, body: BodyState) -> Array:
    """Forces [..., 3] of a problem's solution along the world's axes."""
    return force @ yaw_matrix(yaw_of(body.rotation)).T


def assemble(
    robot: LeggedRobot,
    settings: ForceSettings,
    body: BodyState,
    reference: Reference,
    motion: Motion,
    contact: Array,
    feet: Array,
) -> ForceProblem:
    """The problem of one horizon; its forces are those of the floor on the feet along the axes of `srbd`.

    Args:
      robot: parameters.
      settings: numbers.
      body: measured state.
      reference: what to track; velocities continue over the horizon.
      motion: for the push, its horizontal force and its point.
      contact: [N, 4] bool.
      feet: [N, 4, 3] m, where they stand in each interval, in the world.
    """
    turn = yaw_matrix(yaw_of(body.rotation))
    steps, dt = settings.steps, settings.dt
    com = body.rotation @ robot.com
    middle = dt * (jnp.arange(steps, dtype=feet.dtype)[:, None] + 0.5)
    flat = jnp.concatenate([reference.velocity, jnp.zeros(1, feet.dtype)])
    arms = feet - (body.position + com + middle * flat)[:, None, :]
    inertia = turn.T @ body.rotation @ robot.inertia @ body.rotation.T @ turn
    pushed = PushedBody(robot.mass, inertia, arms @ turn, (motion.point - body.position - com) @ turn)
    state = _state(body, motion, com, turn)
    place, rate = _targets(settings, robot, body, reference, com, turn)

    free = jnp.broadcast_to(srbd.drift(pushed, state), (steps, 6))
    free_place, free_rate = srbd.predict(state, free, dt)
    wanted, compliance = _track(settings, place - free_place, rate - free_rate)
    stands = contact.astype(feet.dtype)
    response = srbd.responses(pushed) * jnp.repeat(stands, 3, axis=-1)[:, None, :]
    return ForceProblem(
        response=response,
        wanted=wanted,
        compliance=compliance,
        reference=_share(robot, motion.force @ turn, stands),
        force_weight=jnp.asarray(settings.force, feet.dtype),
        friction=jnp.asarray(settings.friction, feet.dtype),
        low=jnp.zeros_like(stands),
        high=settings.force_max * stands,
    )


def _state(body: BodyState, motion: Motion, com: Array, turn: Array) -> PushedState:
    """The augmented state, relative to the present pose."""
    up = body.rotation[:, 2]
    tilt = jnp.stack([-up[1], up[0], jnp.zeros_like(up[0])])
    velocity = body.velocity + jnp.cross(body.angular_velocity, com)
    return PushedState(
        angle=tilt @ turn,
        position=jnp.zeros_like(velocity),
        angular_velocity=body.angular_velocity @ turn,
        velocity=velocity @ turn,
        gravity=jnp.asarray(-GRAVITY, velocity.dtype),
        push=(motion.force @ turn)[:2],
    )


def _targets(
    settings: ForceSettings, robot: LeggedRobot, body: BodyState, reference: Reference, com: Array, turn: Array
) -> tuple[Array, Array]:
    """[N, 6] angle and position, and [N, 6] their rates, to be tracked."""
    level = yaw_matrix(reference.heading) @ robot.com
    offset = (reference.position + level - body.position - com) @ turn
    zero = jnp.zeros_like(offset[:2])
    error = wrap_angle(reference.heading - yaw_of(body.rotation))
    velocity = jnp.concatenate([reference.velocity, zero[:1]]) @ turn
    rate = jnp.concatenate([zero, reference.yaw_rate[None], velocity])
    ends = settings.dt * (jnp.arange(settings.steps, dtype=offset.dtype)[:, None] + 1.0)
    now = jnp.concatenate([zero, error[None], offset])
    return now + ends * rate, jnp.broadcast_to(rate, (settings.steps, 6))


def _track(settings: ForceSettings, place: Array, rate: Array) -> tuple[Array, Array]:
    """Accelerations [N, 6] that track errors [N, 6] best, and the inverse [6, N, N] of their Hessian."""
    displacement, speed = srbd.hold(settings.steps, settings.dt)
    on_place = jnp.concatenate([jnp.asarray(settings.angle), jnp.asarray(settings.position)])
    on_rate = jnp.concatenate([jnp.asarray(settings.angular_velocity), jnp.asarray(settings.velocity)])
    hessian = on_place[:, None, None] * (displacement.T @ displacement) + on_rate[:, None, None] * (speed.T @ speed)
    gradient = on_place * (displacement.T @ place) + on_rate * (speed.T @ rate)
    compliance = inverse(hessian)
    return jnp.einsum("ikl,li->ki", compliance, gradient), compliance


def _share(robot: LeggedRobot, push: Array, stands: Array) -> Array:
    """[N, 4, 3] N, weight and push shared evenly by the feet that stand."""
    total = jnp.stack([-push[0], -push[1], robot.mass * GRAVITY])
    share = stands / jnp.maximum(jnp.sum(stands, axis=-1, keepdims=True), 1.0)
    return share[..., None] * total
