"""Batches of scenarios: padding that a study decides, and stacking without the device."""

import dataclasses

import jax
import numpy as np
import pytest

from jaxlocomanip.checked import InputError
from jaxlocomanip.padding import Padding, stack, stack_on_host

CIRCLE = {"shape": "circle", "radius": 0.2, "position": [6.0, 6.0]}


@pytest.fixture
def scenarios(make_scenario):
    long = {"size": [1.5, 0.5], "mass": 6.0}
    return [
        make_scenario(index=0),
        make_scenario(index=1, obstacles=[CIRCLE] * 3),
        make_scenario(index=2, object=long, robots=[{"type": "a1", "face": f} for f in ("-x", "-y")]),
    ]


def test_the_least_padding_holds_all(scenarios):
    assert Padding.of(scenarios) == Padding(obstacles=3, corners=4, marks=1, vertices=4, discs=3)


def test_padding_gives_every_batch_one_shape(scenarios):
    padding = Padding(obstacles=5, corners=6, marks=2, vertices=8, discs=4)
    shapes = [
        [leaf.shape[1:] for leaf in jax.tree.leaves(stack(part, padding))] for part in (scenarios[:1], scenarios[1:])
    ]
    assert shapes[0] == shapes[1]
    batch = stack_on_host(scenarios, padding)
    assert batch.obstacles.vertices.shape == (3, 5, 6, 2)
    assert batch.obstacles.mask.sum(axis=1).tolist() == [0, 3, 0]
    assert (batch.object.vertices[:, 4:] == batch.object.vertices[:, 3:4]).all()
    assert (batch.object.disc_radii[0] == batch.object.disc_radii[0, 0]).all()


def test_on_the_host_the_batch_is_the_same(scenarios):
    for host, device in zip(jax.tree.leaves(stack_on_host(scenarios)), jax.tree.leaves(stack(scenarios)), strict=True):
        assert isinstance(host, np.ndarray)
        assert host.dtype == device.dtype and np.array_equal(host, device)


@pytest.mark.parametrize("field", ["obstacles", "discs"])
def test_too_little_padding_is_refused(scenarios, field):
    padding = dataclasses.replace(Padding.of(scenarios), **{field: 1})
    with pytest.raises(InputError, match=f"padding.{field} = 1: must be >= 3"):
        stack(scenarios, padding)
