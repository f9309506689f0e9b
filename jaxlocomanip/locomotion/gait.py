"""When each leg stands and when it swings.

A leg's cycle is one period: stance while its phase is below the duty, then swing until the phase wraps. Swings begin
only while walking and always run to their end, so that a robot stops with four feet on the ground wherever in the
cycle it is asked to, and starts again with a fresh clock.
"""

from __future__ import annotations

import jax.numpy as jnp
from jax import Array

from jaxlocomanip.numerics import Floats, pytree


@pytree
class Gait:
    """A periodic gait."""

    period: Floats
    """[] s, of one cycle"""
    duty: Floats
    """[] fraction of the period that a leg stands"""
    offset: Array
    """[4] phases at the start, in [0, 1); below the duty, so that a start lifts no leg at once"""


@pytree
class GaitState:
    """Where in the cycle a robot is."""

    start: Array
    """[] s, when the clock was started"""
    phase: Array
    """[4] at the last update, in [0, 1)"""
    swinging: Array
    """[4] bool"""
    moving: Array
    """[] bool: the clock runs"""


@pytree
class Schedule:
    """Contacts along a horizon of N steps."""

    contact: Array
    """[N, 4] bool: stance"""
    cycle: Array
    """[N, 4] touchdowns of the leg up to then, as float: 0 for the foothold it has now"""


def start(gait: Gait) -> GaitState:
    """Standing on four feet."""
    offset = jnp.asarray(gait.offset)
    return GaitState(jnp.zeros_like(offset[0]), offset, jnp.zeros(4, bool), jnp.zeros((), bool))


def update(state: GaitState, gait: Gait, time: Array, walking: Array) -> GaitState:
    """The gait at `time` [] s; `walking` [] bool decides whether stance legs may lift."""
    fresh = walking & ~state.moving
    began = jnp.where(fresh, time, state.start)
    before = jnp.where(fresh, gait.offset, state.phase)
    turns = (time - began) / gait.period + gait.offset
    phase = turns - jnp.floor(turns)
    lands = state.swinging & (phase < gait.duty)
    lifts = walking & ~state.swinging & (before < gait.duty) & (phase >= gait.duty)
    swinging = (state.swinging & ~lands) | lifts
    return GaitState(began, phase, swinging, walking | jnp.any(swinging))


def swing_progress(state: GaitState, gait: Gait) -> Array:
    """[4] fraction of the swing that is over; of no meaning for stance legs."""
    return jnp.clip((state.phase - gait.duty) / (1.0 - gait.duty), 0.0, 1.0)


def time_to_touchdown(state: GaitState, gait: Gait) -> Array:
    """[4] s until the leg's phase wraps."""
    return (1.0 - state.phase) * gait.period


def schedule(state: GaitState, gait: Gait, walking: Array, dt: Floats, steps: int) -> Schedule:
    """Contacts over the coming `steps` intervals of `dt` s.

    Row 0 is the actual stance; row j is the schedule in the middle of interval j.
    """
    ahead = state.phase + (jnp.arange(steps)[:, None] + 0.5) * dt / gait.period
    cycle = jnp.floor(ahead)
    scheduled = ahead - cycle < gait.duty
    # In the current cycle a leg that swings does so to the end, and one that missed its lift-off stays down.
    current = ~state.swinging & (scheduled | (state.phase >= gait.duty))
    contact = jnp.where(cycle < 0.5, jnp.where(walking, current, ~state.swinging), scheduled | ~walking)
    # Who stops keeps the footholds of the last touchdowns.
    last = jnp.where(state.swinging, 1.0, 0.0)
    contact = contact.at[0].set(~state.swinging)
    return Schedule(contact, jnp.where(walking, cycle, jnp.minimum(cycle, last)))
