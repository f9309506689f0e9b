"""The directory of a sweep: whole files only, gone on with after any crash, never mixed."""

import json
import multiprocessing
import os
import shutil
from pathlib import Path

import pytest

from jaxlocomanip.checked import InputError
from jaxlocomanip.sweep import store as module
from jaxlocomanip.sweep.store import Store, code_digest, read_manifest, read_results

SETTINGS = {"seed": 0, "name": "tiny", "study": {"goal": {"distance": 3.0}}, "versions": {"jax": "1"}}
KEYS = ("000000-000", "000001-000")


@pytest.fixture
def parts(made_up_columns):
    """Columns of two pieces of work."""
    whole = made_up_columns(6)
    return [{name: values[i : i + 3] for name, values in whole.items()} for i in (0, 3)]


def opened(place, **changes):
    return Store(place / "out", SETTINGS | changes)


def kept(place, parts, keys=KEYS):
    store = opened(place)
    store.describe({"complete": False})
    for key, part in zip(keys, parts, strict=False):
        store.keep(key, part)
    return store


def test_pieces_are_joined_in_the_order_of_lanes(tmp_path, parts):
    store = kept(tmp_path, parts[::-1])
    assert store.done() == set(KEYS)
    assert read_results(tmp_path / "out")["lane"].to_pylist() == list(range(6))  # before they are joined, too
    table = store.join(KEYS)
    assert table["lane"].to_pylist() == list(range(6))
    assert {path.name for path in (tmp_path / "out").iterdir()} == {"manifest.json", "results.parquet"}
    assert opened(tmp_path).complete


def test_variants_come_one_after_the_other(tmp_path, made_up_columns):
    store = kept(tmp_path, [made_up_columns(3, variants=("z", "a"))])
    table = store.join(KEYS[:1])
    assert table["variant"].to_pylist() == ["z"] * 3 + ["a"] * 3


@pytest.mark.parametrize("crash", ["before the results", "before the pieces are gone", "before the manifest"])
def test_a_crash_while_joining_loses_nothing(tmp_path, parts, monkeypatch, crash):
    store = kept(tmp_path, parts)
    real = os.replace

    def killed(*_):
        raise KeyboardInterrupt

    if crash == "before the results":
        monkeypatch.setattr(os, "replace", killed)
    elif crash == "before the pieces are gone":
        monkeypatch.setattr(module.Path, "unlink", killed)
    try:
        store.join(KEYS)
    except KeyboardInterrupt:
        pass
    monkeypatch.undo()
    assert os.replace is real
    again = opened(tmp_path)
    assert again.complete == (crash != "before the results")
    assert again.join(KEYS)["lane"].to_pylist() == list(range(6))


def test_leftovers_of_a_killed_program_are_removed(tmp_path, parts):
    store = kept(tmp_path, parts[:1])
    (tmp_path / "out" / "chunks" / ".0123456789abcdef.tmp").write_bytes(b"half")
    with store.held():
        assert store.done() == {KEYS[0]}
    assert [path.name for path in (tmp_path / "out" / "chunks").iterdir()] == [f"{KEYS[0]}.parquet"]


@pytest.mark.parametrize(
    ("change", "expected"),
    [
        ({"seed": 1}, "seed = 0 there and 1 here"),
        ({"study": {"goal": {"distance": 4.0}}}, "study there and here differ"),
        ({"versions": {"jax": "2"}}, "versions there and here differ"),
        ({"new": None}, None),
    ],
)
def test_other_settings_are_refused(tmp_path, parts, change, expected):
    kept(tmp_path, parts)
    with pytest.raises(InputError, match="holds a sweep with other settings"):
        opened(tmp_path, **change)
    if expected:
        with pytest.raises(InputError, match=expected):
            opened(tmp_path, **change)
    assert opened(tmp_path).done() == set(KEYS)


def test_results_without_a_manifest_are_refused(tmp_path, parts):
    kept(tmp_path, parts)
    (tmp_path / "out" / "manifest.json").unlink()
    with pytest.raises(InputError, match="holds results without a manifest.json"):
        opened(tmp_path)


def test_manifests_are_read_back(tmp_path, parts):
    kept(tmp_path, parts)
    assert read_manifest(tmp_path / "out") == {"settings": SETTINGS, "complete": False}
    assert json.loads((tmp_path / "out" / "manifest.json").read_text())["settings"] == SETTINGS
    with pytest.raises(InputError, match="cannot be read .*; is .* the --out of a sweep"):
        read_manifest(tmp_path)
    (tmp_path / "out" / "manifest.json").write_text("{")
    with pytest.raises(InputError, match="is damaged"):
        read_manifest(tmp_path / "out")


def test_missing_and_damaged_results_are_refused(tmp_path):
    store = opened(tmp_path)
    store.describe({})
    with pytest.raises(InputError, match="holds no results yet"):
        read_results(tmp_path / "out")
    store.keep_bytes(KEYS[0], b"PAR1 nonsense")
    with pytest.raises(InputError, match="results cannot be read"):
        read_results(tmp_path / "out")


def _try_to_hold(place, answers):
    try:
        with Store(place, SETTINGS).held():
            answers.put("held")
    except InputError as error:
        answers.put(str(error))


def test_two_programs_at_once_are_refused(tmp_path):
    context = multiprocessing.get_context("spawn")
    answers = context.Queue()
    store = opened(tmp_path)
    with store.held():
        other = context.Process(target=_try_to_hold, args=(str(tmp_path / "out"), answers))
        other.start()
        assert "another sweep is writing into it" in answers.get(timeout=60)
        other.join()
    with opened(tmp_path).held():
        pass


@pytest.fixture
def package(tmp_path, monkeypatch):
    """A copy of the package, elsewhere, that the fingerprint is taken of."""
    real = Path(module.jaxlocomanip.__file__).parent
    copy = shutil.copytree(real, tmp_path / "copy", ignore=shutil.ignore_patterns("__pycache__"))
    monkeypatch.setattr(module.jaxlocomanip, "__file__", str(copy / "__init__.py"))
    return copy


def test_the_fingerprint_is_that_of_the_code_and_not_of_its_place(request):
    here = code_digest()
    request.getfixturevalue("package")
    assert code_digest() == here
    assert len(here) == 16


def _edited(package):
    with (package / "loop.py").open("a") as file:
        file.write("# one more line\n")


def _renamed(package):
    (package / "loop.py").rename(package / "loops.py")  # the next in order still


def _another_robot(package):
    path = package / "robots" / "go1.xml"
    path.write_text(path.read_text().replace("0.", "1.", 1))


def _another_study(package):
    (package / "studies" / "more.toml").write_text("count = 1\n")


@pytest.mark.parametrize("change", [_edited, _renamed, _another_robot, _another_study])
def test_other_code_has_another_fingerprint(package, change):
    before = code_digest()
    change(package)
    assert code_digest() != before


def test_what_is_no_code_leaves_the_fingerprint(package):
    before = code_digest()
    (package / "notes.txt").write_text("nothing that is run")
    (package / "__pycache__").mkdir()
    (package / "__pycache__" / "loop.pyc").write_bytes(b"compiled")
    assert code_digest() == before
