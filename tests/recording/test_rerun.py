"""Recordings: what is in the file agrees with the log, and the file is written whole or not at all."""

import dataclasses
import sys

import numpy as np
import pytest

from jaxlocomanip.checked import InputError
from jaxlocomanip.recording.rerun import write_recording

pytest.importorskip("rerun")

ROWS = 100  # 2 s of duration, a tick every 20 ms


def chunks_of(path):
    """Chunks of a recording by entity path."""
    from rerun.chunk import RrdReader

    found = {}
    for chunk in RrdReader(path).stream().to_chunks():
        found.setdefault(str(chunk.entity_path), []).append(chunk)
    return found


def column(chunks, part):
    """Values of the first column whose name contains `part`."""
    for chunk in chunks:
        batch = chunk.to_record_batch()
        for name in batch.schema.names:
            if part in name:
                return batch.column(name).to_pylist()
    raise AssertionError(f"no column {part}")


@pytest.fixture(scope="module")
def recorded(made_up, tmp_path_factory):
    folder = tmp_path_factory.mktemp("recording")
    scenario, result = made_up
    write_recording(folder / "made_up.rrd", "made_up", scenario, result.log)
    return folder / "made_up.rrd", chunks_of(folder / "made_up.rrd")


def test_entities(recorded):
    _, chunks = recorded
    expected = {
        "/about",
        "/world/ground",
        "/world/goal",
        "/world/object",
        "/world/robots/0_aliengo",
        "/world/robots/1_go1",
        "/world/obstacles/0_still",
        "/world/obstacles/1_moving",
        "/world/forces/0_aliengo",
        "/world/path",
        "/world/plan",
        "/world/reference",
        "/world/trail",
        "/pushing/force/0_aliengo/commanded",
        "/pushing/force/0_aliengo/exerted",
        "/pushing/contact_offset/1_go1",
        "/goal/distance/position",
        "/goal/heading/heading_tolerance",
        "/safety/clearance/object",
        "/safety/barrier/robots",
        "/adaptation/mass/estimate",
        "/adaptation/mass/truth",
        "/solver/status/status",
    }
    assert expected <= set(chunks)


@pytest.mark.parametrize(
    ("entity", "rows"),
    [
        ("/world/object", ROWS),
        ("/world/robots/1_go1", ROWS),
        ("/world/obstacles/1_moving", ROWS),
        ("/world/obstacles/0_still", 1),
        ("/world/plan", ROWS // 2),  # 25 a second
        ("/world/path", 2),  # one search a second
        ("/pushing/force/0_aliengo/exerted", ROWS),
        ("/adaptation/mass/truth", 2),
    ],
)
def test_rows_without_the_frozen_ones(recorded, entity, rows):
    _, chunks = recorded
    assert sum(chunk.num_rows for chunk in chunks[entity] if not chunk.is_static) == rows


def test_object_moves_as_logged(recorded, made_up):
    _, chunks = recorded
    pose = made_up[1].log.view.pose[:ROWS]
    moving = [chunk for chunk in chunks["/world/object"] if not chunk.is_static]
    translation = np.array(column(moving, "translation")).reshape(-1, 3)
    np.testing.assert_allclose(translation[:, :2], pose[:, :2], atol=1e-6)
    quaternion = np.array(column(moving, "quaternion")).reshape(-1, 4)
    np.testing.assert_allclose(2.0 * np.arctan2(quaternion[:, 2], quaternion[:, 3]), pose[:, 2], atol=1e-6)
    assert [t.total_seconds() for t in column(moving, "sim_time")] == pytest.approx(
        made_up[1].log.time[:ROWS], abs=1e-6
    )


def test_force_arrows_start_at_the_contact(recorded, made_up):
    scenario, result = made_up
    _, chunks = recorded
    moving = [chunk for chunk in chunks["/world/forces/0_aliengo"] if not chunk.is_static]
    origins = np.array(column(moving, "origins")).reshape(-1, 3)
    vectors = np.array(column(moving, "vectors")).reshape(-1, 3)
    pose = result.log.view.pose[:ROWS]
    back = pose[:, :2] - 0.4 * np.stack([np.cos(pose[:, 2]), np.sin(pose[:, 2])], axis=1)
    np.testing.assert_allclose(origins[:, :2], back, atol=1e-6)  # the middle of the rear face of a 0.8 m box
    np.testing.assert_allclose(np.linalg.norm(vectors, axis=1), 0.01 * result.log.view.force[:ROWS, 0], atol=1e-6)


def test_alone_in_its_folder(recorded):
    path, _ = recorded
    assert [entry.name for entry in path.parent.iterdir()] == ["made_up.rrd"]


def test_single_robot_without_obstacles(made_up, tmp_path):
    scenario, result = made_up
    hidden = dataclasses.replace(scenario.obstacles, mask=np.zeros(2, bool))
    apart = dataclasses.replace(result.log.clearances, team=np.full(120, 1e3))
    log = dataclasses.replace(result.log, clearances=apart)
    write_recording(tmp_path / "a.rrd", "a", dataclasses.replace(scenario, obstacles=hidden), log)
    chunks = chunks_of(tmp_path / "a.rrd")
    assert not any(path.startswith("/world/obstacles/") for path in chunks)
    assert "/safety/clearance/team" not in chunks


def test_unwritable_place(made_up, tmp_path):
    scenario, result = made_up
    place = tmp_path / "file"
    place.write_text("mine")
    with pytest.raises(InputError, match=r"file/made_up\.rrd: cannot be written"):
        write_recording(place / "made_up.rrd", "made_up", scenario, result.log)
    assert place.read_text() == "mine"


def test_failure_leaves_the_old_file(made_up, tmp_path, monkeypatch):
    scenario, result = made_up
    path = tmp_path / "made_up.rrd"
    path.write_text("old")

    def full(*_):
        raise OSError(28, "No space left on device")

    monkeypatch.setattr("os.replace", full)
    with pytest.raises(InputError, match=r"made_up\.rrd: cannot be written \(No space left"):
        write_recording(path, "made_up", scenario, result.log)
    assert path.read_text() == "old"
    assert list(tmp_path.iterdir()) == [path]


def test_missing_rerun_names_the_extra(made_up, tmp_path, monkeypatch):
    scenario, result = made_up
    monkeypatch.setitem(sys.modules, "rerun", None)
    with pytest.raises(InputError, match=r'pip install "\.\[view\]"'):
        write_recording(tmp_path / "a.rrd", "a", scenario, result.log)
    assert not list(tmp_path.iterdir())
