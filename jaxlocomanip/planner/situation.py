"""What the planner knows in one tick, as estimated."""

from __future__ import annotations

from jax import Array

from jaxlocomanip.numerics import pytree
from jaxlocomanip.planar.dynamics import Body
from jaxlocomanip.planner.estimation import ObjectEstimate, ObstacleEstimate


@pytree
class Situation:
    """What inputs are chosen from."""

    estimate: ObjectEstimate
    body: Body
    """the object as estimated"""
    obstacles: ObstacleEstimate
    offset: Array
    """[N_r] m, contact offsets"""
    room: Array
    """[] m, least gap between bodies that are protected and obstacles that stand (`room.standing_room`)"""
    kept: Array
    """[1 + N_r, N_o] m, of the gaps between object, robots and obstacles, what is to be kept (`keeping`)"""
    force: Array
    """[N_r] N, pushes believed to act now"""
    proven: Array
    """[] N, friction to brake with (`safety.prove_friction`)"""
    waiting: Array
    """[] bool: the object has not broken away since it was at rest (`breakaway`)"""
    stirring: Array
    """[] m/s, mean speed of late, seen without any belief in friction (`breakaway`)"""
    held: Array
    """[] bool: the team waits for an obstacle to pass (`schedule`)"""
