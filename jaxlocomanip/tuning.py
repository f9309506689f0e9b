"""Tuning of a planner's settings over scenarios, by stochastic gradient or without gradients.

    settings = Settings(names=("weights.pose", "constraints.robot_cbf"), steps=50)
    tuned = tune(preset("paper"), train, held_out, ticks=400, settings=settings, checkpoint="out/tune.json")
    Path("out/tuned.toml").write_text(config_to_toml(tuned.config))            # for --config

A setting is searched by its logarithm relative to where it starts, within `SPAN`, so it stays positive; settings that
start at zero are switched off and stay so. Every step sees a random part of the training scenarios. The loss of a
scenario is a smooth function of its soft outcome: clearance, errors at the goal, time and effort. The settings that are
returned are those, of all that were validated, with the least loss on the scenarios that were held out.

Pushing is unstable, and a few lanes have gradients many orders of magnitude larger than the others'. Each lane's
gradient is therefore clipped by its norm before they are averaged. `method = "cem"`, the cross-entropy method, needs no
gradients: it draws settings from a normal distribution, which is drawn to the best of them.
"""

from __future__ import annotations

import dataclasses
import json
import math
from collections.abc import Callable
from functools import partial
from pathlib import Path
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
from jax import Array

from jaxlocomanip import checked
from jaxlocomanip.checked import InputError
from jaxlocomanip.config_file import config_to_toml
from jaxlocomanip.files import write_whole
from jaxlocomanip.gradients import SoftOutcome, soft_outcome
from jaxlocomanip.knobs import Knobs, knobs_of
from jaxlocomanip.numerics import pytree
from jaxlocomanip.planner.config import PlannerConfig
from jaxlocomanip.scenario import Scenario
from jaxlocomanip.specification import read_text

METHODS = ("gradient", "cem")
"""How settings are searched."""
DEFAULTS = ()
"""Settings that are tuned where none are named."""


@pytree
class Objective:
    """Loss of one scenario, from its soft outcome."""

    clearance: float = 0.05
    """m, wanted between bodies and obstacles"""
    softness: float = 0.02
    """m, over which the penalty of less sets in"""
    danger: float = 20.0
    """1/m, of clearance that is missing"""
    arrival: float = 1.0
    """of ln(1 + (error / tolerance)^2), position and heading"""
    time: float = 1.0
    """of the share of the time spent outside the goal tolerances"""
    effort: float = 1e-5
    """1/(N^2 s)"""
'''
