"""Bodies for the tests of the object's mechanics."""

import jax.numpy as jnp
import numpy as np
import pytest

from jaxlocomanip.planar.dynamics import Body


@pytest.fixture(scope="session")
def make_body():
    """A function: a body, by default one that any test may take."""

    def make(mass=6.0, inertia=0.5, com=(0.05, -0.08), force=20.0, moment=4.0, dtype=None):
        return Body(*(jnp.asarray(v, dtype) for v in (mass, inertia, com, force, moment)))

    return make


@pytest.fixture(scope="session")
def random_body(make_body):
    """A function: a body drawn from a generator."""

    def draw(rng):
        mass, com = rng.uniform(2.0, 12.0), rng.uniform(-0.1, 0.1, 2)
        inertia = rng.uniform(0.1, 1.0) + mass * com @ com
        force = rng.uniform(5.0, 60.0)
        return make_body(mass, inertia, com, force, force * rng.uniform(0.1, 0.4))

    return draw


@pytest.fixture(scope="session")
def at_com():
    """A function: inertia and friction limits [3] of a body at its centre of mass, as NumPy arrays."""

    def give(body):
        inertia = np.array([body.mass, body.mass, body.central_inertia])
        return inertia, np.array([body.friction_force, body.friction_force, body.friction_moment])

    return give
