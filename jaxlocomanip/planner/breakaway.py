"""Friction from the moment at which the object breaks away.

Nothing moves before the push exceeds the floor's friction, so the push at which an object at rest starts to slide
bounds the friction from above, at once, where an adaptation law needs a second of unexpected motion. Slip is seen by
an observer that knows nothing of friction: one that believes the object to stick sees a quarter of its speed.
"""

from __future__ import annotations

import dataclasses

import jax
import jax.numpy as jnp
from jax import Array

from jaxlocomanip.numerics import Floats, pytree, safe_norm
from jaxlocomanip.planar import dynamics
from jaxlocomanip.planar.geometry import cross
from jaxlocomanip.planner.adaptation import ParameterEstimate
from jaxlocomanip.planner.config import Estimation, PlannerConfig
from jaxlocomanip.planner.estimation import ObjectEstimate, correct_object, start_object
from jaxlocomanip.planner.shapes import Shapes

SLIP, STILL = 0.15, 0.04
"""m/s, speed above which the object has broken away, and mean speed below which it may be at rest"""
SHIFT = 0.015
"""m, way from its place at rest after which it has broken away, too: under a push that rises slowly long before it is
fast; 5 mm of noise pass for it more rarely than for the speed"""
_ONSET = 0.25
"""s, from the onset of slip until it is seen: the push of then is what friction was"""
_OBSERVER = Estimation(pose_gain=0.4, twist_gain=0.1)
"""with 5 mm of noise at 50 Hz its velocity has 3 cm/s, and settles in 0.1 s"""
_MEAN, _PLACE, _TRUST = 0.2, 1.0, 0.3
"""s, over which the mean twist and the place are taken, and from when on an object seen still is at rest"""


@pytree
class Breakaway:
    """What is watched."""

    seen: ObjectEstimate
    """by an observer of constant velocity"""
    place: Array
    """[3] pose at rest"""
    tight: Array
    """[] bool: an obstacle is near, so that the way from there counts, too"""
    mean: Array
    """[3] of the twist over a while"""
    push: Array
    """[] N, `limit_push` of a moment ago"""
    waiting: Array
    """[] bool: at rest, or not yet seen to slide since"""
    still: Array
    """[] s, for which the object has been still"""


def start(pose: Array) -> Breakaway:
    """Before the first tick, at rest at a pose [3]."""
    zero = jnp.zeros((), pose.dtype)
    return Breakaway(
        start_object(pose), pose, jnp.zeros((), bool), jnp.zeros_like(pose), zero, jnp.ones((), bool), zero
    )


def limit_push(wrench_B: Array, com: Array, shapes: Shapes) -> Array:
    """[] N, size of a wrench [3] about the body point in the norm of the friction's limit surface."""
    moment = (wrench_B[2:] - cross(com, wrench_B[:2])) / shapes.torsion_radius
    return safe_norm(jnp.concatenate([wrench_B[:2], moment]))


def speed(twist: Array, shapes: Shapes) -> Array:
    """[] m/s, size of a twist [3] (or m, of a change of pose), rotation counted at the torsion radius."""
    return safe_norm(jnp.concatenate([twist[:2], shapes.torsion_radius * twist[2:]]))


def watch(before: Breakaway, measured: Array, push: Array, shapes: Shapes, tick: Floats) -> tuple[Breakaway, Array]:
    """One tick.

    Args:
      before: the state before.
      measured: [3] pose; its heading may be wrapped.
      push: [] N, `limit_push` of what acts.
      shapes: geometry.
      tick: s.

    Returns:
      The new state, and [] bool: the object has just been seen to break away.
    """
    guess = before.seen.pose + tick * before.seen.twist
    seen = correct_object(guess, before.seen.twist, measured, tick, _OBSERVER)
    mean = before.mean + tick / (tick + _MEAN) * (seen.twist - before.mean)
    away = speed(seen.pose - before.place, shapes)
    slips = before.waiting & ((speed(seen.twist, shapes) > SLIP) | (before.tight & (away > SHIFT)))
    followed = before.place + tick / (tick + _PLACE) * (seen.pose - before.place)
    place = jnp.where(before.waiting, followed, seen.pose)
    still = jnp.where(speed(mean, shapes) < STILL, before.still + tick, 0.0)
    waiting = jnp.where(before.waiting, ~slips, still > _TRUST)
    lagged = before.push + tick / (tick + _ONSET) * (push - before.push)
    return Breakaway(seen, place, before.tight, mean, lagged, waiting, still), slips


def corrected(
    estimate: ObjectEstimate, parameters: ParameterEstimate, watched: Breakaway, slips: Array, config: PlannerConfig
) -> tuple[ObjectEstimate, ParameterEstimate]:
    """Estimates that agree with a slip just seen: the velocity seen, and no more friction than the push.

    Only where anything is adapted, and where pushes rise gently before the object breaks away: after a sudden push that
    of a moment ago says nothing.
    """
    adapts = jnp.any(jnp.stack([jnp.asarray(gain) for gain in config.adaptation.gain]) > 0.0)
    slips = slips & (config.adaptation.breakaway > 0.5) & adapts & (config.safety.enabled > 0.5)

    def bounded(psi: Array) -> Array:
        # Noise passes for a slip once in 66,000 ticks, also when nobody pushes.
        least = config.safety.friction * psi[0] * dynamics.GRAVITY
        share = jnp.minimum(1.0, jnp.maximum(watched.push, least) / jnp.maximum(psi[4], 1e-3))
        return jnp.where(slips, psi.at[4:].multiply(share), psi)

    twist = jnp.where(slips, watched.seen.twist, estimate.twist)
    return dataclasses.replace(estimate, twist=twist), jax.tree.map(bounded, parameters)
