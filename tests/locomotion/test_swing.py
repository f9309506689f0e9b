import jax
import jax.numpy as jnp
import numpy as np
import pytest

from jaxlocomanip.locomotion.swing import swing

FROM = np.array([[0.1, -0.2, 0.02], [0.3, 0.2, 0.03], [0.0, 0.0, 0.0], [1.0, 2.0, 0.1]], np.float32)
TO = FROM + np.array([[0.2, 0.0, 0.01], [0.1, 0.1, -0.02], [0.0, 0.0, 0.0], [-0.2, 0.1, 0.05]], np.float32)
HEIGHT, DURATION = 0.08, 0.2


def at(progress):
    return swing(FROM, TO, jnp.full(4, progress, jnp.float32), HEIGHT, DURATION)


def test_begins_and_ends_at_rest_where_it_should_also_in_height():
    for progress, place in ((0.0, FROM), (1.0, TO)):
        position, velocity, _ = at(progress)
        assert position == pytest.approx(place, abs=1e-6)
        assert velocity == pytest.approx(np.zeros((4, 3)), abs=1e-5)


def test_apex_is_above_the_middle():
    position, _, _ = at(0.5)
    assert position == pytest.approx(0.5 * (FROM + TO) + [0.0, 0.0, HEIGHT], abs=1e-6)


@pytest.mark.parametrize("progress", [0.05, 0.3, 0.5, 0.77, 0.98])
def test_velocity_and_acceleration_are_derivatives(progress):
    _, velocity, acceleration = at(progress)
    rate = 1.0 / DURATION
    assert velocity == pytest.approx(np.asarray(jax.jacfwd(lambda p: at(p)[0])(progress) * rate), abs=1e-4)
    assert acceleration == pytest.approx(np.asarray(jax.jacfwd(lambda p: at(p)[1])(progress) * rate), abs=2e-3)


def test_a_moved_target_is_reached():
    position, _, _ = swing(FROM, TO + 0.1, jnp.ones(4), HEIGHT, DURATION)
    assert position == pytest.approx(TO + 0.1, abs=1e-6)
