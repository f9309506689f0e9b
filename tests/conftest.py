"""Settings that every test runs under, and the scenarios that many of them share."""

import gc
import os
from pathlib import Path

# Set before JAX is imported: enough threads that nested parallel regions of XLA's CPU client never wait for each other,
# and a compilation cache beside the checkout, so that a second run of the tests compiles nothing.
os.environ.setdefault("PJRT_NPROC", "16")
os.environ.setdefault("JAX_COMPILATION_CACHE_DIR", str(Path(__file__).parents[1] / ".jax_cache"))
os.environ.setdefault("JAX_PERSISTENT_CACHE_MIN_COMPILE_TIME_SECS", "0")

import jax
import numpy as np
import pytest

from jaxlocomanip.build import build
from jaxlocomanip.specification import parse_scenario

# The context manager moved out of `jax.experimental`; the oldest supported release has only the latter.
if hasattr(jax, "enable_x64"):
    enable_x64 = jax.enable_x64
else:
    from jax.experimental import enable_x64

SMALL = {
    "name": "small",
    "duration": 3.0,
    "object": {"size": [0.5, 0.5], "height": 0.5, "mass": 6.0},
    "start": {"pose": [0.0, 0.0, 0.0]},
    "goal": {"pose": [3.0, 3.0, 0.0]},
    "robots": [{"type": "aliengo", "face": "-x"}, {"type": "aliengo", "face": "-y"}],
}
"""Two robots and a box on an empty floor."""


@pytest.fixture(scope="module", autouse=True)
def programs_are_dropped():
    """Compiled programs of a file are let go after it; they come back from the cache on disk.

    Each holds several memory maps, of which Linux gives a process 65,530: with the programs of the whole suite loaded,
    the next compilation crashes the interpreter.
    """
    yield
    jax.clear_caches()
    gc.collect()


@pytest.fixture
def x64():
    """Double precision for one test; everything that it compares must be made inside."""
    with enable_x64(True):
        yield


@pytest.fixture(scope="session")
def double():
    """Context manager of double precision, for fixtures that outlive a test."""
    return lambda: enable_x64(True)


@pytest.fixture(scope="session")
def make_scenario():
    """A function that builds the small scenario with some of its tables replaced."""

    def make(index=0, **tables):
        return build(parse_scenario(SMALL | tables), index)

    return make


STUDY = """
name = "tiny"
count = 10
duration = 0.4
chunk = 4
[object]
mass = 6.0
[truth]
mass_ratio = { uniform = [0.5, 2.0] }
friction = { uniform = [0.15, 0.4] }
[goal]
distance = { uniform = [0.5, 2.0] }
bearing = { uniform = [0.1, 0.9] }
[team]
types = { choice = ["aliengo", "a1"] }
[obstacles]
count = { integer = [0, 2] }
half_size = 0.2
along = { uniform = [0.0, 2.0] }
lateral = { uniform = [-1.5, 1.5] }
[motion]
count = { integer = [0, 1] }
heading = { uniform = [-3.0, 3.0] }
[sensing]
position_std = 0.002
"""


@pytest.fixture(scope="session")
def tiny_study():
    """Text of a study of short episodes; tests that run it share its chunk and so its compilation."""
    return STUDY


@pytest.fixture(scope="session")
def quick_config():
    """Planner settings, as a file's text, that compile and run faster than the preset."""
    return 'preset = "robust"\n[horizon]\nsteps = 5\n'


@pytest.fixture(scope="session")
def made_up_columns(tiny_study):
    """A function: columns of a sweep of the tiny study whose outcomes are given, field by field [n]."""
    from jaxlocomanip.outcome import Outcome
    from jaxlocomanip.sampling.sampler import draw
    from jaxlocomanip.sampling.study import parse_study
    from jaxlocomanip.sweep import rows

    def make(count=10, variants=(), **changes):
        study = parse_study(tiny_study + "".join(f'[[variants]]\nname = "{name}"\n' for name in variants))
        lanes = [draw(study, 0, lane) for lane in range(count)]
        values = {name: np.full(count, 0.1, np.float32) for name in Outcome.__dataclass_fields__}
        flags = dict.fromkeys(("reached", "collided", "run_over", "fell"), np.zeros(count, bool))
        counts = {"ticks": np.full(count, 20), "nonfinite": np.zeros(count, int), "converged": np.full(count, 19)}
        whole = values | flags | {"reached": np.ones(count, bool)} | counts
        whole |= {"estimates": np.ones((count, 6), np.float32)} | changes
        parts = [rows.columns(study, number, lanes, Outcome(**whole)) for number in range(len(study.variants))]
        return {name: [value for part in parts for value in part[name]] for name in parts[0]}

    return make


@pytest.fixture(scope="session")
def breaking():
    """Text of a study whose scenarios are searched for the worst."""
    return """
name = "breaking"
extends = "standard"
duration = 1.0
[goal]
distance = { uniform = [1.0, 2.0] }
heading = 0.0
[obstacles]
count = 2
along = { uniform = [0.3, 0.8] }
half_size = 0.2
"""


class MadeUp:
    """Episodes in which nothing moves, counted, and their gradients."""

    touching = 0.1
    """m, clearance below which robots touch each other"""

    def __init__(self):
        self.episodes = self.gradients = 0
        self.clearance = lambda place: 0.5 - 0.05 * place.spec.truth.mass - 0.5 * place.spec.truth.friction
        """of a place, m; least for the heaviest object on the roughest floor"""

    def found(self, place):
        from jaxlocomanip.aiming import Motion
        from jaxlocomanip.trials import Found

        clearance, obstacles = self.clearance(place), np.asarray(place.scenario.obstacles.position)
        motion = Motion(np.tile(place.scenario.start, (2, 1)), np.tile(obstacles, (2, 1, 1)))
        return Found(place.spec, place.seed, clearance, clearance - self.touching, False, True, motion)


@pytest.fixture
def no_episodes(monkeypatch):
    """Made-up episodes in the place of those that would be run."""
    from jaxlocomanip.trials import Trials

    made_up = MadeUp()

    def run(self, places):
        made_up.episodes += len(places)
        return [(place, made_up.found(place)) for place in places]

    def gradients(self, places):
        made_up.gradients += len(places)
        slopes = [np.zeros(len(place.coordinates)) for place in places]
        for slope in slopes:
            slope[:2] = -0.2, -0.1
        return slopes

    monkeypatch.setattr(Trials, "run", run)
    monkeypatch.setattr(Trials, "gradients", gradients)
    return made_up
