"""Work that only some lanes of a batch need."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from jaxlocomanip.lanes import GROUP, where_needed


def costly(arguments):
    x, scale = arguments
    return {"square": scale * x**2, "sum": jnp.sum(x)}


def chosen(needed, x, scale):
    otherwise = {"square": jnp.full_like(x, -1.0), "sum": jnp.full((), -2.0, x.dtype)}
    return where_needed(needed, costly, (x, scale), otherwise)


def test_alone_it_is_a_condition():
    x = jnp.arange(3.0)
    assert chosen(jnp.asarray(True), x, 2.0)["square"].tolist() == [0.0, 2.0, 8.0]
    assert chosen(jnp.asarray(False), x, 2.0)["square"].tolist() == [-1.0] * 3


@pytest.mark.parametrize("count", [0, 1, GROUP - 1, GROUP, GROUP + 1, 3 * GROUP])
@pytest.mark.parametrize("size", [3, 3 * GROUP])
def test_each_lane_gets_what_it_would_alone(size, count):
    random = np.random.default_rng(count)
    needed = np.zeros(size, bool)
    needed[random.permutation(size)[:count]] = True
    x = jnp.asarray(random.normal(size=(size, 4)), jnp.float32)
    batch = jax.jit(jax.vmap(chosen, in_axes=(0, 0, None)))(jnp.asarray(needed), x, 3.0)
    alone = [chosen(jnp.asarray(bool(n)), row, 3.0) for n, row in zip(needed, x, strict=True)]
    for name in ("square", "sum"):
        np.testing.assert_allclose(batch[name], np.stack([one[name] for one in alone]), rtol=1e-6)


def test_under_two_batch_axes():
    needed = jnp.asarray([[True, False], [False, True], [True, True]])
    x = jnp.arange(24.0).reshape(3, 2, 4)
    twice = jax.vmap(jax.vmap(chosen, in_axes=(0, 0, None)), in_axes=(0, 0, None))(needed, x, 1.0)
    expected = np.where(np.asarray(needed)[..., None], np.asarray(x) ** 2, -1.0)
    np.testing.assert_allclose(twice["square"], expected)


def test_few_lanes_in_need_are_few_evaluations():
    """The function runs once for each group, not for each lane."""
    calls = []

    def counted(x):
        jax.debug.callback(lambda: calls.append(1))
        return x

    def one(needed, x):
        return where_needed(needed, counted, x, jnp.zeros_like(x))

    size = 4 * GROUP
    needed = jnp.arange(size) < 2
    jax.block_until_ready(jax.jit(jax.vmap(one))(needed, jnp.arange(float(size))))
    jax.effects_barrier()
    assert len(calls) <= GROUP


def test_in_a_batch_of_one_it_is_a_condition():
    """The compiler moves what does not depend on a loop out of it, and would then compute it in any case."""

    def one(needed, x):
        return where_needed(needed, lambda x: jnp.sin(x) @ x, x, jnp.zeros(()))

    program = jax.jit(jax.vmap(one)).lower(jnp.ones(1, bool), jnp.ones((1, 50))).compile()
    if jax.default_backend() == "cpu":
        main = program.as_text().split("ENTRY")[1]
        assert "conditional(" in main and "sine" not in main and " dot(" not in main
    for needed in (True, False):
        found = program(jnp.asarray([needed]), jnp.ones((1, 50)))
        assert found[0] == pytest.approx(50.0 * np.sin(1.0) if needed else 0.0, rel=1e-5)


def test_lanes_can_be_taken_one_by_one():
    needed, x = jnp.asarray([True, False, True, True]), jnp.arange(8.0).reshape(4, 2)
    found = jax.vmap(lambda n, v: where_needed(n, jnp.sum, v, jnp.full((), -1.0), group=1))(needed, x)
    assert found.tolist() == [1.0, -1.0, 9.0, 13.0]
