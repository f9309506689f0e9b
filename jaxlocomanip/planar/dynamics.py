"""Rigid-body mechanics in SE(2) of an object on a floor, seen from an arbitrary body point p.

Generalised coordinates q = [p_x, p_y, theta]; the centre of mass lies at rho = R(theta) com from p. Equations of motion
(paper, "Object dynamics"; the rotation corrected as DESIGN notes):

    H(q) qdd + C(q, qd) qd + f_k(q, qd) = tau,   tau = [R sum_i f_i n_i, sum_i r_i x f_i n_i]

Ground friction f_k follows an ellipsoidal limit surface in the twist at the centre of mass,

    f_c = -A V / sqrt(V' A V),   V = [v_c, omega],   A = diag(F_c^2, F_c^2, M_c^2),

so that translation and torsion share one friction budget: a sliding object is easy to turn. Its time step is implicit
(the minimiser of kinetic distance plus dissipation), stable for any step and exact about sticking.
"""

from __future__ import annotations

from collections.abc import Callable

import jax
import jax.numpy as jnp
from jax import Array

from jaxlocomanip.numerics import Floats, pytree, tiny
from jaxlocomanip.planar import friction
from jaxlocomanip.planar.geometry import cross, perpendicular, rotate
from jaxlocomanip.planar.vector import Vector, unit, vector

VectorField = Callable[[Array], Array]
"""x [n] -> its time derivative [n], or [n, m] for the columns of an input map."""

GRAVITY = 9.81
"""Acceleration of gravity, m/s^2."""


@pytree
class Body:
    """Planar rigid body with Coulomb friction on the floor."""

    mass: Array
    """[] kg, > 0"""
    inertia: Array
    """[] kg m^2 about p (not about the centre of mass), > mass |com|^2"""
    com: Array
    """[2] m, centre of mass relative to p in the body frame"""
    friction_force: Array
    """[] N, sliding friction F_c = mu m g"""
    friction_moment: Array
    """[] N m, torsional friction M_c when turning on the spot"""

    @property
    def central_inertia(self) -> Array:
        """[] kg m^2 about the centre of mass, floored at 5 % of the inertia about p."""
        return jnp.maximum(self.inertia - self.mass * jnp.sum(self.com**2, axis=0), 0.05 * self.inertia)


def mass_matrix(body: Body, theta: Array) -> Array:
    """H(q) [3, 3] about p."""
    x, y = body.mass * rotate(theta, body.com)
    m, zero = body.mass, jnp.zeros_like(x)
    return jnp.array([[m, zero, -y], [zero, m, x], [-y, x, body.inertia]])


def coriolis_matrix(body: Body, theta: Array, omega: Array) -> Array:
    """C(q, qd) [3, 3] about p; Hdot - 2 C is skew-symmetric."""
    x, y = body.mass * rotate(theta, body.com)
    zero = jnp.zeros_like(x)
    return jnp.array([[zero, zero, -omega * x], [zero, zero, -omega * y], [zero, zero, zero]])


def to_com(body: Body, theta: Array, twist: Array) -> Array:
    """Twist [v, omega] [3] at p, moved to the centre of mass."""
    return twist.at[:2].add(twist[2] * perpendicular(rotate(theta, body.com)))


def from_com(body: Body, theta: Array, twist: Array) -> Array:
    """Twist [v, omega] [3] at the centre of mass, moved to p."""
    return twist.at[:2].add(-twist[2] * perpendicular(rotate(theta, body.com)))


def friction_wrench(body: Body, theta: Array, twist: Array, smoothing: Floats) -> Array:
    """f_k [3, ...]: the wrench about p that sliding friction resists the motion with (H qdd + ... + f_k = tau).

    Args:
      body: the object.
      theta: [...] rad.
      twist: [3, ...] velocity of p and omega.
      smoothing: m/s, speed below which friction fades to zero.
    """
    arm = vector(body.com).rotated(unit(theta))
    v, omega = vector(twist) + arm.turned * twist[2], twist[2]
    slide, turn = body.friction_force**2, body.friction_moment**2
    power = slide * v.dot(v) + turn * omega * omega + (smoothing * body.friction_force) ** 2
    scale = 1.0 / jnp.sqrt(power + tiny(power.dtype))
    force = v * (slide * scale)
    return jnp.stack([force.x, force.y, turn * omega * scale + arm.cross(force)])


def acceleration(body: Body, theta: Array, twist: Array, wrench: Array, smoothing: Floats) -> Array:
    """qdd [3] from the equations of motion, with smoothed friction."""
    rest = wrench - friction_wrench(body, theta, twist, smoothing)
    rest = rest - coriolis_matrix(body, theta, twist[2]) @ twist
    return jnp.linalg.solve(mass_matrix(body, theta), rest)


def contact_wrench(theta: Array, points: Array, normals: Array, forces: Array) -> Array:
    """tau [3] about p of frictionless pushes.

    Args:
      theta: [] rad.
      points: [N_r, 2] m, contact points in the body frame.
      normals: [N_r, 2] unit push directions (into the object) in the body frame.
      forces: [N_r] N, >= 0.
    """
    total = forces @ normals
    moment = jnp.sum(forces * cross(points, normals))
    return jnp.concatenate([rotate(theta, total), moment[None]])


def body_wrench(points: Array, normals: Array, forces: Array) -> Array:
    """[3] wrench about p in body axes of frictionless pushes; arguments as in `contact_wrench`."""
    moment = jnp.sum(forces * cross(points, normals))
    return jnp.concatenate([forces @ normals, moment[None]])


def step(body: Body, pose: Array, twist: Array, wrench_B: Array, h: Floats, smoothing: Floats) -> tuple[Array, Array]:
    """One implicit time step of the object under a wrench that turns with it.

    The centre of mass moves as a free particle under the wrench, then friction takes the step
    V+ = argmin 1/2 (V - V_free)' M (V - V_free) + h sqrt(V' A V); the pose follows with the mean velocity. Of
    second order in h without friction, of first order with it.

    Args:
      body: the object.
      pose: q [3, ...], m and rad; the axes after the first count steps that are taken side by side.
      twist: qd [3, ...] at p, m/s and rad/s.
      wrench_B: [3, ...] about p in body axes, N and N m, constant over the step.
      h: time step, s.
      smoothing: m/s, width of the smoothed transition between sticking and sliding (0: exact sticking).

    Returns:
      (pose [3, ...], twist [3, ...]) after the step.
    """
    state = State(vector(pose), pose[2], vector(twist), twist[2])
    after = advance(body, state, vector(wrench_B), wrench_B[2], h, smoothing)
    where, velocity = after.position, after.velocity
    return jnp.stack([where.x, where.y, after.heading]), jnp.stack([velocity.x, velocity.y, after.omega])


@pytree
class State:
    """Pose and twist of the object's body point, component by component; leaves [...]."""

    position: Vector
    """m"""
    heading: Array
    """rad"""
    velocity: Vector
    """m/s"""
    omega: Array
    """rad/s"""


def _drops(body: Body, h: Floats) -> friction.Drops:
    inertia = body.mass, body.mass, body.central_inertia
    return friction.drops(inertia, body.friction_force, body.friction_moment, h)


def advance(body: Body, state: State, force_B: Vector, moment: Array, h: Floats, smoothing: Floats) -> State:
    """`step`, component by component: states, forces [...] N and moments [...] N m about p, in body axes."""
    com, omega, central = vector(body.com), state.omega, body.central_inertia
    arm = com.rotated(unit(state.heading))
    force = force_B.rotated(unit(state.heading + 0.5 * h * omega))
    old = state.velocity + arm.turned * omega
    free = old + force * (h / body.mass)
    spun = omega + h / central * (moment - com.cross(force_B))
    vx, vy, spin = friction.slowed((free.x, free.y, spun), _drops(body, h), smoothing)
    new = Vector(vx, vy)
    heading = state.heading + 0.5 * h * (omega + spin)
    later = com.rotated(unit(heading))
    place = state.position + arm + (old + new) * (0.5 * h) - later
    return State(place, heading, new - later.turned * spin, spin)


def advance_slopes(
    body: Body, state: State, force_B: Vector, moment: Array, h: Floats, smoothing: Floats
) -> tuple[State, list[State]]:
    """`advance`, and its derivatives by theta, v_x, v_y, omega, and the wrench's three components in body axes."""
    com, omega, central = vector(body.com), state.omega, body.central_inertia
    arm, middle = com.rotated(unit(state.heading)), unit(state.heading + 0.5 * h * omega)
    force = force_B.rotated(middle)
    old = state.velocity + arm.turned * omega
    push, twist = h / body.mass, h / central
    free = old + force * push
    spun = omega + twist * (moment - com.cross(force_B))
    new, slowing = friction.slowing((free.x, free.y, spun), _drops(body, h), smoothing)
    heading = state.heading + 0.5 * h * (omega + new[2])
    later = com.rotated(unit(heading))
    place = state.position + arm + (old + Vector(new[0], new[1])) * (0.5 * h) - later
    after = State(place, heading, Vector(new[0], new[1]) - later.turned * new[2], new[2])
    one, none = jnp.ones_like(omega), jnp.zeros_like(omega)
    still = Vector(none, none)

    def composed(turn: Array, drift: Vector, spin: Array, pushed: Vector, spun: Array) -> State:
        """The end's derivative, from those of heading, old velocity and omega, and what the wrench adds to these."""
        free, whirl = drift + pushed, spin + spun
        x, y, end = slowing(free.x, free.y, whirl)
        later_turn = turn + (spin + end) * (0.5 * h)
        move = arm.turned * turn + (drift + Vector(x, y)) * (0.5 * h) - later.turned * later_turn
        velocity = Vector(x, y) + later * (new[2] * later_turn) - later.turned * end
        return State(move, later_turn, velocity, end)

    return after, [
        composed(one, arm * (-omega), none, force.turned * push, none),
        composed(none, Vector(one, none), none, still, none),
        composed(none, Vector(none, one), none, still, none),
        composed(none, arm.turned, one, force.turned * (0.5 * h * push), none),
        composed(none, still, none, middle * push, com.y * twist * one),
        composed(none, still, none, middle.turned * push, -com.x * twist * one),
        composed(none, still, none, still, twist * one),
    ]


def friction_step(inertia: Array, force: Array, moment: Array, free: Array, h: Floats, smoothing: Floats) -> Array:
    """Velocity [3, ...] at the centre of mass after friction acted for `h` on the free velocity [3, ...].

    See `friction.slowed`.

    Args:
      inertia: [3] diagonal inertia at the centre of mass.
      force: [] F_c, N.
      moment: [] M_c, N m.
      free: [3, ...] velocity without friction.
      h: time step, s.
      smoothing: m/s, width of the smoothed transition to rest in s.
    """
    velocity, drop = (free[0], free[1], free[2]), friction.drops(inertia, force, moment, h)
    return jnp.stack(friction.slowed(velocity, drop, smoothing))


def control_affine(
    body: Body, origins: Array, tangents: Array, normals: Array, smoothing: Floats
) -> tuple[VectorField, VectorField]:
    """The system as xd = f(x) + g(x) u with x = [q, qd, d] and u = [F_r, ddot] (paper, "Object dynamics").

    Args:
      body: the object.
      origins: [N_r, 2] contact points at zero offset, body frame.
      tangents: [N_r, 2] directions of positive offset.
      normals: [N_r, 2] push directions.
      smoothing: m/s, smoothing of ground friction at rest.

    Returns:
      f: x [6 + N_r] -> [6 + N_r], and g: x -> [6 + N_r, 2 N_r].
    """
    n = origins.shape[0]

    def drift(x: Array) -> Array:
        free = acceleration(body, x[2], x[3:6], jnp.zeros(3, x.dtype), smoothing)
        return jnp.concatenate([x[3:6], free, jnp.zeros(n, x.dtype)])

    def input_map(x: Array) -> Array:
        points = origins + x[6:, None] * tangents
        basis = jnp.eye(n, dtype=x.dtype)
        wrenches = jax.vmap(lambda f: contact_wrench(x[2], points, normals, f))(basis)
        pushes = jnp.linalg.solve(mass_matrix(body, x[2]), wrenches.T)
        top = jnp.concatenate([jnp.zeros((3, n), x.dtype), pushes, jnp.zeros((n, n), x.dtype)])
        slides = jnp.concatenate([jnp.zeros((6, n), x.dtype), basis])
        return jnp.concatenate([top, slides], axis=1)

    return drift, input_map


def lie_derivative(function: Callable[[Array], Array], field: VectorField) -> Callable[[Array], Array]:
    """L_f h: the derivative of `function` along a vector field, by forward differentiation."""
    return lambda x: jax.jvp(function, (x,), (field(x),))[1]
