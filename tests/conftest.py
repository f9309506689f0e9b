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
