"""Control Lyapunov function and bounds."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from jaxlocomanip.planar import dynamics
from jaxlocomanip.planner import constraints
from jaxlocomanip.planner.constraints import Motion


def test_lyapunov_condition_is_the_decrease_of_the_composite_error(x64, random_case):
    """With V = 1/2 s' H s, the condition is -V' - 1/2 s' K_D s along the model's motion."""
    case = random_case(7, np.zeros((2, 2)))
    settings, body = case.settings, case.body
    pose, twist = case.x[:3], case.x[3:6]
    target, target_twist = pose + jnp.array([0.2, -0.1, 0.3]), jnp.array([0.3, 0.1, -0.2])
    points = case.shapes.team.contact_points(case.x[6:])
    wrench = dynamics.contact_wrench(pose[2], points, case.shapes.team.normal, case.u[:2])
    found = constraints.lyapunov_condition(pose, twist, wrench, body, target, target_twist, settings, case.smoothing)
    rate = settings.clf_rate

    def energy(t):
        """V a time t later, to first order; the target moves at constant velocity."""
        pull = dynamics.acceleration(body, pose[2], twist, wrench, case.smoothing)
        q, v = pose + t * twist, twist + t * pull
        s = v - target_twist + rate * (q - target - t * target_twist)
        return 0.5 * s @ dynamics.mass_matrix(body, q[2]) @ s, s

    (_, s), (slope, _) = jax.jit(lambda: jax.jvp(energy, (0.0,), (1.0,)))()
    expected = -slope - 0.5 * settings.clf_gain * s @ s
    assert found == pytest.approx(float(expected / (1.0 + settings.clf_normalised * jnp.linalg.norm(s))), rel=1e-9)


def test_bounds_are_zero_at_the_limits_and_positive_between(x64, random_case):
    case = random_case(0, np.zeros((2, 2)))
    team, zero = case.shapes.team, jnp.zeros(2)

    def bounds(force, offset, rate):
        return constraints.bounds(Motion(zero, zero, zero, force, offset, rate), case.shapes)

    force, offset, rate, room = bounds(0.5 * team.force_max, zero, zero)
    assert all((np.asarray(h) > 0.0).all() for h in (force, offset, rate))
    assert room.shape == (1,)
    force, offset, rate, _ = bounds(team.force_max, team.offset_limit, -team.slide_speed_max)
    assert np.allclose(force[2:], 0.0) and np.allclose(offset[2:], 0.0) and np.allclose(rate[:2], 0.0)
    force, offset, rate, _ = bounds(-jnp.ones(2), -1.5 * team.offset_limit, 2.0 * team.slide_speed_max)
    assert (force[:2] < 0.0).all() and (offset[:2] < 0.0).all() and (rate[2:] < 0.0).all()
