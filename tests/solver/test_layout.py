"""Functions with the lanes last against what they stand for."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from jaxlocomanip.solver import riccati
from jaxlocomanip.solver.layout import applied, lanes_last, times, transposed_applied, transposed_times
from jaxlocomanip.solver.riccati import LinearQuadratic

PRODUCTS = {
    "times": (times, "mk...,kn...->mn...", (3, 4), (4, 5)),
    "transposed_times": (transposed_times, "km...,kn...->mn...", (4, 3), (4, 5)),
    "applied": (applied, "mk...,k...->m...", (3, 4), (4,)),
    "transposed_applied": (transposed_applied, "km...,k...->m...", (4, 3), (4,)),
}


@pytest.mark.parametrize("name", PRODUCTS)
@pytest.mark.parametrize("trailing", [(), (6,), (6, 2)])
def test_products(x64, name, trailing):
    product, written, first, second = PRODUCTS[name]
    rng = np.random.default_rng(0)
    a, b = rng.normal(size=first + trailing), rng.normal(size=second + trailing)
    axes = "xy"[: len(trailing)]
    expected = np.einsum(written.replace("...", axes), a, b)
    assert np.allclose(product(jnp.asarray(a), jnp.asarray(b)), expected, rtol=0.0, atol=1e-12)


def test_lanes_come_last_and_leave_first(x64):
    seen = []

    @lanes_last
    def scaled(matrix, factor):
        seen.append((matrix.shape, factor.shape))
        return {"product": matrix * factor, "sum": jnp.sum(matrix, axis=0)}

    matrices, factors = jnp.arange(30.0).reshape(5, 3, 2), jnp.arange(5.0)
    alone = scaled(matrices[1], factors[1])
    assert seen[-1] == ((3, 2), ())
    batch = jax.vmap(scaled)(matrices, factors)
    assert seen[-1] == ((3, 2, 5), (5,))
    assert (batch["product"][1] == alone["product"]).all() and (batch["sum"][1] == alone["sum"]).all()
    shared = jax.vmap(scaled, in_axes=(None, 0))(matrices[2], factors)
    assert (shared["product"] == matrices[2] * factors[:, None, None]).all()


def lq_of(seed):
    rng = np.random.default_rng(seed)
    n, nx, nz = 4, 3, 5
    roots = rng.normal(size=(n, nz, nz + 1))
    return LinearQuadratic(
        *map(jnp.asarray, (roots @ roots.transpose(0, 2, 1), rng.normal(size=(n, nz)), rng.normal(size=(n, nx, nz)))),
        *map(jnp.asarray, (rng.normal(size=(n, nx)), np.eye(nx), rng.normal(size=nx))),
    )


def test_derivatives_pass_through_both_in_both_modes_alone_and_in_batches(x64):
    """Of a Riccati recursion, by finite differences and by each other."""
    dx0 = jnp.asarray([0.3, -0.2, 0.5])

    def cost(lq):
        found = riccati.solve(lq, dx0, 0.1)
        return jnp.sum(found.dus**2) + jnp.sum(found.costates**3)

    lanes = jax.tree.map(lambda *leaves: jnp.stack(leaves), *[lq_of(seed) for seed in range(3)])
    change = jax.tree.map(lambda leaf: 0.1 * jnp.cos(leaf), lanes)
    pulled = jax.jit(jax.vmap(jax.grad(cost)))(lanes)
    by_rows = sum(
        jnp.sum((p * c).reshape(3, -1), axis=1) for p, c in zip(*map(jax.tree.leaves, (pulled, change)), strict=True)
    )
    _, pushed = jax.jit(jax.vmap(lambda lq, by: jax.jvp(cost, (lq,), (by,))))(lanes, change)
    step = 1e-6
    ends = [jax.vmap(cost)(jax.tree.map(lambda a, b, s=s: a + s * step * b, lanes, change)) for s in (1.0, -1.0)]
    assert np.allclose(pushed, (ends[0] - ends[1]) / (2.0 * step), rtol=1e-6)
    assert np.allclose(pushed, by_rows, rtol=1e-10)
