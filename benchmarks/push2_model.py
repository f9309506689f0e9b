"""All stages of `push2` at once, their derivatives written out: the problem as one who wants it fast would give it.

Arrays have their components first, then stages, then lanes if there are any. What several results need is computed
apart from them.
"""

from __future__ import annotations

import jax.numpy as jnp
from jax import Array

from benchmarks import push2
from benchmarks.push2 import BARRIERS, BOUNDS, DT, INERTIA, MASS, NX, NZ, Push2, barrier
from jaxlocomanip.numerics import apart, pytree, sine_and_cosine
from jaxlocomanip.planar.vector import Vector
from jaxlocomanip.solver.layout import added, lanes_last, stages_inside
from jaxlocomanip.solver.ocp import Plan, StageModel

OBSTACLES, CONDITIONS = 2, 6


@pytree
class FastPush2(Push2):
    """The same problem; implements `solver.ocp.WholeHorizon`."""

    def values(self, plan: Plan) -> tuple[Array, Array]:
        """Cost and next state of all stages."""
        return _values(self, plan)

    def models(self, plan: Plan) -> StageModel:
        """Gauss-Newton models of all stages, leaves [N, ...]; equal to `model` of each."""
        return _models(self, plan)


def _components(problem: Push2, plan: Plan) -> tuple[Array, Array, Array]:
    """z [12, N, ...], the reference [6, N, ...] and the obstacles' places [2, 2, 1, ...]."""
    z = jnp.concatenate([plan.xs[:-1], plan.us], axis=1)
    return stages_inside(z), stages_inside(problem.stages), problem.places[:, :, None]


@lanes_last
def _values(problem: Push2, plan: Plan) -> tuple[Array, Array]:
    cost, *following = _evaluated(*_components(problem, plan))
    return cost, jnp.stack(following, axis=1)


@apart
def _evaluated(z: Array, reference: Array, places: Array) -> tuple[Array, ...]:
    """Cost [N, ...] of every stage, and the components [N, ...] of the next states."""
    weights = DT * push2.STAGE.reshape(NZ, *[1] * (z.ndim - 1))
    track = 0.5 * weights * push2.error(z, reference) ** 2
    room = barrier(push2.bounds(z), DT * BOUNDS[0], BOUNDS[1]).value
    clear = [barrier(h, DT * BARRIERS[0], BARRIERS[1]).value for h in push2.conditions(z, places)]
    return added([*track, *room, *clear]), *push2.step(z)


@lanes_last
def _models(problem: Push2, plan: Plan) -> StageModel:
    z, reference, places = _components(problem, plan)
    cost, *following = _evaluated(z, reference, places)
    turned = _turned(z)
    rows, h = _rows(z, places, *turned[0])
    slope, scaled, diagonal = _weighed(z, reference, h, rows)
    return StageModel(
        hessian=_hessian(diagonal, scaled, rows),
        gradient=slope,
        dynamics=_dynamics(z, turned),
        next_state=jnp.stack(following, axis=1),
        cost=cost,
    )


@apart
def _turned(z: Array) -> list[tuple[Vector, Vector]]:
    """Unit vectors along the body's x axis, and accelerations by the heading, at the four points of a step."""
    force = Vector(z[8] / MASS, z[9] / MASS)
    points = []
    for heading in _headings(z):
        sine, cosine = sine_and_cosine(heading)
        axis = Vector(cosine, sine)
        points.append((axis, force.rotated(axis).turned))
    return points


def _headings(z: Array) -> tuple[Array, ...]:
    theta, omega = z[2], z[5]
    now = -(z[6] * z[8] + z[7] * z[9] + push2.HELD[2]) / INERTIA
    halfway = now - DT / 2 * (z[10] * z[8] + z[11] * z[9]) / INERTIA
    half = theta + DT / 2 * omega
    return theta, half, half + DT**2 / 4 * now, theta + DT * omega + DT**2 / 2 * halfway


@apart
def _by_heading(turned: list[tuple[Vector, Vector]]) -> list[list[Array]]:
    """Derivatives of the next velocity and position by what the four headings are made of.

    The angular acceleration is linear in time, so that it acts through its values at the start and halfway.
    """
    t1, t2, t3, t4 = (by_heading for _, by_heading in turned)
    (r1, _), (r2, _), (r3, _), (r4, _) = turned
    speed = [(t1 + (t2 + t3) * 2.0 + t4) * (DT / 6), (t2 + t3 + t4) * (DT**2 / 6), t3 * (DT**3 / 12), t4 * (DT**3 / 12)]
    place = [(t1 + t2 + t3) * (DT**2 / 6), (t2 + t3) * (DT**3 / 12), t3 * (DT**4 / 24)]
    push = (r1 + (r2 + r3) * 2.0 + r4) * (DT / 6 / MASS), (r1 + r2 + r3) * (DT**2 / 6 / MASS)
    return [[v.x, v.y] for v in (*speed, *place, *push)]


def _dynamics(z: Array, turned: list[tuple[Vector, Vector]]) -> Array:
    """Jacobian [N, nx, nz, ...] of the step."""
    entries = jnp.swapaxes(jnp.stack(_entries(z, _by_heading(turned))), 0, 1)
    return entries.reshape(z.shape[1], NX, NZ, *z.shape[2:])


@apart
def _entries(z: Array, parts: list[list[Array]]) -> list[Array]:
    """Entries [N, ...] of the dynamics' Jacobian, row by row."""
    none = jnp.zeros_like(z[0])
    v_theta, v_omega, v_start, v_half, p_theta, p_omega, p_start, v_push, p_push = parts
    d1, d2, f1, f2, rate1, rate2 = z[6:]

    def turning(time: float) -> list[Array]:
        """Angular acceleration by d, f and d's rate."""
        return [-f1, -f2, -(d1 + time * rate1), -(d2 + time * rate2), -time * f1, -time * f2]

    start, half = ([a / INERTIA for a in turning(t)] for t in (0.0, DT / 2))

    def pushed(along: list[list[Array]], axis: int) -> list[Array]:
        """By d, f and d's rate, of what depends on the angular acceleration at the start and halfway."""
        return [added([c[axis] * a[i] for c, a in zip(along, (start, half), strict=False)]) for i in range(6)]

    def direct(entries: list[Array], push: list[Array], axis: int) -> list[Array]:
        first, other = (push[0], -push[1]) if axis == 0 else (push[1], push[0])
        return [*entries[:2], entries[2] + first, entries[3] + other, *entries[4:]]

    rows = []
    for axis in range(2):
        by = direct(pushed([p_start], axis), p_push, axis)
        rows.append([none + 1.0 - axis, none + axis, p_theta[axis], none + DT * (1 - axis), none + DT * axis])
        rows[-1] += [p_omega[axis], *by]
    arc = [DT**2 / 6 * (a + 2.0 * b) for a, b in zip(start, half, strict=True)]
    rows.append([none, none, none + 1.0, none, none, none + DT, *arc])
    for axis in range(2):
        by = direct(pushed([v_start, v_half], axis), v_push, axis)
        rows.append([none, none, v_theta[axis], none + 1.0 - axis, none + axis, v_omega[axis], *by])
    rows.append([none, none, none, none, none, none + 1.0, *[DT * a for a in half]])
    for i in range(2):
        slid = [none + float(i == j) for j in range(2)]
        rows.append([none] * 6 + slid + [none] * 2 + [DT * s for s in slid])
    return [entry for row in rows for entry in row]


@apart
def _discs(z: Array, places: Array, axis: Vector, by_heading: Vector) -> list[list[Array]]:
    """Conditions [N, ...], and their derivatives that are not zero."""
    p, v, omega = Vector(z[0], z[1]), Vector(z[3], z[4]), z[5]
    force = Vector(z[8] / MASS, z[9] / MASS)
    pull = force.rotated(axis)
    pull = Vector(pull.x - push2.HELD[0] / MASS, pull.y - push2.HELD[1] / MASS)
    found = []
    for place in places:
        normal, curvature, room = _seen(p, place, 1.0)
        closing, passing, across = normal.dot(v), normal.cross(v), normal.cross(pull)
        bend = curvature * passing
        sideways = curvature * (across + 4.0 * passing - 2.0 * closing * bend)
        by_place = normal * (4.0 - bend * bend) + normal.turned * sideways
        by_speed = normal * 4.0 + normal.turned * (2.0 * bend)
        h = normal.dot(pull) + passing * bend + 4.0 * closing + 4.0 * room
        by_push = normal.dot(axis) / MASS, normal.dot(axis.turned) / MASS
        found.append([h, by_place.x, by_place.y, normal.dot(by_heading), by_speed.x, by_speed.y, *by_push])
    for place in places:
        for forward, along, d, rate in ((axis, axis.turned, z[6], z[10]), (axis.turned, axis * -1.0, z[7], z[11])):
            arm = forward * -0.6 + along * d
            normal, curvature, room = _seen(p + arm, place, 0.9)
            speed = v + arm.turned * omega + along * rate
            by_place = normal * 4.0 + normal.turned * (curvature * normal.cross(speed))
            by_theta = by_place.dot(arm.turned) - omega * normal.dot(arm) + rate * normal.dot(along.turned)
            by_offset = by_place.dot(along) + omega * normal.dot(along.turned)
            h = normal.dot(speed) + 4.0 * room
            by_speed = normal.x, normal.y, normal.dot(arm.turned)
            found.append([h, by_place.x, by_place.y, by_theta, *by_speed, by_offset, normal.dot(along)])
    return found


def _seen(center: Vector, place: Array, radius: float) -> tuple[Vector, Array, Array]:
    """Normal, curvature 1/m and room m between a centre and an obstacle."""
    away = center - Vector(place[0], place[1])
    distance = jnp.sqrt(away.dot(away))
    return away * (1.0 / distance), 1.0 / distance, distance - radius


def _rows(z: Array, places: Array, axis: Vector, by_heading: Vector) -> tuple[Array, Array]:
    """Jacobian [6, N, nz, ...] and values [6, N, ...] of the conditions."""
    found = _discs(z, places, axis, by_heading)
    none = jnp.zeros_like(z[0])
    rows = []
    for k, (_, *entries) in enumerate(found):
        if k < OBSTACLES:
            px, py, theta, vx, vy, first, other = entries
            full = [px, py, theta, vx, vy, none, none, none, first, other, none, none]
        else:
            px, py, theta, vx, vy, omega, offset, rate = entries
            own = [[none, value] if k % 2 else [value, none] for value in (offset, rate)]
            full = [px, py, theta, vx, vy, omega, *own[0], none, none, *own[1]]
        rows.append(jnp.stack(full))
    return jnp.swapaxes(jnp.stack(rows), 1, 2), jnp.stack([values[0] for values in found])


@apart
def _weighed(z: Array, reference: Array, h: Array, rows: Array) -> tuple[Array, Array, Array]:
    """Gradient [N, nz, ...], the rows times their curvatures, and the diagonal [N, nz, ...] of the other terms."""
    penalty = barrier(h, DT * BARRIERS[0], BARRIERS[1])
    weights = DT * push2.STAGE.reshape(NZ, *[1] * (z.ndim - 1))
    room = barrier(push2.bounds(z), DT * BOUNDS[0], BOUNDS[1])
    none = jnp.zeros_like(z[:6])
    diagonal = weights + jnp.concatenate([none, room.curvature[:6] + room.curvature[6:]])
    gradient = weights * push2.error(z, reference) + jnp.concatenate([none, room.slope[:6] - room.slope[6:]])
    gradient = jnp.swapaxes(gradient, 0, 1) + added([penalty.slope[k][:, None] * rows[k] for k in range(CONDITIONS)])
    return gradient, penalty.curvature[:, :, None] * rows, jnp.swapaxes(diagonal, 0, 1)


@apart
def _hessian(diagonal: Array, scaled: Array, rows: Array) -> Array:
    """Gauss-Newton Hessian [N, nz, nz, ...]."""
    eye = jnp.eye(NZ, dtype=rows.dtype).reshape(NZ, NZ, *[1] * (diagonal.ndim - 2))
    return eye * diagonal[:, :, None] + added([scaled[k][:, :, None] * rows[k][:, None] for k in range(CONDITIONS)])
