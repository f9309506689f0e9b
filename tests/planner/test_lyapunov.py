"""The control Lyapunov function falls along the closed loop wherever its condition holds."""

import dataclasses

import jax
import numpy as np

from jaxlocomanip.closed_loop import episode
from jaxlocomanip.planar.dynamics import mass_matrix
from jaxlocomanip.planner.config import PlannerConfig
from jaxlocomanip.worlds.planar import PlanarWorld

CONFIG = PlannerConfig()


def test_it_falls_wherever_the_condition_holds(make_scenario):
    """V = 1/2 s' H s with the parameters known, so that only the tracking error is left to fall.

    The condition is that of the planner's own input: without the filter that is what acts.
    """
    settings = dataclasses.replace(CONFIG.adaptation, gain=(0.0,) * 6)
    config = dataclasses.replace(CONFIG, adaptation=settings, safety=dataclasses.replace(CONFIG.safety, enabled=0.0))
    known = {"size": [0.5, 0.5], "mass": 6.0, "friction": 0.4}
    scenario = make_scenario(object=known, start={"pose": [0.0, 0.0, 0.15]}, goal={"pose": [3.0, 3.0, 0.0]})
    prompt = PlanarWorld(force_lag=1e-3)
    run = jax.jit(lambda s, k: episode(s, config, k, prompt, 250, True))
    log = jax.tree.map(np.asarray, run(dataclasses.replace(scenario, duration=5.0), jax.random.key(0)).log)

    tick = config.horizon.tick
    target_twist = np.diff(log.report.target, axis=0) / tick
    pose, twist = log.view.pose[:-1], log.view.twist[:-1]
    s = twist - target_twist + config.constraints.clf_rate * (pose - log.report.target[:-1])
    inertia = np.stack([np.asarray(mass_matrix(scenario.truth, theta)) for theta in pose[:, 2]])
    value = 0.5 * np.einsum("ti,tij,tj->t", s, inertia, s)

    # A new path moves the reference at once: those ticks say nothing of the control.
    steady = np.ones(len(value) - 1, dtype=bool)
    steady[:: round(config.reference.replan / tick)] = False
    steady[round(config.reference.replan / tick) - 1 :: round(config.reference.replan / tick)] = False
    holds = (log.report.clf[: len(value) - 1] >= 0.0) & steady & (value[:-1] > 1e-3)
    falls = np.diff(value) < 0.0
    assert holds.sum() > 20
    assert falls[holds].mean() > 0.95
