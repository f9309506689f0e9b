"""An object's mass, friction and centre of mass from a recorded trajectory, by gradients through the planar world.

    found = identify(recording_of(result.log, tick=0.02), scenario, tick=0.02)
    found.body.mass, found.friction, found.body.com

The recorded pushes are applied to the planar world again, and the unknowns are those under which its poses fit the
recorded ones: Gauss-Newton with Levenberg damping on the whole trajectory, with sensitivities by forward
differentiation. Unknown are mass, inertia about the centre of mass, the centre of mass, both friction limits, and the
first pose and velocity. Weak prior knowledge keeps what a motion does not show (the centre of mass, if nothing
turns) at the belief; `deviation` says what was shown.
"""

from __future__ import annotations

import dataclasses

import jax
import jax.numpy as jnp
from jax import Array

from jaxlocomanip import checked, checked_arrays
from jaxlocomanip.checked import InputError
from jaxlocomanip.loop import Log
from jaxlocomanip.numerics import Floats, cholesky, cholesky_solve, pytree, select, wrap_angle
from jaxlocomanip.planar.dynamics import GRAVITY, Body
from jaxlocomanip.scenario import Scenario
from jaxlocomanip.worlds.interface import Push
from jaxlocomanip.worlds.planar import PlanarState, PlanarWorld

UNKNOWNS = 12
"""ln m, ln I_c, com (2), ln F_c, ln M_c, first pose (3), first twist (3)"""
ROUNDS = ((0.3, 0.02), (0.15, 0.02), (0.07, 0.02), (0.03, 0.02), (0.01, 0.01), (0.0, 5e-3), (0.0, 1e-4))
"""Share of each pose error by which the replay is drawn back to the recording, and friction's transition to rest in
m/s. Pushing is unstable: left to itself, a long replay under a wrong guess ends anywhere, and its gradient with it.
Wide transitions have no plateaus, narrow ones no bias."""
LEAST_FRICTION = 0.01
"""coefficient that an object which is believed to slide freely begins with: unknown are logarithms"""
ROUND = 10
"""iterations of a round"""


@pytree
class Recording:
    """A trajectory: T ticks of pushes, and the poses before, between and after them."""

    pose: Array
    """[T + 1, 3] measured"""
    force: Array
    """[T, N_r] N, pushes asked for"""
    offset_rate: Array
    """[T, N_r] m/s"""
    offset: Array
    """[N_r] m, contact offsets at the start"""
    acting: Array
    """[N_r] N, pushes that act at the start"""


@pytree
class Knowledge:
    """What is known beforehand, as standard deviations."""

    position: float = 1e-3
    """m, of a measured position, per axis"""
    heading: float = 1e-3
    """rad, of a measured heading"""
    mass: float = 1.0
    """of ln m about the belief"""
    gyration: float = 0.3
    """of ln (I_c / m)"""
    com: float = 0.1
    """m, per axis"""
    friction: float = 1.0
    """of ln (F_c / m) about the prior coefficient"""
    torsion: float = 0.2
    """of ln (M_c / F_c) about that of the footprint under uniform pressure"""
    twist: float = 0.01
    """m/s and rad/s, of the first velocity about zero"""
    coefficient: float = 0.3
    """Coulomb coefficient to begin with"""


@pytree
class Identified:
    """What a trajectory says of the object."""

    body: Body
    friction: Array
    """[] Coulomb coefficient F_c / (m g)"""
    deviation: Array
    """[6] standard deviations of ln m, ln I_c, com (2) in m, ln F_c, ln M_c, as the linearised fit has them"""
    misfit: Array
    """[] root mean square of the pose errors in multiples of their standard deviations; about 1 for a good model"""
    step: Array
    """[6] another Gauss-Newton step, in multiples of the deviations and in their order; small: converged"""


def recording_of(log: Log, tick: float, world: PlanarWorld | None = None) -> Recording:
    """The recording of an episode of the planar world; noise is not in it, but may be added.

    Args:
      log: with [T + 1] rows.
      tick: s, between rows.
      world: the world that it is from.

    Raises:
      InputError: the time between rows is not positive, or fewer than two rows.
    """
    checked.positive("tick", tick)
    if len(log.view.pose) < 2:
        raise InputError(f"log has {len(log.view.pose)} rows: must have at least two")
    force, offset = log.view.force, log.view.offset
    lag = (world or PlanarWorld()).force_lag
    # The pushes follow what was asked for exponentially; so the asked ones, after any delay, are known from them.
    share = 1.0 - jnp.exp(-tick / lag)
    asked = force[:-1] + (force[1:] - force[:-1]) / share
    return Recording(log.view.pose, asked, (offset[1:] - offset[:-1]) / tick, offset[0], force[0])


def replay(
    recording: Recording,
    scenario: Scenario,
    start: PlanarState,
    world: PlanarWorld,
    tick: float,
    gain: Floats = 0.0,
) -> Array:
    """Poses of the planar world under recorded pushes.

    Args:
      recording: T ticks.
      scenario: the object is its `truth`.
      start: state before the first tick.
      world: the planar world.
      tick: s.
      gain: share of each error by which pose and, as in an alpha-beta filter, velocity are drawn back to the
        recording.

    Returns:
      [T + 1, 3], each predicted from the ticks before it.
    """
    resting = jnp.zeros((), bool)

    def step(state: PlanarState, k: tuple[Array, Array, Array]) -> tuple[PlanarState, Array]:
        force, rate, measured = k
        push = Push(force, rate, jnp.zeros_like(state.twist), resting)
        new = world.step(state, scenario, push, 0.0, tick)
        error = _pose_error(measured, new.pose)
        twist = new.twist + gain**2 / (2.0 - gain) / tick * error
        return dataclasses.replace(new, pose=new.pose + gain * error, twist=twist), new.pose

    _, poses = jax.lax.scan(step, start, (recording.force, recording.offset_rate, recording.pose[1:]))
    return jnp.concatenate([start.pose[None], poses])


def _pose_error(pose: Array, other: Array) -> Array:
    """[..., 3] difference, the heading wrapped."""
    off = pose - other
    return jnp.concatenate([off[..., :2], wrap_angle(off[..., 2:])], axis=-1)


def identify(
    recording: Recording,
    scenario: Scenario,
    tick: float,
    knowledge: Knowledge | None = None,
    world: PlanarWorld | None = None,
) -> Identified:
    """Fit the object to a recording; a pure function, which may be compiled and batched.

    Args:
      recording: poses and pushes.
      scenario: team, and the belief `scenario.object` to begin with; its truth is not looked at.
      tick: s, between poses.
      knowledge: noise of the poses, and how far the belief may be wrong.
      world: its lag, fade and substeps; the smoothing is not used.

    Raises:
      InputError: a batch, arrays of other shapes than stated, or bad numbers; inside of `jit` only what is known there.
    """
    known = knowledge or Knowledge()
    _check(recording, scenario, tick, known)
    behind = world or PlanarWorld()
    prior = _prior(scenario, known)

    def errors(unknowns: Array, settings: Array) -> tuple[Array, Array]:
        """Residuals [3 (T + 1) + UNKNOWNS] in standard deviations, twice: to differentiate, and as they are."""
        body, pose, twist = _unpack(unknowns, recording)
        made = dataclasses.replace(scenario, truth=body)
        start = dataclasses.replace(
            behind.start(scenario), pose=pose, twist=twist, offset=recording.offset, force=recording.acting
        )
        smooth = dataclasses.replace(behind, smoothing=settings[1])
        poses = replay(recording, made, start, smooth, tick, settings[0])
        scale = jnp.stack([jnp.asarray(v, poses.dtype) for v in (known.position, known.position, known.heading)])
        fitted = _pose_error(poses, recording.pose) / scale
        values = jnp.concatenate([fitted.reshape(-1), _against_prior(unknowns, prior, known)])
        return values, values

    def iterate(carry: tuple[Array, Array], settings: Array) -> tuple[tuple[Array, Array], None]:
        unknowns, damping = carry
        rows, values = jax.jacfwd(errors, has_aux=True)(unknowns, settings)
        step = _damped(rows, values, damping)
        after = errors(unknowns + step, settings)[0]
        better = jnp.sum(after**2) < jnp.sum(values**2)
        damping = jnp.where(better, damping * 0.2, jnp.minimum(damping * 8.0 + 1e-6, 1e6))
        return (select(better, unknowns + step, unknowns), damping), None

    rounds = jnp.repeat(jnp.asarray(ROUNDS, prior.dtype), ROUND, axis=0)
    (unknowns, _), _ = jax.lax.scan(iterate, (prior, jnp.asarray(1e-2, prior.dtype)), rounds)
    rows, values = jax.jacfwd(errors, has_aux=True)(unknowns, rounds[-1])
    body, _, _ = _unpack(unknowns, recording)
    deviation = jnp.sqrt(jnp.diagonal(_covariance(rows)))
    step = _damped(rows, values, jnp.zeros_like(deviation[0]))
    return Identified(
        body=body,
        friction=body.friction_force / (body.mass * GRAVITY),
        deviation=deviation[:6],
        misfit=jnp.sqrt(jnp.mean(values[:-UNKNOWNS] ** 2)),
        step=(step / deviation)[:6],
    )


def _check(recording: Recording, scenario: Scenario, tick: float, known: Knowledge) -> None:
    checked_arrays.single("scenario", scenario)
    checked.positive("tick", tick)
    ticks, robots = len(recording.force), scenario.team.offset.shape[0]
    if ticks < 1:
        raise InputError("recording.force has no rows: must have at least one tick")
    for name, names, shape in (
        ("force", "[T, N_r]", (ticks, robots)),
        ("offset_rate", "[T, N_r]", (ticks, robots)),
        ("pose", "[T + 1, 3]", (ticks + 1, 3)),
        ("offset", "[N_r]", (robots,)),
        ("acting", "[N_r]", (robots,)),
    ):
        checked_arrays.shaped(f"recording.{name}", getattr(recording, name), names, shape)
    for field in dataclasses.fields(known):
        checked_arrays.scalar(f"knowledge.{field.name}", getattr(known, field.name), 0.0, strictly=True)


def _prior(scenario: Scenario, known: Knowledge) -> Array:
    """[UNKNOWNS] the belief, with the prior friction where none is stated; where it is none at all, next to none."""
    body, radius = scenario.object.body, scenario.object.torsion_radius
    weight = body.mass * GRAVITY
    believed = jnp.maximum(body.friction_force, LEAST_FRICTION * weight)
    force = jnp.where(scenario.object.friction_known, believed, known.coefficient * weight)
    logs = jnp.log(jnp.stack([body.mass, body.central_inertia, force, force * radius]))
    return jnp.concatenate([logs[:2], body.com, logs[2:], jnp.zeros(6, logs.dtype)])


def _against_prior(unknowns: Array, prior: Array, known: Knowledge) -> Array:
    """[UNKNOWNS] deviations from the belief in standard deviations."""
    off = unknowns - prior
    mass, inertia, force, moment = off[0], off[1], off[4], off[5]
    ratios = jnp.stack(
        [
            mass / known.mass,
            (inertia - mass) / known.gyration,
            (force - mass) / known.friction,
            (moment - force) / known.torsion,
        ]
    )
    # The first pose is measured like every other.
    free = 0.0 * off[6:9]
    return jnp.concatenate([ratios, off[2:4] / known.com, free, off[9:] / known.twist])


def _unpack(unknowns: Array, recording: Recording) -> tuple[Body, Array, Array]:
    """Body, first pose [3] and first twist [3] at the body point."""
    mass, central, force, moment = jnp.exp(unknowns[jnp.array([0, 1, 4, 5])])
    com = unknowns[2:4]
    body = Body(mass, central + mass * jnp.sum(com**2), com, force, moment)
    return body, recording.pose[0] + unknowns[6:9], unknowns[9:]


def _scaled(rows: Array) -> tuple[Array, Array]:
    """Normal matrix of the rows with columns of length one, and the columns' lengths."""
    length = jnp.sqrt(jnp.sum(rows * rows, axis=0)) + 1e-12
    columns = rows / length
    return columns.T @ columns, length


def _damped(rows: Array, values: Array, damping: Array) -> Array:
    """Levenberg-Marquardt step [UNKNOWNS]."""
    normal, length = _scaled(rows)
    right = -(rows / length).T @ values
    eye = jnp.eye(UNKNOWNS, dtype=rows.dtype)
    return cholesky_solve(cholesky(normal + damping * eye), right[:, None])[:, 0] / length


def _covariance(rows: Array) -> Array:
    """[UNKNOWNS, UNKNOWNS] covariance of the fit."""
    normal, length = _scaled(rows)
    eye = jnp.eye(UNKNOWNS, dtype=rows.dtype)
    return cholesky_solve(cholesky(normal), eye) / (length[:, None] * length)
