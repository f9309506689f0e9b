"""The projection against a search, the solver against Clarabel on problems recorded from walking and pushing."""

import itertools

import asked
import jax
import jax.numpy as jnp
import numpy as np
import pytest
from flat_ground import Box, FlatGround

from jaxlocomanip.locomotion import controller, qp

RNG = np.random.default_rng(5)
MU, HIGH = 0.5, 200.0
assembled = jax.jit(controller.force_problem)
solve = jax.jit(qp.solve, static_argnames="iterations")
RECORDED = (
    ("aliengo", asked.walk((0.1, 0.5, 0.0, 0.0)), None, 1.5),
    ("go1", asked.walk((0.1, 0.3, 0.2, 0.5)), None, 1.5),
    ("aliengo", asked.push(62.8, begin=0.1), Box(mass=16.0), 2.5),
    ("a1", asked.push(31.4, begin=0.1), Box(mass=8.0), 2.0),
)


def test_projection_is_idempotent_feasible_and_nearest():
    points = RNG.normal(size=(200, 3)).astype(np.float32) * [150.0, 150.0, 200.0]
    low, high = jnp.zeros(200), jnp.full(200, HIGH)
    found = np.asarray(qp.project(jnp.asarray(points, jnp.float32), MU, low, high))
    assert (found[:, 2] >= 0.0).all() and (found[:, 2] <= HIGH).all()
    assert (np.abs(found[:, :2]) <= MU * found[:, 2:] + 1e-4).all()
    assert np.asarray(qp.project(jnp.asarray(found), MU, low, high)) == pytest.approx(found, abs=1e-3)
    normal = np.linspace(0.0, HIGH, 20_001)  # for a given normal force the nearest tangential one is a clip
    for point, nearest in zip(points, found, strict=True):
        side = np.clip(point[:2], -MU * normal[:, None], MU * normal[:, None])
        distance = np.hypot(np.linalg.norm(side - point[:2], axis=1), normal - point[2])
        assert np.linalg.norm(nearest - point) <= distance.min() + 1e-3


def record(robots, gains):
    """A problem every 0.175 s of the recorded motions; the interval avoids meeting the same phase again."""
    problems = []
    for name, ask, box, duration in RECORDED:
        ground = FlatGround(name, gains[name], box)
        count = itertools.count()

        def listening(ground, body, time, ask=ask, count=count, name=name):
            wanted = ask(ground, body, time)
            if time >= ground.next_solve - 1e-9 and next(count) % 7 == 3:
                problems.append(assembled(ground.state, robots[name], gains[name], body, wanted, np.float32(time)))
            return wanted

        ground.run(duration, listening)
    return problems


def exact(problem):
    """[N, 4, 3] N, the solution by Clarabel in double precision, swinging feet left out."""
    clarabel = pytest.importorskip("clarabel")
    from scipy import sparse

    p = jax.tree.map(lambda leaf: np.asarray(leaf, float), problem)
    steps = len(p.response)
    w, s = np.zeros((6 * steps, 12 * steps)), np.zeros((6 * steps, 6 * steps))
    for k in range(steps):
        w[6 * k : 6 * k + 6, 12 * k : 12 * k + 12] = p.response[k]
    for axis in range(6):
        rows = range(axis, 6 * steps, 6)
        s[np.ix_(rows, rows)] = np.linalg.inv(0.5 * (p.compliance[axis] + p.compliance[axis].T))
    hessian = w.T @ s @ w + p.force_weight * np.eye(12 * steps)
    gradient = -w.T @ s @ p.wanted.ravel() - p.force_weight * p.reference.ravel()

    feet = np.flatnonzero(p.high.ravel() > 0.0)
    kept = (3 * feet[:, None] + np.arange(3)).ravel()
    mu, count = float(p.friction), len(feet)
    one = np.array([[1, 0, -mu], [-1, 0, -mu], [0, 1, -mu], [0, -1, -mu], [0, 0, 1], [0, 0, -1]])
    bounds = np.stack([[0.0] * 4 + [high, 0.0] for high in p.high.ravel()[feet]])
    settings = clarabel.DefaultSettings()
    settings.verbose = False
    scale = 1.0 / np.abs(hessian).max()
    solution = clarabel.DefaultSolver(
        sparse.csc_matrix(np.triu(scale * hessian[np.ix_(kept, kept)])),
        scale * gradient[kept],
        sparse.csc_matrix(np.kron(np.eye(count), one)),
        bounds.ravel(),
        [clarabel.NonnegativeConeT(6 * count)],
        settings,
    ).solve()
    assert str(solution.status) == "Solved"
    forces = np.zeros(12 * steps)
    forces[kept] = solution.x
    return forces.reshape(steps, 4, 3)


def test_recorded_problems_against_clarabel(robots, gains):
    pytest.importorskip("clarabel")
    problems = record(robots, gains)
    assert len(problems) >= 35
    settings = gains["aliengo"].forces
    errors, converged, active = [], [], []
    for problem in problems:
        best = exact(problem)
        for iterations, into in ((settings.iterations, errors), (300, converged)):
            found = np.asarray(solve(problem, settings.penalty, iterations=iterations))
            into.append(np.abs(found - best)[0].max())
        bound = float(problem.friction) * best[..., 2:]
        active.append((np.abs(best[..., :2]) > bound - 0.1)[best[..., 2] > 1.0].mean())
    assert max(active) > 0.05  # the friction cone matters in some of them
    # N, of forces of about 100: five times what is found (0.0015 and 0.032).
    assert np.median(errors) < 0.008 and np.quantile(errors, 0.95) < 0.16
    assert max(converged) < 0.17  # what single precision leaves, five times


def test_forces_are_feasible_at_any_iteration_and_swinging_feet_have_none(robots, gains):
    ground = FlatGround("aliengo", gains["aliengo"])
    ground.run(0.9, asked.walk((0.1, 1.0, 0.0, 0.0)))
    wanted = asked.walk((0.1, 1.0, 0.0, 0.0))(ground, ground.measure(), 0.9)
    problem = assembled(ground.state, ground.robot, ground.settings, ground.measure(), wanted, np.float32(0.9))
    swinging = np.asarray(problem.high) == 0.0
    assert swinging.any() and not swinging.all()
    for iterations in (1, 3, 20):
        forces = np.asarray(solve(problem, 5.0, iterations=iterations))
        assert (forces[swinging] == 0.0).all()
        assert (np.abs(forces[..., :2]) <= float(problem.friction) * forces[..., 2:] + 1e-4).all()


def test_a_batch_equals_its_members(robots, gains):
    problems = record(robots, gains)[:4]
    together = jax.vmap(lambda p: qp.solve(p, 5.0, 20))(jax.tree.map(lambda *x: jnp.stack(x), *problems))
    for one, problem in zip(together, problems, strict=True):
        assert np.asarray(one) == pytest.approx(np.asarray(solve(problem, 5.0, iterations=20)), abs=1e-3)
