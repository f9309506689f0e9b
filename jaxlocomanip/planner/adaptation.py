"""Adaptation of the object's parameters Psi = [m, I, m c_x, m c_y, F_c, M_c] (paper, "Adaptive controller").

Two laws share gain, projection and low-pass:

* *paper*: Psi_dot = -Gamma Y(q, qd, qd_r, qdd_r)' s with the composite error s = qd_e + lambda q_e against the
  reference. It drifts whenever an obstacle forces a detour, and learns nothing about friction at rest, where Y = 0.
* *prediction*: the same with s measured against the model's own prediction for this tick, and Y replaced by its exact
  sensitivity -M d(qdd)/d(Psi) through the implicit friction step. Stiction is then learnt like anything else: while the
  prediction moves and the object does not, the estimate of F_c rises.

An object at rest shows no more than that the floor holds it against what is pushed. That would be explained as well by
a centre of mass straight ahead of whoever pushes, so the second law lets both friction limits rise in proportion while
the object is at rest, to a little more than the push, and learns nothing else.
"""

from __future__ import annotations

from collections.abc import Callable

import jax
import jax.numpy as jnp
from jax import Array

from jaxlocomanip.numerics import Floats, pytree
from jaxlocomanip.planar import dynamics, regressor
from jaxlocomanip.planar.dynamics import GRAVITY, Body
from jaxlocomanip.planner.config import Adaptation
from jaxlocomanip.scenario import ObjectModel

BEYOND = 1.25
"""times the push that does not move an object, which its friction is believed to be at most; if it were not a little
more, nobody would push harder"""


@pytree
class ParameterEstimate:
    """Current estimate of the object's parameters."""

    psi: Array
    """[6] what the adaptation law integrates"""
    filtered: Array
    """[6] after the low-pass: what prediction and planning use"""

    @property
    def body(self) -> Body:
        """The rigid body that the planner reckons with."""
        return regressor.to_body(self.filtered)


def start(model: ObjectModel, settings: Adaptation) -> ParameterEstimate:
    """The belief of the scenario, with the prior friction where none is stated."""
    prior = settings.prior_friction * model.body.mass * GRAVITY
    force = jnp.where(model.friction_known, model.body.friction_force, prior)
    body = Body(model.body.mass, model.body.inertia, model.body.com, force, force * model.torsion_radius)
    psi = regressor.from_body(body)
    return ParameterEstimate(psi, psi)


def project(psi: Array, model: ObjectModel, settings: Adaptation) -> Array:
    """Psi [6] moved into the box of what such an object can be; mass and inertia stay positive."""
    belief, span = model.body, settings.mass_range
    mass = jnp.clip(psi[0], belief.mass / span, belief.mass * span)
    reach = 0.4 * jnp.max(jnp.sqrt(jnp.sum(model.vertices**2, axis=-1)))
    inertia = jnp.clip(psi[1], belief.inertia / span, belief.inertia * span)
    moment = jnp.clip(psi[2:4], -reach * mass, reach * mass)
    limit = settings.max_friction * belief.mass * span * GRAVITY
    force = jnp.clip(psi[4], 0.0, limit)
    torsion = jnp.clip(psi[5], 0.4 * force * model.torsion_radius, 2.0 * force * model.torsion_radius)
    return jnp.concatenate([mass[None], inertia[None], moment, force[None], torsion[None]])


def predict(
    psi: Array, pose: Array, twist: Array, wrench_B: Array, tick: Floats, smoothing: Floats
) -> tuple[Array, Array, Callable[[Array], Array]]:
    """Pose and twist one tick ahead, and what a prediction error says of the parameters.

    Args:
      psi: [6] parameters.
      pose: [3] estimate at the start of the tick.
      twist: [3] likewise.
      wrench_B: [3] wrench over the tick, body axes.
      tick: s.
      smoothing: m/s, of friction at rest.

    Returns:
      pose [3], twist [3], and the function from the composite error s [3] (observed minus predicted) to Y' s [6] of the
      prediction law, minus the gradient of s' M qdd_predicted by Psi.
    """

    def step(p: Array) -> tuple[Array, Array]:
        new_pose, new_twist = dynamics.step(regressor.to_body(p), pose, twist, wrench_B, tick, smoothing)
        return new_twist, new_pose

    new_twist, pullback, new_pose = jax.vjp(step, psi, has_aux=True)

    def slope(error: Array) -> Array:
        weight = dynamics.mass_matrix(regressor.to_body(psi), pose[2]) @ error / tick
        return -pullback(weight)[0]

    return new_pose, new_twist, slope


def reference_slope(
    pose: Array, twist: Array, pose_d: Array, twist_d: Array, psi: Array, rate: Floats, smoothing: Floats
) -> Array:
    """[6] Y' s of the paper's law, with s = (qd - qd_d) + lambda (q - q_d) and qd_r = qd - s, qdd_r = -lambda qd_e."""
    error = twist - twist_d
    s = error + rate * (pose - pose_d)
    w, a = twist - s, -rate * error
    body = regressor.to_body(psi)
    inertial = regressor.inertial_regressor(pose[2], twist[2], w, a)
    friction = regressor.friction_regressor(pose[2], body.com, twist, smoothing)
    return jnp.concatenate([inertial, friction], axis=1).T @ s


def adapt(
    estimate: ParameterEstimate, slope: Array, held: Array, tick: Floats, model: ObjectModel, settings: Adaptation
) -> ParameterEstimate:
    """One tick of Psi_dot = -Gamma slope with projection and low-pass.

    Args:
      estimate: the previous one.
      slope: [6] Y' s.
      held: [] N, the push against which the floor holds an object at rest; infinite where it moves. The paper's law
        does not ask.
      tick: s.
      model: the object as believed; centres the projection box.
      settings: gains.
    """
    gain = jnp.stack([jnp.asarray(g, slope.dtype) for g in settings.gain])
    held = jnp.where(settings.on_prediction > 0.5, held, jnp.inf)
    psi = _as_seen(estimate.psi, estimate.psi - tick * gain * slope, held)
    psi = jnp.where(jnp.any(gain > 0.0), project(psi, model, settings), estimate.psi)
    blend = tick / (settings.low_pass + tick)
    return ParameterEstimate(psi, estimate.filtered + blend * (psi - estimate.filtered))


def _as_seen(old: Array, new: Array, held: Array) -> Array:
    """Psi [6] of which an object at rest changes only the strength of the friction."""
    force = jnp.maximum(old[4], jnp.minimum(new[4], BEYOND * held))
    strength = force / jnp.maximum(old[4], 1e-3)
    return jnp.where(jnp.isfinite(held), old.at[4:].multiply(strength), new)
