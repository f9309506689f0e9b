"""What a world must offer to the closed loop."""

from __future__ import annotations

from typing import Any, ClassVar, Protocol

from jax import Array

from jaxlocomanip.numerics import Floats, pytree
from jaxlocomanip.scenario import Scenario


@pytree
class Push:
    """What a world is asked to do for one tick."""

    force: Array
    """[N_r] N"""
    offset_rate: Array
    """[N_r] m/s"""
    twist: Array
    """[3] m/s, rad/s: the velocity that the object is meant to have, of its body point, world axes"""
    resting: Array
    """[] bool: the object has arrived, nobody needs to walk"""
    formation: Array | int = 0
    """[] int: which the team shall take"""


@pytree
class Bodies:
    """Bodies in space, for recordings."""

    position: Array
    """[n, 3] m"""
    quaternion: Array
    """[n, 4] w, x, y, z"""
    foot_force: Array
    """[N_r, 4, 3] N, on each foot, world axes"""
    contact_point: Array
    """[N_r, 3] m, where each robot touches or would touch the object"""


@pytree
class View:
    """The true state, as far as outcome and recording care."""

    pose: Array
    """[3] object"""
    twist: Array
    """[3] object, of the body point p"""
    offset: Array
    """[N_r] m, contact offsets"""
    force: Array
    """[N_r] N, contact forces that act"""
    robots: Array
    """[N_r, 3] poses of the robots' body rectangles"""
    contact: Array
    """[N_r] bool: the robot is at its face and pushes as asked"""
    fallen: Array
    """[N_r] bool"""
    formation: Array
    """[] int: which the team has, or is about to take; the offsets are those in it"""
    bodies: Bodies | None
    """what only a world with bodies in space has"""


class World(Protocol):
    """A world stands behind the measurement: a pytree of whatever it needs to know, with a state of its own."""

    traceable: ClassVar[bool]
    """its functions can be compiled together with the planner; otherwise Python steps it, one scenario at a time"""
    sway: ClassVar[float]
    """m, by which robots of this world sway about where they hold: all margins of the planner are larger by that"""

    def prepare(self, scenarios: Scenario) -> World:
        """The world made ready for scenarios, outside any compiled program; its leaves get their batch axis.

        Raises:
          InputError: a scenario that this world cannot represent.
        """
        ...

    def start(self, scenario: Scenario) -> Any:
        """State at t = 0."""
        ...

    def step(self, state: Any, scenario: Scenario, push: Push, time: Floats, tick: float) -> Any:
        """State one tick after `time`, the push held."""
        ...

    def view(self, state: Any, scenario: Scenario) -> View:
        """The true state."""
        ...
