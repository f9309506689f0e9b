"""The Riccati recursion against a dense solve of the optimality conditions."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from jaxlocomanip.solver.riccati import LinearQuadratic, solve

N, NX, NU = 7, 5, 3
NZ = NX + NU
solve_lq = jax.jit(solve)
solve_stationary = jax.jit(lambda lq, dx0, damping: solve(lq, dx0, damping, definite=False))


def random_lq(seed):
    rng = np.random.default_rng(seed)
    roots = rng.normal(size=(N, NZ, NZ + 2))
    final = rng.normal(size=(NX, 2))  # rank 2: only positive semidefinite
    return dict(
        hessian=roots @ roots.transpose(0, 2, 1) / NZ,
        gradient=rng.normal(size=(N, NZ)),
        dynamics=rng.normal(size=(N, NX, NZ)) / 2.0,
        defect=rng.normal(size=(N, NX)),
        final_hessian=final @ final.T,
        final_gradient=rng.normal(size=NX),
    ), rng.normal(size=NX)


def dense(lq, dx0, regularisation):
    """States, inputs and multipliers from one linear system; the first multiplier is that of dx_0 = dx0."""
    states, inputs = (N + 1) * NX, N * NU
    size = states + inputs
    H, g = np.zeros((size, size)), np.zeros(size)
    rows, right = np.zeros((states, size)), np.zeros(states)
    rows[:NX, :NX] = -np.eye(NX)
    right[:NX] = -dx0
    for k in range(N):
        z = np.r_[k * NX : (k + 1) * NX, states + k * NU : states + (k + 1) * NU]
        H[np.ix_(z, z)] += lq["hessian"][k]
        H[z[NX:], z[NX:]] += regularisation
        g[z] += lq["gradient"][k]
        following = slice((k + 1) * NX, (k + 2) * NX)
        rows[following, z] = lq["dynamics"][k]
        rows[following, following] -= np.eye(NX)
        right[following] = -lq["defect"][k]
    last = slice(N * NX, states)
    H[last, last] += lq["final_hessian"]
    g[last] += lq["final_gradient"]
    system = np.block([[H, rows.T], [rows, np.zeros((states, states))]])
    solution = np.linalg.solve(system, np.concatenate([-g, right]))
    xs, us, costates = np.split(solution, [states, size])
    return xs.reshape(N + 1, NX), us.reshape(N, NU), costates.reshape(N + 1, NX)


def arrays(lq, dtype):
    return LinearQuadratic(**{name: jnp.asarray(value, dtype) for name, value in lq.items()})


@pytest.mark.parametrize("seed", range(5))
@pytest.mark.parametrize("regularisation", [0.0, 0.5])
def test_agrees_with_a_dense_solve(x64, seed, regularisation):
    lq, dx0 = random_lq(seed)
    found = solve_lq(arrays(lq, jnp.float64), jnp.asarray(dx0), regularisation)
    xs, us, costates = dense(lq, dx0, regularisation)
    assert np.allclose(found.dxs, xs, rtol=0.0, atol=1e-9 * np.abs(xs).max())
    assert np.allclose(found.dus, us, rtol=0.0, atol=1e-9 * np.abs(us).max())
    assert np.allclose(found.costates, costates, rtol=0.0, atol=1e-9 * np.abs(costates).max())


@pytest.mark.parametrize("seed", range(5))
def test_stationary_point_of_an_indefinite_subproblem(x64, seed):
    lq, dx0 = random_lq(seed)
    lq["hessian"] = lq["hessian"] - 0.8 * np.eye(NZ)
    assert (np.linalg.eigvalsh(lq["hessian"][:, NX:, NX:]).min(axis=1) < 0.0).any()
    found = solve_stationary(arrays(lq, jnp.float64), jnp.asarray(dx0), 0.0)
    xs, us, costates = dense(lq, dx0, 0.0)
    assert np.allclose(found.dxs, xs, rtol=0.0, atol=1e-8 * np.abs(xs).max())
    assert np.allclose(found.dus, us, rtol=0.0, atol=1e-8 * np.abs(us).max())
    assert np.allclose(found.costates, costates, rtol=0.0, atol=1e-8 * np.abs(costates).max())


@pytest.mark.parametrize("seed", range(5))
def test_single_precision(seed):
    lq, dx0 = random_lq(seed)
    found = solve_lq(arrays(lq, jnp.float32), jnp.asarray(dx0, jnp.float32), 0.0)
    xs, us, costates = dense(lq, dx0, 0.0)
    assert found.dxs.dtype == found.dus.dtype == found.costates.dtype == jnp.float32
    assert np.allclose(found.dxs, xs, rtol=0.0, atol=1e-3 * np.abs(xs).max())
    assert np.allclose(found.dus, us, rtol=0.0, atol=1e-3 * np.abs(us).max())
    assert np.allclose(found.costates, costates, rtol=0.0, atol=1e-3 * np.abs(costates).max())


def test_feedback_is_the_slope_of_the_inputs(x64):
    lq, dx0 = random_lq(9)
    change = np.random.default_rng(0).normal(size=NX)
    here = solve_lq(arrays(lq, jnp.float64), jnp.asarray(dx0), 0.0)
    there = solve_lq(arrays(lq, jnp.float64), jnp.asarray(dx0 + change), 0.0)
    moved = np.einsum("kij,kj->ki", here.feedback, (there.dxs - here.dxs)[:-1])
    assert np.allclose(there.dus - here.dus, moved, rtol=0.0, atol=1e-10)


def test_nothing_to_do(x64):
    lq, dx0 = random_lq(10)
    still = lq | {name: 0.0 * lq[name] for name in ("gradient", "defect", "final_gradient")}
    found = solve_lq(arrays(still, jnp.float64), jnp.asarray(0.0 * dx0), 0.0)
    assert all(np.abs(part).max() == 0.0 for part in (found.dxs, found.dus, found.costates))
