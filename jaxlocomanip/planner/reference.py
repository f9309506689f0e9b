"""Progress along the path and the reference trajectory over the horizon (paper, "Reference trajectory").

The reference advances in time from the command, not from where the object happens to be: it leads the object's
projection on the path by a bounded distance. A reference re-anchored at the object lets the plan push "later" for
ever against stiction.
"""

from __future__ import annotations

import dataclasses

import jax.numpy as jnp
from jax import Array

from jaxlocomanip.numerics import Floats, pytree, safe_norm, wrap_angle
from jaxlocomanip.planner.config import Reference
from jaxlocomanip.planner.path import Path


@pytree
class Progress:
    """Where the object and the reference are on the path."""

    projected: Array
    """[] m, arc length of the object's projection"""
    reference: Array
    """[] m, arc length of the reference"""
    resting: Array
    """[] bool, arrived: the team rests until the object leaves the tolerance"""
    held: Array
    """[] bool, waits for an obstacle to pass"""
    stalled: Array
    """[] int, searches in a row between which the team hardly got on"""


@pytree
class Targets:
    """Reference over the horizon."""

    pose: Array
    """[N + 1, 3]"""
    twist: Array
    """[N + 1, 3]"""
    force: Array
    """[N + 1, N_r] steady pushes in multiples of F_c, fading as the reference comes to rest"""
    offset: Array
    """[N + 1, N_r] m, contact offsets of those pushes"""


def start() -> Progress:
    """Progress at the beginning of a path."""
    return Progress(jnp.zeros(()), jnp.zeros(()), jnp.zeros((), bool), jnp.zeros((), bool), jnp.zeros((), jnp.int32))


def stalls(progress: Progress, settings: Reference) -> Array:
    """[] int, searches in a row, up to now, between which the team hardly got on."""
    slow = ~progress.resting & ~progress.held & (progress.projected < STALLED * settings.speed * settings.replan)
    return jnp.where(slow, progress.stalled + 1, 0)


def restart(progress: Progress, path: Path, settings: Reference) -> Progress:
    """Progress on a new path that begins at the object; the lead is kept."""
    lead = jnp.clip(progress.reference - progress.projected, 0.0, path.length)
    stalled = stalls(progress, settings) % PATIENCE
    return dataclasses.replace(progress, projected=jnp.zeros_like(lead), reference=lead, stalled=stalled)


def apart(progress: Progress) -> Progress:
    """Progress while nobody is at the object.

    The reference waits for the robots: a lead built up while nobody can push would be caught up with in a jerk. Nor is
    a team stuck that does not push: one that had to walk up to its faces first, or around the object, was taken for
    stuck when it got there, and walked on.
    """
    return dataclasses.replace(progress, stalled=jnp.zeros_like(progress.stalled))


def advance(
    progress: Progress,
    path: Path,
    pose: Array,
    twist: Array,
    goal: Array,
    tolerance: Array,
    tick: Floats,
    settings: Reference,
) -> Progress:
    """Progress after one tick.

    Args:
      progress: the previous one.
      path: the path in force.
      pose: [3] estimated pose.
      twist: [3] estimated twist.
      goal: [3].
      tolerance: [2] m and rad, of the goal.
      tick: s.
      settings: speed, lead, arrival.
    """
    error = path.poses - pose
    distance = jnp.sum(error[:, :2] ** 2, axis=1) + (settings.turn_radius * wrap_angle(error[:, 2])) ** 2
    window = (path.arc >= progress.projected - 1e-4) & (path.arc <= progress.projected + 0.5)
    projected = path.arc[jnp.argmin(jnp.where(window, distance, jnp.inf))]
    projected = jnp.maximum(projected, progress.projected)
    pace = speed_at(progress.reference, path, settings)
    ahead = jnp.minimum(progress.reference + pace * tick, projected + settings.lead)
    reference = jnp.minimum(jnp.maximum(ahead, projected), path.length)
    reference = jnp.where(progress.held, projected, reference)
    off = misfit(pose, goal, tolerance)
    # Where the object has come to stand within the tolerances, gets worse, or would leave them for another approach, it
    # had better stay: that may end worse.
    stands = (jnp.max(jnp.abs(twist[:2])) < STILL[0]) & (jnp.abs(twist[2]) < STILL[1])
    leaves = path.length - projected > LOOP
    worsens = misfit(pose + SOON * twist, goal, tolerance) > off + WORSE
    limit = jnp.where(progress.resting | stands | leaves | worsens, settings.leave, settings.arrive)
    return dataclasses.replace(progress, projected=projected, reference=reference, resting=off < limit)


def misfit(pose: Array, goal: Array, tolerance: Array) -> Array:
    """[] by how many tolerances [2] m and rad a pose [3] is off the goal [3], at most."""
    off = pose - goal
    return jnp.maximum(safe_norm(off[:2]) / tolerance[0], jnp.abs(wrap_angle(off[2])) / tolerance[1])


def speed_at(arc: Array, path: Path, settings: Reference) -> Array:
    """[...] m/s, of the reference at arc lengths [...] m: v_avg, or less where robots would have to walk too fast."""
    return jnp.minimum(settings.speed, settings.walk_fraction * path.speed_limit(arc))


def targets(progress: Progress, path: Path, times: Array, settings: Reference) -> Targets:
    """Reference at `times` [N + 1] s from now: constant speed, then an exponential approach to the end of the path.

    A team that waits stays where it is.
    """
    pace, settle = speed_at(progress.reference, path, settings), settings.settle
    times = jnp.where(progress.held, 0.0, times)
    remaining = path.length - progress.reference
    fast = jnp.maximum(remaining - settle, 0.0) / pace
    slow = jnp.minimum(remaining, settle) * jnp.exp(-pace * jnp.maximum(times - fast, 0.0) / settle)
    left = jnp.where(times < fast, remaining - pace * times, slow)
    rate = jnp.where(progress.held, 0.0, jnp.where(times < fast, pace, pace * slow / settle))
    arc = path.length - left
    ahead, behind = path.at(arc + 0.02), path.at(arc - 0.02)
    span = jnp.minimum(arc + 0.02, path.length) - jnp.maximum(arc - 0.02, 0.0)
    slope = (ahead - behind) / jnp.maximum(span, 1e-3)[:, None]
    # What pushes is read where the object will be, not where the reference is: a reference that waits at the goal asks
    # for no push, and an object that sticks short of it would stay there.
    follow = jnp.minimum(progress.projected + pace * times, arc)
    force, offset = path.feed_forward(follow)
    sticks = (follow < path.length - STOPPED) & ~progress.held
    moving = jnp.maximum(rate, jnp.where(sticks, pace, 0.0))
    moving = jnp.minimum(moving / (FADE * pace), 1.0)
    return Targets(path.at(arc), slope * rate[:, None], force * moving[:, None], offset)


STALLED, PATIENCE = 0.1, 3
"""share of the usual way between two searches below which the team stalls, and searches after which it is stuck: it
may have to walk to other contact offsets first, and to find out how much push it takes"""
FADE = 0.3
"""share of the usual speed below which the steady pushes fade"""
STILL = 0.02, 0.05
"""m/s and rad/s, below which an object stands"""
LOOP = 0.6
"""m left of a path from within the tolerances that is a detour"""
SOON, WORSE = 0.3, 0.03
"""s, and tolerances by which an object that moves on for so long gets worse"""
STOPPED = 0.03
"""m from the end of the path, within which an object that sticks is not pushed on"""
