"""Output files are whole or absent, and unusable directories are known beforehand."""

import os

import pytest

from jaxlocomanip.checked import InputError
from jaxlocomanip.files import prepare_directory, write_whole


def test_text_and_bytes_are_written_and_replaced(tmp_path):
    path = tmp_path / "a.txt"
    write_whole(path, "größer\n")
    assert path.read_bytes() == "größer\n".encode()
    write_whole(path, b"\x00\xff")
    assert path.read_bytes() == b"\x00\xff"
    assert list(tmp_path.iterdir()) == [path]


def test_permissions_follow_the_umask(tmp_path):
    plain = tmp_path / "plain"
    plain.touch()
    write_whole(tmp_path / "whole", "")
    assert (tmp_path / "whole").stat().st_mode == plain.stat().st_mode


@pytest.mark.parametrize("error", [OSError(28, "No space left on device"), KeyboardInterrupt()])
def test_a_failed_write_leaves_the_old_file_and_nothing_else(tmp_path, monkeypatch, error):
    path = tmp_path / "a.txt"
    write_whole(path, "old")

    def fail(_):
        raise error

    monkeypatch.setattr(os, "fsync", fail)
    with pytest.raises((InputError, KeyboardInterrupt)) as caught:
        write_whole(path, "new")
    if isinstance(error, OSError):
        assert str(caught.value) == f"{path}: cannot be written (No space left on device)"
    assert path.read_text() == "old"
    assert list(tmp_path.iterdir()) == [path]


def test_unwritable_targets_are_named(tmp_path):
    (tmp_path / "file").touch()
    (tmp_path / "full").mkdir()
    for path in (tmp_path / "missing" / "a", tmp_path / "file" / "a", tmp_path / "full"):
        with pytest.raises(InputError, match="cannot be written") as caught:
            write_whole(path, "x")
        assert str(caught.value).startswith(f"{path}: ")
    assert sorted(p.name for p in tmp_path.iterdir()) == ["file", "full"]


def test_directories_are_created_and_left_empty(tmp_path):
    made = prepare_directory(tmp_path / "a" / "b")
    assert made == tmp_path / "a" / "b"
    assert list(made.iterdir()) == []
    assert prepare_directory(made) == made


def test_unusable_directories_are_refused(tmp_path):
    file = tmp_path / "file"
    file.touch()
    for path in (file, file / "below", "/proc", "/proc/below"):
        with pytest.raises(InputError, match="cannot be used as output directory") as caught:
            prepare_directory(path)
        assert str(caught.value).startswith(f"{path}: ")
