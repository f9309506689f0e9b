"""Files of the package by name, and names told from paths."""

import os
import re

import pytest

from jaxlocomanip.checked import InputError
from jaxlocomanip.packaged import Files, is_name

SCENARIOS = Files("scenario", "scenarios")


def test_files_are_known_by_their_names():
    names = SCENARIOS.names()
    assert "people" in names and list(names) == sorted(names)
    first, _, rest = SCENARIOS.text("people").partition("\n")
    assert first == f"# {SCENARIOS.describe('people')}" and 'name = "people"' in rest


def test_unknown_names_are_refused():
    for read in (SCENARIOS.text, SCENARIOS.describe):
        with pytest.raises(InputError, match="scenario = 'peple': must be one of .*; did you mean 'people'"):
            read("peple")


def test_names_go_before_paths(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    (tmp_path / "robust").touch()
    (tmp_path / "mine").touch()
    assert is_name("config", "robust", ("robust", "paper"))
    for path in ("mine", "missing.toml", f"missing{os.sep}mine"):
        assert not is_name("config", path, ("robust", "paper"))


def test_neither_name_nor_path_is_refused(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    expected = "config = 'papr': must be a file or one of robust, paper; did you mean 'paper'?"
    with pytest.raises(InputError, match=re.escape(expected)):
        is_name("config", "papr", ("robust", "paper"))
