"""Batched adaptive safety-critical planning for teams of quadrupeds pushing an object, in JAX.

    from jaxlocomanip import build_scenario, find_scenario, simulate

    result = simulate(build_scenario(find_scenario("adaptive")))

The names below are the public ones. Each is imported when it is first used, so that importing the package starts
nothing.
"""

from __future__ import annotations

import importlib
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from jaxlocomanip.batch import run as run_batch
    from jaxlocomanip.build import build as build_scenario
    from jaxlocomanip.checked import InputError
    from jaxlocomanip.closed_loop import Log, Result, compiled, simulate
    from jaxlocomanip.library import find as find_scenario
    from jaxlocomanip.outcome import Outcome
    from jaxlocomanip.padding import stack
    from jaxlocomanip.planner.config import PlannerConfig
    from jaxlocomanip.planner.presets import preset
    from jaxlocomanip.sampling.sampler import sample as sample_scenario
    from jaxlocomanip.sampling.study import Study, find_study
    from jaxlocomanip.scenario import Scenario
    from jaxlocomanip.specification import ScenarioSpec, load_scenario, parse_scenario

__version__ = "0.1.0"

__all__ = [
    "InputError",
    "Log",
    "Outcome",
    "PlannerConfig",
    "Result",
    "Scenario",
    "ScenarioSpec",
    "Study",
    "__version__",
    "build_scenario",
    "compiled",
    "find_scenario",
    "find_study",
    "load_scenario",
    "parse_scenario",
    "preset",
    "run_batch",
    "sample_scenario",
    "simulate",
    "stack",
]

# `build_scenario`, not `build`: a submodule has that name, and importing it would replace the function.
_HOMES = {
    "InputError": ("checked", "InputError"),
    "Log": ("closed_loop", "Log"),
    "Outcome": ("outcome", "Outcome"),
    "PlannerConfig": ("planner.config", "PlannerConfig"),
    "Result": ("closed_loop", "Result"),
    "Scenario": ("scenario", "Scenario"),
    "ScenarioSpec": ("specification", "ScenarioSpec"),
    "Study": ("sampling.study", "Study"),
    "build_scenario": ("build", "build"),
    "compiled": ("closed_loop", "compiled"),
    "find_scenario": ("library", "find"),
    "find_study": ("sampling.study", "find_study"),
    "load_scenario": ("specification", "load_scenario"),
    "parse_scenario": ("specification", "parse_scenario"),
    "preset": ("planner.presets", "preset"),
    "run_batch": ("batch", "run"),
    "sample_scenario": ("sampling.sampler", "sample"),
    "simulate": ("closed_loop", "simulate"),
    "stack": ("padding", "stack"),
}


def __getattr__(name: str) -> Any:
    if name not in _HOMES:
        raise AttributeError(f"module {__name__!r} has no attribute {name!r}")
    module, attribute = _HOMES[name]
    value = getattr(importlib.import_module(f"{__name__}.{module}"), attribute)
    globals()[name] = value
    return value


def __dir__() -> list[str]:
    return sorted({*globals(), *__all__})
