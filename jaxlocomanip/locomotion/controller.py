"""One robot's control: from what is asked of it and its measured state to the low-level command of its joints.

`control` is called at the rate of the joint command, say every 5 ms; the force MPC is solved at those calls only where
`solve` is set, say every 25 ms. All functions work on one robot and are `vmap`ped over a team, with `solve` shared, so
that it stays a branch of the compiled program.
"""

from __future__ import annotations

import jax
import jax.numpy as jnp
from jax import Array

from jaxlocomanip.locomotion import force_mpc, gait, kinematics, qp
from jaxlocomanip.locomotion.algebra import yaw_of
from jaxlocomanip.locomotion.foothold import footholds, landing_height, nominal_footholds
from jaxlocomanip.locomotion.force_mpc import Reference
from jaxlocomanip.locomotion.gait import GaitState
from jaxlocomanip.locomotion.qp import ForceProblem
from jaxlocomanip.locomotion.robot import BodyState, JointCommand, LeggedRobot, Motion
from jaxlocomanip.locomotion.settings import LocomotionSettings
from jaxlocomanip.locomotion.srbd import GRAVITY
from jaxlocomanip.locomotion.swing import swing
from jaxlocomanip.numerics import pytree, wrap_angle


@pytree
class ControllerState:
    """What one robot's controller remembers."""

    gait: GaitState
    time: Array
    """[] s, of the last call; infinite before the first"""
    lift_off: Array
    """[4, 3] m, where each foot last left the ground, in the world"""
    reference: Array
    """[2] m, integrated reference of the trunk's origin"""
    planned: Array
    """[2, 4, 3] N, forces on the feet in the first two intervals of the last plan, world axes"""
    stood: Array
    """[4] bool, stance legs when that plan was made"""
    force: Array
    """[4, 3] N, forces on the feet asked of the legs now, world axes; kept for recordings"""


def start(robot: LeggedRobot, settings: LocomotionSettings, body: BodyState) -> ControllerState:
    """State of a robot that stands on four feet, each carrying a quarter of its weight."""
    up = jnp.asarray([0.0, 0.0, 1.0], body.position.dtype)
    share = jnp.broadcast_to(robot.mass * GRAVITY / 4.0 * up, (4, 3))
    return ControllerState(
        gait=gait.start(settings.gait),
        time=jnp.full_like(body.position[0], jnp.inf),
        lift_off=_feet_in_world(robot, body),
        reference=body.position[:2],
        planned=jnp.stack([share, share]),
        stood=jnp.ones(4, bool),
        force=share,
    )


def control(
    state: ControllerState,
    robot: LeggedRobot,
    settings: LocomotionSettings,
    body: BodyState,
    motion: Motion,
    time: Array,
    solve: Array,
) -> tuple[ControllerState, JointCommand]:
    """One call.

    Args:
      state: from the last call or from `start`.
      robot: parameters.
      settings: gains.
      body: measured state.
      motion: what is asked.
      time: [] s, of this call, not before the last one's.
      solve: [] bool, solve the force MPC at this call.

    Returns:
      The new state, and the command that is to be held until the next call.
    """
    tick = _tick(state, robot, settings, body, motion, time)

    def plan() -> tuple[Array, Array]:
        problem = _problem(tick, robot, settings, body, motion)
        forces = qp.solve(problem, settings.forces.penalty, settings.forces.iterations)
        return force_mpc.in_world(forces[:2], body), ~tick.paces.swinging

    planned, stood = jax.lax.cond(solve, plan, lambda: (state.planned, state.stood))
    # Once a leg has landed or lifted since the plan was made, the plan's first interval is over.
    same = jnp.all(stood == ~tick.paces.swinging)
    force = jnp.where(tick.paces.swinging[:, None], 0.0, jnp.where(same, planned[0], planned[1]))
    new = ControllerState(tick.paces, time, tick.lift_off, tick.reference.position[:2], planned, stood, force)
    return new, _command(tick, robot, settings, body, force)


def force_problem(
    state: ControllerState,
    robot: LeggedRobot,
    settings: LocomotionSettings,
    body: BodyState,
    motion: Motion,
    time: Array,
) -> ForceProblem:
    """The problem that `control` solves, given the same arguments, where `solve` is set."""
    return _problem(_tick(state, robot, settings, body, motion, time), robot, settings, body, motion)


@pytree
class _Tick:
    """What a call works out before it decides on forces."""

    paces: GaitState
    feet: Array
    """[4, 3] m, in the world"""
    lift_off: Array
    """[4, 3] m"""
    reference: Reference
    target: Array
    """[4, 3] m, footholds of the next touchdowns"""
    walking: Array
    """[] bool"""


def _tick(
    state: ControllerState,
    robot: LeggedRobot,
    settings: LocomotionSettings,
    body: BodyState,
    motion: Motion,
    time: Array,
) -> _Tick:
    pace = settings.gait
    paces = gait.update(state.gait, pace, time, motion.walking)
    feet = _feet_in_world(robot, body)
    lifted = paces.swinging & ~state.gait.swinging
    reference = _reference(state, robot, settings, body, motion, time)
    target = footholds(
        robot,
        settings.footholds,
        body,
        reference.velocity,
        reference.yaw_rate,
        gait.time_to_touchdown(paces, pace),
        pace.duty * pace.period,
    )
    lift_off = jnp.where(lifted[:, None], feet, state.lift_off)
    return _Tick(paces, feet, lift_off, reference, target, motion.walking)


def _feet_in_world(robot: LeggedRobot, body: BodyState) -> Array:
    """[4, 3] m."""
    return body.position + kinematics.feet(robot, body.joint) @ body.rotation.T


def _reference(
    state: ControllerState,
    robot: LeggedRobot,
    settings: LocomotionSettings,
    body: BodyState,
    motion: Motion,
    time: Array,
) -> Reference:
    """The reference now: the velocity integrated, but never far from the robot. Who does not walk shall stay."""
    walks = jnp.where(motion.walking, 1.0, 0.0)
    velocity = walks * motion.velocity
    passed = jnp.maximum(time - state.time, 0.0)
    off = state.reference + passed * velocity - body.position[:2]
    place = body.position[:2] + jnp.clip(off, -settings.reach, settings.reach)
    yaw = yaw_of(body.rotation)
    heading = yaw + jnp.clip(wrap_angle(motion.heading - yaw), -settings.turn, settings.turn)
    position = jnp.concatenate([place, robot.stand_height[None]])
    return Reference(position, velocity, heading, walks * motion.yaw_rate)


def _problem(
    tick: _Tick, robot: LeggedRobot, settings: LocomotionSettings, body: BodyState, motion: Motion
) -> ForceProblem:
    """Forces over the horizon, with the feet where they stand or will stand."""
    pace, forces, paces, reference = settings.gait, settings.forces, tick.paces, tick.reference
    ahead = gait.schedule(paces, pace, tick.walking, forces.dt, forces.steps)
    # A stance that begins with a leg's n-th touchdown from now has its middle half a stance later.
    middle = (ahead.cycle - paces.phase + 0.5 * pace.duty) * pace.period
    nominal = nominal_footholds(robot, body, reference.velocity, reference.yaw_rate, middle)
    height = jnp.full((*middle.shape, 1), landing_height(robot, settings.footholds), nominal.dtype)
    places = jnp.concatenate([nominal, height], axis=-1)
    now, landing = ahead.cycle < 0.5, paces.swinging & (ahead.cycle < 1.5)
    places = jnp.where(landing[..., None], tick.target, places)
    places = jnp.where(now[..., None], tick.feet, places)
    return force_mpc.assemble(robot, forces, body, reference, motion, ahead.contact, places)


def _command(
    tick: _Tick, robot: LeggedRobot, settings: LocomotionSettings, body: BodyState, force: Array
) -> JointCommand:
    """Impedance along the swing's path for swinging legs, forces for the others."""
    pace, gains, reference = settings.gait, settings.joints, tick.reference
    progress, duration = gait.swing_progress(tick.paces, pace), (1.0 - pace.duty) * pace.period
    place, speed, hurry = swing(tick.lift_off, tick.target, progress, settings.swing_height, duration)
    angle = kinematics.joint_angles(robot, (place - body.position) @ body.rotation)

    # Feet move against the body: swinging ones along their path, the others stay while the body moves as asked.
    swings = tick.paces.swinging[:, None]
    arm = tick.feet - body.position
    up = jnp.asarray([0.0, 0.0, 1.0], arm.dtype)
    flat = jnp.concatenate([reference.velocity, jnp.zeros(1, arm.dtype)])
    moving = speed - body.velocity - jnp.cross(body.angular_velocity, arm)
    staying = -flat - jnp.cross(reference.yaw_rate * up, arm)
    jacobian = kinematics.jacobians(robot, body.joint)
    rate = kinematics.joint_rates(jacobian, jnp.where(swings, moving, staying) @ body.rotation)
    # What is known of the legs is fed forward: their weight, the joints' damping and, in swing, their inertia.
    weight = kinematics.gravity_torques(robot, body.joint, -GRAVITY * body.rotation[2])
    acceleration = kinematics.joint_accelerations(robot, body.joint, rate, hurry @ body.rotation)
    driving = jnp.einsum("lij,lj->li", robot.leg_inertia, acceleration)
    bearing = -jnp.einsum("lji,lj->li", jacobian, force @ body.rotation)
    torque = weight + robot.joint_damping * rate + jnp.where(swings, driving, bearing)
    return JointCommand(
        position=jnp.where(swings, angle, body.joint),
        rate=rate,
        kp=jnp.where(swings, gains.swing_kp, jnp.zeros_like(angle)),
        kd=jnp.where(swings, gains.swing_kd, gains.stance_kd * jnp.ones_like(angle)),
        torque=torque,
    )
