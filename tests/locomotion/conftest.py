"""Shared parts of the locomotion tests."""

import sys
from pathlib import Path

import pytest

pytest.importorskip("mujoco")  # the robots' numbers are read with it
sys.path.insert(0, str(Path(__file__).parent))  # for the physics harness beside this file

from jaxlocomanip.locomotion.settings import settings_for
from jaxlocomanip.robots.model import ROBOT_TYPES
from jaxlocomanip.worlds.legged import read_robot


@pytest.fixture(scope="session")
def robots():
    """Parameters of the packaged robots by name."""
    return {name: read_robot(name) for name in ROBOT_TYPES}


@pytest.fixture(scope="session")
def gains():
    """Tuned settings of the packaged robots by name."""
    return {name: settings_for(name) for name in ROBOT_TYPES}
