"""The closest approach of an episode to its obstacles, and how it changes with the scenario.

    slope = jax.grad(lambda where: closest_approach(vary(scenario, where, bounds), config, ticks=400))(where)

Unstable pushing makes the derivative of a whole episode useless where it is long (`gradients`), and one that fades fast
enough has forgotten everything but the last moments. So only those are differentiated: the episode is run once, without
derivatives, and of the ticks up to its closest approach the last few are gone through again with them. That costs
little more than the episode.
"""

from __future__ import annotations

import dataclasses
import math

import jax
import jax.numpy as jnp
from jax import Array

from jaxlocomanip import checked, gradients
from jaxlocomanip import loop as closing
from jaxlocomanip.fading import shares_kept
from jaxlocomanip.gradients import WORLD, Episode
from jaxlocomanip.numerics import Floats, T
from jaxlocomanip.outcome import gaps
from jaxlocomanip.planner.config import PlannerConfig
from jaxlocomanip.scenario import Scenario
from jaxlocomanip.worlds.planar import PlanarWorld


def closest_approach(
    scenario: Scenario,
    config: PlannerConfig,
    ticks: int,
    window: int = 20,
    world: PlanarWorld = WORLD,
    key: Array | None = None,
    memory: Floats = math.inf,
) -> Array:
    """[] m, soft minimum of the clearances of object and robots over the last ticks up to the closest approach.

    Its derivative holds fixed the state at the beginning of those ticks, and the paths.

    Args:
      scenario: without batch axis.
      config: planner settings.
      ticks: of the episode (static).
      window: ticks that are differentiated (static).
      world: the planar world, whose friction has to be smoothed.
      key: of measurement noise; seed 0 by default.
      memory: s, as of `gradients.soft_outcome`.

    Raises:
      InputError: a batch, or a bad number.
    """
    gradients.check_episode(scenario, ticks, memory)
    checked.count("window", window)
    config, noise = gradients.planning(config), jax.random.key(0) if key is None else key
    window = min(window, ticks)
    kept = shares_kept(config, memory)
    # Without derivatives nothing of the episode is kept but what is asked for here.
    fixed, settings = jax.lax.stop_gradient((scenario, config))
    states, clearance = _recorded(fixed, settings, ticks, world, noise)
    first = jnp.clip(jnp.argmin(clearance[:ticks]) - window + 1, 0, ticks - window)
    last = jax.tree.map(lambda leaf: jax.lax.dynamic_slice_in_dim(leaf, first, window), states)
    start = jax.tree.map(lambda leaf: leaf[0], last)

    def tick(carry: Episode, recorded: Episode) -> tuple[Episode, None]:
        # The path may have been searched anew in between.
        there = dataclasses.replace(_with_values(recorded, gradients.faded(carry, kept)), sums=carry.sums)
        return gradients.advance(there, scenario, config, world, noise, ticks), None

    start = dataclasses.replace(start, sums=gradients.nothing(scenario))
    end, _ = jax.lax.scan(jax.checkpoint(tick), start, last)
    return gradients.soft_clearances(end.sums, window)[0]


def _recorded(
    scenario: Scenario, config: PlannerConfig, ticks: int, world: PlanarWorld, key: Array
) -> tuple[Episode, Array]:
    """The episode before each tick, leaves [T, ...], and the clearance [T] after it; T may exceed `ticks`."""
    length = min(closing.ticks_per_search(config), ticks)

    def tick(carry: Episode, _: None) -> tuple[Episode, tuple[Episode, Array]]:
        new = gradients.advance(carry, scenario, config, world, key, ticks)
        time = new.loop.tick * config.horizon.tick
        clearance = jnp.min(gaps(scenario, new.view, scenario.obstacles.at(time)))
        # After its duration an episode stands still, and moving obstacles do not.
        return new, (carry, jnp.where(time < scenario.duration + 0.5 * config.horizon.tick, clearance, jnp.inf))

    def block(carry: Episode, _: None) -> tuple[Episode, tuple[Episode, Array]]:
        return jax.lax.scan(tick, gradients.searched(carry, scenario, config), None, length=length)

    start = gradients.begin(scenario, config, world, key)
    _, rows = jax.lax.scan(block, start, None, length=-(-ticks // length))
    return jax.tree.map(lambda leaf: leaf.reshape(-1, *leaf.shape[2:]), rows)


def _with_values(values: T, tangents: T) -> T:
    """The numbers of one tree with the derivatives of another."""

    def one(value: Array, tangent: Array) -> Array:
        if not jnp.issubdtype(tangent.dtype, jnp.floating):
            return value
        return jax.lax.stop_gradient(value) + (tangent - jax.lax.stop_gradient(tangent))

    return jax.tree.map(one, values, tangents)
