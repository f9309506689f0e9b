"""Recordings of worlds with bodies: every body in its place, forces where they act, names and plots for people."""

import dataclasses
import subprocess
import sys

import jax
import numpy as np
import pytest

from jaxlocomanip.checked import InputError
from jaxlocomanip.recording import geometry
from jaxlocomanip.recording.history import STRIDE, history, rotated, stride_mean
from jaxlocomanip.recording.quadruped import feet, parts, quadruped, stand_height
from jaxlocomanip.recording.rerun import write_recording
from jaxlocomanip.recording.series import plots
from jaxlocomanip.recording.team import team
from jaxlocomanip.robots.model import ROBOT_TYPES, load_robot

pytest.importorskip("rerun")

ROWS = 100  # 2 s of duration, a tick every 20 ms
BODIES = 13  # trunk, and hip, thigh and calf of four legs


def chunks_of(path):
    """Chunks of a recording by entity path."""
    from rerun.chunk import RrdReader

    found = {}
    for chunk in RrdReader(path).stream().to_chunks():
        found.setdefault(str(chunk.entity_path), []).append(chunk)
    return found


def rows_of(chunks, part):
    """Every row of the first moving column whose name contains `part`."""
    for chunk in chunks:
        batch = chunk.to_record_batch()
        for name in batch.schema.names:
            if part in name and not chunk.is_static:
                return batch.column(name).to_pylist()
    raise AssertionError(f"no column {part}")


def moving(chunks, part, width):
    """[T, width] one item a row."""
    return np.array(rows_of(chunks, part)).reshape(-1, width)


@pytest.fixture(scope="module")
def recorded(walking, tmp_path_factory):
    path = tmp_path_factory.mktemp("bodies") / "walking.rrd"
    scenario, result = walking
    write_recording(path, "walking", scenario, result.log)
    return path, chunks_of(path)


def test_file_is_sound_and_small(recorded):
    assert recorded[0].stat().st_size < 2_000_000  # most of it meshes, which are there once
    command = [sys.executable, "-m", "rerun", "rrd", "verify", str(recorded[0])]
    assert subprocess.run(command, capture_output=True, check=False).returncode == 0


def test_a_mesh_and_a_motion_for_each_body(recorded):
    _, chunks = recorded
    for robot in ("0_aliengo", "1_go1"):
        bodies = [found for path, found in chunks.items() if path.startswith(f"/world/robots/{robot}/")]
        assert len(bodies) == BODIES
        for found in bodies:
            names = [name for c in found if c.is_static for name in c.to_record_batch().schema.names]
            assert sum("vertex_positions" in name for name in names) == 1
            assert sum(c.num_rows for c in found if not c.is_static) == ROWS


def test_bodies_move_as_logged(recorded, walking):
    _, chunks = recorded
    bodies = walking[1].log.view.bodies
    for path, row in (("object", 0), ("robots/0_aliengo/trunk", 1), ("robots/1_go1/RL_calf", 26)):
        found = chunks[f"/world/{path}"]
        np.testing.assert_allclose(moving(found, "translation", 3), bodies.position[:ROWS, row], atol=1e-6)
        wxyz = np.roll(moving(found, "quaternion", 4), 1, axis=1)
        np.testing.assert_allclose(wxyz, bodies.quaternion[:ROWS, row], atol=1e-6)


def test_foot_forces_stand_under_loaded_feet(recorded):
    _, chunks = recorded
    found = chunks["/world/foot_forces/1_go1"]
    origins, vectors = rows_of(found, "origins"), rows_of(found, "vectors")
    assert [len(row) for row in origins] == [2] * ROWS
    np.testing.assert_allclose(np.array(origins)[..., 2], 0.0, atol=2e-3)
    np.testing.assert_allclose(np.array(vectors), np.broadcast_to([0.01, 0.0, 0.2], (ROWS, 2, 3)), atol=1e-6)


def test_measured_and_commanded_forces_side_by_side(recorded, walking):
    _, chunks = recorded
    view, lengths = walking[1].log.view, {}
    for key in ("measured", "commanded"):
        found = chunks[f"/world/forces/0_aliengo/{key}"]
        off = moving(found, "origins", 3) - view.bodies.contact_point[:ROWS, 0]
        np.testing.assert_allclose(np.linalg.norm(off[:, :2], axis=1), 0.045, atol=1e-6)
        np.testing.assert_allclose(off[:, 2], 0.4 + 0.06 - 0.3, atol=1e-6)  # over the object, which is 0.4 m high
        lengths[key] = np.linalg.norm(moving(found, "vectors", 3), axis=1)
    np.testing.assert_allclose(lengths["measured"], 0.01 * view.force[:ROWS, 0], atol=1e-6)
    np.testing.assert_allclose(lengths["commanded"], 0.25, atol=1e-6)


def test_names_in_the_scene(recorded):
    _, chunks = recorded
    expected = {"goal", "obstacle_0", "obstacle_1", "0_aliengo", "1_go1"}
    assert {path.removeprefix("/world/labels/") for path in chunks if path.startswith("/world/labels/")} == expected
    assert len(rows_of(chunks["/world/labels/obstacle_0"], "positions")) == 1
    assert len(rows_of(chunks["/world/labels/obstacle_1"], "positions")) == ROWS


def test_curves(walking):
    curves = {
        f"{plot.path}/{line.key}": line.values
        for plot in plots(history(walking[0], walking[1].log))
        for line in plot.lines
    }
    np.testing.assert_allclose(curves["pushing/force/1_go1/commanded"], 25.0)
    np.testing.assert_allclose(curves["pushing/force/1_go1/measured_mean"], 20.0)
    np.testing.assert_allclose(curves["walking/height/1_go1"], stand_height("go1"))
    np.testing.assert_allclose(curves["walking/tilt/0_aliengo"], 0.0, atol=1e-4)
    assert set(curves["walking/feet/0_aliengo/FR"]) == {0.0, 100.0}
    np.testing.assert_allclose(curves["walking/feet/0_aliengo/FR"] + curves["walking/feet/0_aliengo/FL"], 100.0)


def test_no_walking_in_the_plane(made_up):
    assert not any(plot.tab == "Walking" for plot in plots(history(made_up[0], made_up[1].log)))


def test_one_tick(walking, tmp_path):
    scenario, result = walking
    write_recording(tmp_path / "a.rrd", "a", scenario, jax.tree.map(lambda leaf: leaf[:1], result.log))
    assert "/world/robots/0_aliengo/trunk" in chunks_of(tmp_path / "a.rrd")


def test_feet_in_the_air(walking, tmp_path):
    scenario, result = walking
    view = result.log.view
    flying = dataclasses.replace(view.bodies, foot_force=np.zeros_like(view.bodies.foot_force))
    log = dataclasses.replace(result.log, view=dataclasses.replace(view, bodies=flying))
    write_recording(tmp_path / "a.rrd", "a", scenario, log)
    assert not any(rows_of(chunks_of(tmp_path / "a.rrd")["/world/foot_forces/1_go1"], "vectors"))


def test_strange_bodies_are_refused(walking, tmp_path):
    scenario, result = walking
    view = result.log.view
    fewer = jax.tree.map(lambda leaf: leaf[:, :-1], view.bodies)
    log = dataclasses.replace(result.log, view=dataclasses.replace(view, bodies=fewer))
    with pytest.raises(InputError, match="has 26 bodies: .* have 27"):
        write_recording(tmp_path / "a.rrd", "a", scenario, log)
    assert not list(tmp_path.iterdir())


def test_team(walking):
    first, second = team(history(walking[0], walking[1].log))
    assert (first.kind, first.first, second.kind, second.first) == ("aliengo", 1, "go1", 1 + BODIES)


@pytest.mark.parametrize("kind", ROBOT_TYPES)
def test_parts_make_the_standing_robot(kind):
    placed = [geometry.moved(p.mesh, p.rotation, p.origin) for p in parts(kind, (1, 2, 3))]
    model, whole = load_robot(kind), quadruped(kind, (1, 2, 3))
    shift = np.array([model.reach - model.trunk_offset, 0.0, 0.0])
    np.testing.assert_allclose(geometry.join(placed).vertices + shift, whole.vertices, atol=1e-12)
    names = [p.name for p in parts(kind, (1, 2, 3))]
    assert names == [
        "trunk",
        *(f"{leg}_{link}" for leg in ("FR", "FL", "RR", "RL") for link in ("hip", "thigh", "calf")),
    ]


@pytest.mark.parametrize("kind", ROBOT_TYPES)
def test_soles_of_a_standing_robot_are_on_the_ground(kind):
    found, bodies = feet(kind), parts(kind, (0, 0, 0))
    for body, center, radius in zip(*found, strict=True):
        place = bodies[body].origin + bodies[body].rotation @ center
        assert place[2] == pytest.approx(radius, abs=2e-3)
    assert [bodies[body].name for body in found.body] == ["FR_calf", "FL_calf", "RR_calf", "RL_calf"]


def test_stride_mean_removes_the_stride_and_keeps_the_rest():
    time = 0.02 * np.arange(200)
    force = 30.0 + 10.0 * np.sin(2.0 * np.pi * time / STRIDE)
    np.testing.assert_allclose(stride_mean(force, time)[20:-20], 30.0, atol=0.5)
    np.testing.assert_allclose(stride_mean(time[:, None], time)[20:-20, 0], time[20:-20])
    np.testing.assert_array_equal(stride_mean(force[:1], time[:1]), force[:1])


def test_rotated():
    quarter = np.sqrt(0.5) * np.array([[1.0, 0.0, 0.0, 1.0], [1.0, 1.0, 0.0, 0.0]])
    np.testing.assert_allclose(rotated(quarter, np.array([0.0, 1.0, 0.0])), [[-1, 0, 0], [0, 0, 1]], atol=1e-12)


def test_companion_sees_all_of_the_start(walking):
    from jaxlocomanip.recording.blueprint import CloseUp, companion
    from jaxlocomanip.recording.bodies import start_points

    center, points = start_points(history(walking[0], walking[1].log))
    eye, target = companion(CloseUp("world/object", center, points), np.array([2.0, 0.5]))
    forward = (target - eye) / np.linalg.norm(target - eye)
    depth = (points - eye) @ forward
    assert depth.min() > 0.0
    across = np.linalg.norm((points - eye) - depth[:, None] * forward, axis=1) / depth
    assert 0.3 < across.max() < 1.0
    assert eye[2] > 0.5 and forward[2] < 0.0
