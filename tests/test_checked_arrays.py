"""Arrays are refused by shape always, and by their numbers where these are known."""

import re

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from jaxlocomanip import checked_arrays
from jaxlocomanip.checked import InputError
from jaxlocomanip.padding import stack


@pytest.mark.parametrize(
    ("value", "text"),
    [
        (np.zeros((3, 2)), "pose has shape [3, 2]: must be [T, 3] = [2, 3]"),
        (np.array([[0.0, 1.0, 2.0], [0.0, np.nan, np.inf]]), "pose[1, 1] = nan: must be finite"),
    ],
)
def test_arrays_are_refused(value, text):
    with pytest.raises(InputError, match=re.escape(text)):
        checked_arrays.shaped("pose", value, "[T, 3]", (2, 3))


@pytest.mark.parametrize(
    ("value", "text"),
    [
        (jnp.ones(2), "memory has shape [2]: must be one number"),
        (0.0, "memory = 0.0: must be > 0"),
        (jnp.asarray(-1.0), "memory = -1.0: must be > 0"),
        (np.nan, "memory = nan: must be finite"),
        (np.inf, "memory = inf: must be finite"),
        ("long", "memory = 'long': must be a number"),
        (True, "memory = True: must be a number"),
    ],
)
def test_numbers_are_refused(value, text):
    with pytest.raises(InputError, match=re.escape(text)):
        checked_arrays.scalar("memory", value, 0.0, strictly=True)


def test_an_endless_number_may_be_infinite():
    for value in (np.inf, jnp.inf, 1, 2.5, np.float32(2.5), jnp.asarray(2.5)):
        checked_arrays.scalar("memory", value, 0.0, strictly=True, endless=True)


def test_of_traced_numbers_only_the_shape_is_known():
    @jax.jit
    def used(array, number):
        checked_arrays.shaped("array", array, "[2]", (2,))
        checked_arrays.scalar("number", number, 0.0)
        with pytest.raises(InputError, match="has shape"):
            checked_arrays.shaped("array", array, "[3]", (3,))
        return array + number

    assert np.isnan(used(jnp.full(2, jnp.nan), -1.0)).all()


def test_a_batch_is_not_a_single_scenario(make_scenario):
    checked_arrays.single("scenario", make_scenario())
    batch = stack([make_scenario(0), make_scenario(1)])
    with pytest.raises(InputError, match="scenario = a batch of 2: must be a single scenario"):
        checked_arrays.single("scenario", batch)
    jax.eval_shape(jax.vmap(lambda one: checked_arrays.single("scenario", one)), batch)
