"""The public names, and the examples of the README."""

import os
import re
import subprocess
import sys
import tomllib
from pathlib import Path

import pytest

import jaxlocomanip
from jaxlocomanip import batch, checked, closed_loop, library, outcome, padding, scenario, specification
from jaxlocomanip.build import build
from jaxlocomanip.planner import config, presets
from jaxlocomanip.sampling import sampler, study
from jaxlocomanip.specification import ScenarioSpec, parse_scenario

ROOT = Path(__file__).parents[1]
README = (ROOT / "README.md").read_text(encoding="utf-8")

HOMES = {
    "InputError": checked.InputError,
    "Log": closed_loop.Log,
    "Outcome": outcome.Outcome,
    "PlannerConfig": config.PlannerConfig,
    "Result": closed_loop.Result,
    "Scenario": scenario.Scenario,
    "ScenarioSpec": specification.ScenarioSpec,
    "Study": study.Study,
    "build_scenario": build,
    "compiled": closed_loop.compiled,
    "find_scenario": library.find,
    "find_study": study.find_study,
    "load_scenario": specification.load_scenario,
    "parse_scenario": specification.parse_scenario,
    "preset": presets.preset,
    "run_batch": batch.run,
    "sample_scenario": sampler.sample,
    "simulate": closed_loop.simulate,
    "stack": padding.stack,
}


def code_blocks(language):
    return re.findall(rf"^```{language}\n(.*?)^```$", README, re.MULTILINE | re.DOTALL)


@pytest.mark.parametrize("name", sorted(HOMES))
def test_public_names_are_what_their_modules_hold(name):
    assert getattr(jaxlocomanip, name) is HOMES[name]


def test_public_names_are_listed():
    assert set(jaxlocomanip.__all__) == {"__version__", *HOMES}
    assert set(jaxlocomanip.__all__) <= set(dir(jaxlocomanip))


def test_no_submodule_can_take_a_public_name():
    modules = {path.stem for path in (ROOT / "jaxlocomanip").iterdir()}
    assert not modules & set(jaxlocomanip.__all__)


def test_unknown_names_are_refused():
    with pytest.raises(AttributeError, match="no attribute 'simulat'"):
        _ = jaxlocomanip.simulat


def test_importing_the_package_starts_nothing():
    code = (
        "import sys, jaxlocomanip; from jaxlocomanip import InputError, find_scenario; dir(jaxlocomanip); "
        "sys.exit(any(name in sys.modules for name in ('jax', 'rerun', 'matplotlib', 'mujoco')))"
    )
    assert subprocess.run([sys.executable, "-c", code], check=False, cwd=ROOT).returncode == 0


def test_one_version():
    project = tomllib.loads((ROOT / "pyproject.toml").read_text(encoding="utf-8"))["project"]
    assert jaxlocomanip.__version__ == project["version"]
    assert f"\nversion: {project['version']}\n" in (ROOT / "CITATION.cff").read_text(encoding="utf-8")


def test_the_readme_has_the_commands_of_a_fresh_machine():
    commands = "\n".join(code_blocks("sh"))
    assert 'pip install ".[view,sim]" && jaxlocomanip simulate adaptive --world quadruped --out out\n' in commands
    assert 'pip install -e ".[test]" && pytest -m "not slow"\n' in commands


def test_the_readme_names_every_scenario():
    assert all(f"| `{name}` |" in README for name in library.names())


def test_the_scenario_file_of_the_readme_is_correct():
    """All tables and keys at once: whatever a file may say stands there and is accepted."""
    (text,) = code_blocks("toml")
    spec = parse_scenario(tomllib.loads(text))
    assert isinstance(spec, ScenarioSpec)
    build(spec)
    documented = set(re.findall(r"^#?\s?(\w+) = ", text, re.MULTILINE))
    keys = set()
    for part in vars(specification).values():
        if isinstance(part, type) and part.__name__.endswith("Spec"):
            keys |= set(part.__dataclass_fields__)
    inline = set(re.findall(r"(\w+) = ", text))
    tables = set(re.findall(r"^\[+(\w+)\]+", text, re.MULTILINE))
    assert keys - {"is_box"} <= documented | inline | tables
    assert {"size", "footprint"} <= documented


def _examples():
    """The README's programs; what differentiates episodes takes minutes to compile."""
    for text in code_blocks("python"):
        slow = "soft_outcome" in text
        yield pytest.param(text, marks=[pytest.mark.slow] if slow else [], id=re.sub(r"\W+", " ", text)[:30])


@pytest.mark.parametrize("text", list(_examples()))
def test_the_examples_of_the_readme_run(capsys, monkeypatch, text):
    monkeypatch.setattr(os, "environ", dict(os.environ))
    exec(compile(text, "README.md", "exec"), {"__name__": "readme"})
    assert "print" not in text or capsys.readouterr().out
