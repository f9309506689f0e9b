"""From the planner's command to each robot's reference: reach the face, keep contact, square to it, slide, push.

The planner's force is a feed-forward of the robot's own force MPC; what the contact really bears is up to the physics.
A robot walks with its face: along the normal with the object's own velocity, a share of what the plan wants beyond
it, and whatever closes a gap; along the tangent with the face and the commanded offset rate. The team starts to push
once all of it has touched; until then each robot leans on its face.
"""

from __future__ import annotations

import jax.numpy as jnp
from jax import Array

from jaxlocomanip.locomotion.robot import BodyState, LeggedRobot, Motion
from jaxlocomanip.numerics import Floats, pytree, safe_norm
from jaxlocomanip.planar.geometry import perpendicular, rotate
from jaxlocomanip.scenario import Team
from jaxlocomanip.worlds.interface import Push

CALM = 0.05
"""m/s and rad/s, below which the object is at rest"""
SLOWEST = 0.05
"""m/s, approach at the end of the way to the face"""


@pytree
class ContactSettings:
    """Gains of the contact command."""

    gap_gain: Floats = 2.0
    """1/s, approach speed by gap"""
    approach_max: Floats = 0.3
    """m/s"""
    near: Floats = 0.05
    """m, gap under which a robot counts as at its face, once it has touched"""
    back_off: Floats = 0.02
    """m, gap kept once the object has arrived, so that nobody leans on it"""
    settle: Floats = 0.5
    """s, for which everything must be in place before the robots stop walking"""
    hold: Floats = 5.0
    """N, push while waiting for the others"""
    ramp: Floats = 0.5
    """s, over which the push rises once everybody has touched"""
    plan_share: Floats = 1.0
    """share of the planned velocity beyond the object's own that is followed"""
    plan_max: Floats = 0.2
    """m/s, most of it"""
    slide_max: Floats = 0.25
    """m/s, fastest offset rate that is followed: a faster one is still on its way when it is asked to turn back"""
    offset_gain: Floats = 3.0
    """1/s, on the error of the contact offset"""
    offset_max: Floats = 0.2
    """m/s"""
    offset_lead: Floats = 0.03
    """m, how far the integrated contact offset may be ahead of the measured one"""


@pytree
class ContactState:
    """What the contact command remembers."""

    touched: Array
    """[N_r] bool: has touched its face at least once"""
    ramp: Array
    """[] 0: waiting for contact, 1: pushing in full"""
    offset: Array
    """[N_r] m, where each robot holds its contact: the commanded rates integrated, within reach of the measured offset.

    This is what the robots report to the planner. The measured offset sways with every stride and lags the command by
    a stride; a planner that closes its loop over that drives both robots from side to side.
    """
    settled: Array
    """[] s, since when the object is at rest where it shall be and the robots stand in order"""


@pytree
class FaceView:
    """Where the robots are with regard to their faces."""

    gap: Array
    """[N_r] m, from the pusher to the face"""
    offset: Array
    """[N_r] m, contact offset"""
    point: Array
    """[N_r, 3] m, where each robot touches or would touch, in the world"""
    normal: Array
    """[N_r, 2] push direction in the world"""


def start(team: Team, faces: FaceView) -> ContactState:
    """Before anybody has touched."""
    none = jnp.zeros(team.offset.shape, bool)
    zero = jnp.zeros((), team.offset.dtype)
    return ContactState(none, zero, faces.offset, zero)


def look(pose: Array, bodies: BodyState, robots: LeggedRobot, team: Team) -> FaceView:
    """Geometry of the contacts, from the object's pose [3] and the robots' states [N_r, ...]."""
    pusher = bodies.position + jnp.einsum("rij,rj->ri", bodies.rotation, robots.pusher)
    pusher_B = rotate(-pose[2], pusher[:, :2] - pose[:2])
    normal = rotate(pose[2], team.normal)
    gap = jnp.sum((team.origin - pusher_B) * team.normal, axis=-1) - robots.pusher_radius
    offset = jnp.sum((pusher_B - team.origin) * team.tangent, axis=-1)
    # The pusher's foremost point; while it is pressed in, still the point on the pusher.
    ahead = (robots.pusher_radius + jnp.minimum(gap, 0.0))[:, None] * normal
    return FaceView(gap, offset, jnp.concatenate([pusher[:, :2] + ahead, pusher[:, 2:]], axis=1), normal)


def at_face(state: ContactState, faces: FaceView, settings: ContactSettings) -> Array:
    """[N_r] bool, robots whose push can be relied on: the team is engaged, and the robot close to its face."""
    return (state.ramp > 0.0) & (faces.gap < settings.near)


def command(
    state: ContactState,
    pose: Array,
    twist: Array,
    touching: Array,
    faces: FaceView,
    team: Team,
    push: Push,
    settings: ContactSettings,
    period: Floats,
) -> tuple[ContactState, Motion]:
    """The references of all robots for one period, s.

    Args:
      state: of the last period.
      pose: [3] object.
      twist: [3] object, of its body point, world axes.
      touching: [N_r] bool.
      faces: result of `look`.
      team: the robots' places.
      push: the planner's command.
      settings: gains.
      period: s, since the last call.

    Returns:
      The new state, and [N_r, ...] references.
    """
    touched = state.touched | touching
    engaged = jnp.all(touched)
    ramp = jnp.where(engaged, jnp.minimum(state.ramp + period / settings.ramp, 1.0), 0.0)
    leaning = jnp.where(touched, settings.hold, 0.0)
    force = jnp.where(engaged, ramp * jnp.clip(push.force, 0.0, team.force_max), leaning)
    force = jnp.where(faces.gap < settings.near, force, 0.0)

    tangent = perpendicular(faces.normal)
    arm = faces.point[:, :2] - pose[:2]
    own, planned = _at(twist, arm), _at(push.twist, arm)
    wish = settings.plan_share * ramp * jnp.sum((planned - own) * faces.normal, axis=-1)
    wish = jnp.where(push.resting, 0.0, jnp.clip(wish, -settings.plan_max, settings.plan_max))
    ahead = jnp.sum(own * faces.normal, axis=-1) + wish + _closing(faces.gap, touched, engaged & push.resting, settings)

    rate = jnp.where(engaged, jnp.clip(push.offset_rate, -settings.slide_max, settings.slide_max), 0.0)
    lead = jnp.clip(state.offset + period * rate - faces.offset, -settings.offset_lead, settings.offset_lead)
    servo = jnp.clip(settings.offset_gain * lead, -settings.offset_max, settings.offset_max)
    aside = jnp.sum(own * tangent, axis=-1) + rate + servo

    calm = push.resting & engaged & (safe_norm(twist[:2]) < CALM) & (jnp.abs(twist[2]) < CALM)
    calm = calm & jnp.all(jnp.abs(faces.gap - settings.back_off) < 0.5 * settings.back_off)
    # Once they stand, only what wakes the planner makes them walk again.
    standing = push.resting & (state.settled >= settings.settle)
    settled = jnp.where(calm | standing, state.settled + period, 0.0)
    flat = -force[:, None] * faces.normal
    motion = Motion(
        velocity=ahead[:, None] * faces.normal + aside[:, None] * tangent,
        heading=jnp.arctan2(faces.normal[:, 1], faces.normal[:, 0]),
        yaw_rate=jnp.full_like(force, twist[2]),
        force=jnp.concatenate([flat, jnp.zeros_like(flat[:, :1])], axis=1),
        point=faces.point,
        walking=jnp.full(force.shape, settled < settings.settle),
    )
    return ContactState(touched, ramp, faces.offset + lead, settled), motion


def _closing(gap: Array, touched: Array, arrived: Array, settings: ContactSettings) -> Array:
    """[N_r] m/s, what brings each robot to its face, and away from it once the object has arrived."""
    reaching = jnp.clip(settings.gap_gain * gap, 0.0, settings.approach_max)
    reaching = jnp.where(touched, reaching, jnp.maximum(reaching, SLOWEST))
    leaving = jnp.clip(settings.gap_gain * (gap - settings.back_off), -settings.approach_max, settings.approach_max)
    return jnp.where(arrived, leaving, reaching)


def _at(twist: Array, arm: Array) -> Array:
    """[N_r, 2] m/s, velocity of the object's points at arms [N_r, 2] from p."""
    return twist[:2] + twist[2] * perpendicular(arm)
