"""What a world must offer to the closed loop."""

from __future__ import annotations

from typing import Any, Protocol

from jax import Array

from jaxlocomanip.numerics import pytree
from jaxlocomanip.scenario import Scenario


@pytree
class Push:
    """What a world is asked to do for one tick."""

    force: Array
    """[N_r] N"""
    offset_rate: Array
    """[N_r] m/s"""


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


class World(Protocol):
    """A world stands behind the measurement; its state is a pytree of its own."""

    def start(self, scenario: Scenario) -> Any:
        """State at t = 0."""
        ...

    def step(self, state: Any, scenario: Scenario, push: Push, tick: float) -> Any:
        """State one tick later, the push held."""
        ...

    def view(self, state: Any, scenario: Scenario) -> View:
        """The true state."""
        ...
