"""Gains of one robot's control, as one pytree of numbers so that the robots of a mixed team stack."""

from __future__ import annotations

import jax
import jax.numpy as jnp

from jaxlocomanip.locomotion import kinematics
from jaxlocomanip.locomotion.foothold import FootholdRule
from jaxlocomanip.locomotion.force_mpc import ForceSettings
from jaxlocomanip.locomotion.gait import Gait
from jaxlocomanip.locomotion.robot import LeggedRobot
from jaxlocomanip.locomotion.srbd import GRAVITY
from jaxlocomanip.numerics import Floats, pytree

TROT = (0.0, 0.5, 0.5, 0.0)
"""phases of FR, FL, RR, RL: diagonal legs together"""


@pytree
class JointGains:
    """Impedance of the joints."""

    swing_kp: Floats
    """N m/rad"""
    swing_kd: Floats
    """N m s/rad"""
    stance_kd: Floats
    """N m s/rad; stance legs have no stiffness"""


@pytree
class LocomotionSettings:
    """Everything that is tuned."""

    gait: Gait
    forces: ForceSettings
    footholds: FootholdRule
    joints: JointGains
    swing_height: Floats
    """m, apex of a swing"""
    reach: Floats
    """m, how far the integrated reference may be from the robot along each axis"""
    turn: Floats
    """rad, how far the heading reference may be from the robot's"""


@pytree
class _Table:
    """What differs from robot to robot in the paper's released controller."""

    period: float
    force_max: float
    angle: tuple[float, float, float]
    position: tuple[float, float, float]
    velocity: float
    swing_kd: float = 1.0


ALIENGO = _Table(0.5, 250.0, (8.0, 5.0, 10.0), (1.5, 1.5, 15.0), 0.4)
TABLES = {
    "aliengo": ALIENGO,
    # The released weights of 0.5 on roll and pitch let an A1 that pushes pitch by 6 degrees: Aliengo's instead.
    "a1": _Table(0.4, 180.0, ALIENGO.angle, (2.5, 2.5, 20.0), 0.4),
    "go1": _Table(0.4, 180.0, (15.0, 12.0, 10.0), (1.5, 1.5, 35.0), 0.2, swing_kd=2.0),
}
"""of the packaged robots"""


def settings_for(name: str) -> LocomotionSettings:
    """Tuned gains of a packaged robot.

    Raises:
      ValueError: there is no robot of this name.
    """
    if name not in TABLES:
        raise ValueError(f"settings for {name!r}: must be one of {', '.join(TABLES)}; others have derived_settings")
    table = TABLES[name]
    forces = ForceSettings(
        dt=table.period / ForceSettings.steps,
        angle=table.angle,
        position=table.position,
        velocity=(table.velocity,) * 3,
        force_max=table.force_max,
    )
    return _leaves(
        LocomotionSettings(
            gait=Gait(table.period, 0.6, jnp.asarray(TROT)),
            forces=forces,
            footholds=FootholdRule(capture=0.03, clamp=0.3, sink=0.004),
            joints=JointGains(40.0, table.swing_kd, 1.0),
            swing_height=0.08,
            reach=0.1,
            turn=0.3,
        )
    )


def derived_settings(robot: LeggedRobot) -> LocomotionSettings:
    """Gains for any robot: Aliengo's, scaled with weight, height and what the motors can carry.

    They stand for a start and are not tuned: `dataclasses.replace` what measurements show to be wrong.
    """
    height, weight = robot.stand_height, robot.mass * GRAVITY
    period = 2.65 * jnp.sqrt(height / GRAVITY)
    # What one leg carries at the stand pose with its weakest motor, but no more than the robot weighs.
    arms = jnp.abs(kinematics.jacobians(robot, robot.stand)[:, 2, :])
    carried = jnp.min(robot.torque_max / jnp.maximum(arms, 1e-3))
    forces = ForceSettings(
        dt=period / ForceSettings.steps,
        angle=ALIENGO.angle,
        position=ALIENGO.position,
        velocity=(ALIENGO.velocity,) * 3,
        force=0.06 / weight**2,
        force_max=jnp.minimum(carried, weight),
    )
    # Stiffness per inertia that swings: the joints of heavier legs get more of it.
    inertia = jnp.mean(robot.leg_inertia[:, 1, 1])
    return _leaves(
        LocomotionSettings(
            gait=Gait(period, 0.6, jnp.asarray(TROT)),
            forces=forces,
            footholds=FootholdRule(capture=0.03, clamp=0.6 * (robot.thigh + robot.calf), sink=0.15 * robot.foot_radius),
            joints=JointGains(900.0 * inertia, 22.0 * inertia, 22.0 * inertia),
            swing_height=0.23 * height,
            reach=0.1,
            turn=0.3,
        )
    )


def _leaves(settings: LocomotionSettings) -> LocomotionSettings:
    """Numbers as arrays, so that they stack."""
    return jax.tree.map(lambda leaf: jnp.asarray(leaf, jnp.result_type(float)), settings)
