"""Derivatives that fade, of values that do not."""

import jax
import jax.numpy as jnp
import pytest

from jaxlocomanip.fading import fade, shares_kept
from jaxlocomanip.planner.config import PlannerConfig


def test_derivatives_fade_and_values_do_not():
    def grown(x, kept):
        return jax.lax.scan(lambda y, _: (3.0 * fade(y, kept), None), x, None, length=4)[0]

    for kept in (1.0, 0.5):
        value, slope = jax.value_and_grad(grown)(jnp.ones(()), jnp.asarray(kept))
        assert value == 81.0 and slope == pytest.approx((3.0 * kept) ** 4)


def test_what_is_no_real_number_passes():
    tree = {"count": jnp.arange(3), "waits": jnp.array([True, False]), "pose": jnp.ones(2)}
    same = fade(tree, jnp.zeros(()))
    assert jax.tree.all(jax.tree.map(lambda a, b: (a == b).all() and a.dtype == b.dtype, tree, same))


def test_shares_are_those_of_a_time_constant():
    config = PlannerConfig()
    kept = shares_kept(config, 5.0 * config.horizon.tick, plans=0.5)
    assert kept.motion == pytest.approx(jnp.exp(-0.2)) and kept.plan == pytest.approx(0.5 * kept.motion)
    assert shares_kept(config, jnp.inf).motion == 1.0
