import asked
import jax
import jax.numpy as jnp
import numpy as np
import pytest
from flat_ground import FlatGround

from jaxlocomanip.locomotion.settings import derived_settings, settings_for
from jaxlocomanip.robots.model import ROBOT_TYPES


def test_every_robot_has_settings_and_they_stack():
    several = [settings_for(name) for name in ROBOT_TYPES]
    stacked = jax.tree.map(lambda *leaves: jnp.stack(leaves), *several)
    assert stacked.forces.steps == 10
    assert stacked.gait.offset.shape == (3, 4)
    assert all(leaf.dtype == jnp.float32 for leaf in jax.tree.leaves(stacked))


def test_unknown_robot_is_refused_by_name():
    with pytest.raises(ValueError, match=r"'spot'.*aliengo, a1, go1"):
        settings_for("spot")


def test_horizon_is_one_cycle():
    for name in ROBOT_TYPES:
        settings = settings_for(name)
        assert float(settings.forces.dt) * settings.forces.steps == pytest.approx(float(settings.gait.period))


def test_derived_settings_are_near_the_tuned_ones_for_aliengo(robots):
    derived, tuned = derived_settings(robots["aliengo"]), settings_for("aliengo")
    assert jax.tree.structure(derived) == jax.tree.structure(tuned)
    for ours, theirs in zip(jax.tree.leaves(derived), jax.tree.leaves(tuned), strict=True):
        assert np.asarray(ours) == pytest.approx(np.asarray(theirs), rel=0.1)


@pytest.mark.parametrize("name", ["a1", "go1"])
def test_derived_settings_walk(name, robots):
    log = FlatGround(name, derived_settings(robots[name])).run(5.0, asked.walk((0.5, 0.5, 0.0, 0.0)))
    assert log.time[-1] > 4.99 and log.tilt.max() < 0.2
    assert log.mean_velocity(2.0)[0] == pytest.approx(0.5, rel=0.05)
