"""Meshes of an installed package: a made-up one is found, read and thinned; a broken one is passed over."""

import numpy as np
import pytest

from jaxlocomanip.recording import geometry
from jaxlocomanip.recording.history import history
from jaxlocomanip.recording.palette import DARK
from jaxlocomanip.recording.real_meshes import PACKAGE, read_stl, real_meshes, thinned

COLOR = (10, 20, 30)
LEGS = ("FR", "FL", "RR", "RL")


def corners_of(mesh):
    return mesh.vertices[mesh.triangles]


def write_stl(path, corners):
    """A binary STL as CAD programs write it, normals left zero."""
    record = np.zeros(len(corners), [("normal", "<f4", 3), ("corners", "<f4", (3, 3)), ("attribute", "<u2")])
    record["corners"] = corners
    path.write_bytes(b"made up".ljust(80) + len(corners).to_bytes(4, "little") + record.tobytes())


def leg(name):
    calf = (
        f'<body name="{name}_calf" pos="0 0 -.2"><geom class="visual" mesh="bar" quat="0 1 0 0" pos="0 0 .1"/></body>'
    )
    thigh = f'<body name="{name}_thigh"><geom class="visual" mesh="bar"/>{calf}</body>'
    return f'<body name="{name}_hip"><geom class="visual" mesh="bar"/><geom type="box" size="1 1 1"/>{thigh}</body>'


@pytest.fixture
def package(tmp_path, monkeypatch):
    """An installed package with an aliengo; its folder."""
    folder = tmp_path / PACKAGE / "robot_model" / "aliengo"
    (folder / "assets").mkdir(parents=True)
    # Importing it would fail: it must only be looked at.
    (tmp_path / PACKAGE / "__init__.py").write_text("raise RuntimeError\n")
    write_stl(folder / "assets" / "bar.stl", corners_of(geometry.box([0.1, 0.0, 0.02], [0.1, 0.01, 0.02], COLOR)))
    legs = "".join(leg(name) for name in LEGS)
    (folder / "aliengo.xml").write_text(
        '<mujoco><compiler meshdir="assets"/><asset><mesh file="bar.stl"/>'
        '<mesh name="long" file="bar.stl" scale="2 1 1"/></asset><worldbody><geom type="plane" size="1 1 1"/>'
        f'<body name="base"><freejoint/><geom mesh="long"/>{legs}</body></worldbody></mujoco>'
    )
    monkeypatch.syspath_prepend(tmp_path)
    return folder


def test_bodies_of_an_installed_robot(package):
    found = real_meshes("aliengo", COLOR)
    assert set(found) == {"trunk", *(f"{name}_{link}" for name in LEGS for link in ("hip", "thigh", "calf"))}
    np.testing.assert_allclose(np.ptp(found["trunk"].vertices, axis=0), [0.4, 0.02, 0.04], atol=1e-6)
    np.testing.assert_allclose(found["FR_hip"].vertices.min(axis=0), [0.0, -0.01, 0.0], atol=1e-6)
    # Half a turn about x and a shift upwards.
    np.testing.assert_allclose(found["FR_calf"].vertices.min(axis=0), [0.0, -0.01, 0.1 - 0.04], atol=1e-6)
    assert tuple(found["FR_hip"].colors[0]) == COLOR
    assert tuple(found["FR_calf"].colors[0]) == DARK


def test_a_robot_that_it_does_not_have(package):
    assert real_meshes("a1", COLOR) == {}


def test_no_package(monkeypatch):
    monkeypatch.setattr("importlib.util.find_spec", lambda name: None)
    assert real_meshes("aliengo", COLOR) == {}


@pytest.mark.parametrize("file", ["aliengo.xml", "assets/bar.stl"])
@pytest.mark.parametrize("content", [b"", b"solid made up", b"x" * 84])
def test_a_broken_package_is_passed_over(package, file, content):
    (package / file).write_bytes(content)
    assert real_meshes("aliengo", COLOR) == {}


def test_a_missing_mesh_is_passed_over(package):
    (package / "assets" / "bar.stl").unlink()
    assert real_meshes("aliengo", COLOR) == {}


def test_an_stl_that_is_text_is_refused(tmp_path):
    (tmp_path / "a.stl").write_text("solid a\nendsolid a\n" * 10)
    with pytest.raises(ValueError, match="is not a binary STL"):
        read_stl(tmp_path / "a.stl")


def test_thinning_keeps_the_shape():
    ball = geometry.capsule([0, 0, 0], [0, 0, 0], 0.1, COLOR, sides=200)
    mesh = thinned(corners_of(ball), COLOR)
    assert len(mesh.vertices) < len(ball.vertices)
    np.testing.assert_allclose(np.linalg.norm(mesh.vertices, axis=1), 0.1, atol=2e-3)
    outward = mesh.vertices / np.linalg.norm(mesh.vertices, axis=1, keepdims=True)
    assert np.min(np.sum(outward * mesh.normals, axis=1)) > 0.9
    assert mesh.triangles.max() < len(mesh.vertices)


def test_recording_shows_them(package, walking, tmp_path):
    pytest.importorskip("rerun")
    from rerun.chunk import RrdReader

    from jaxlocomanip.recording.rerun import write_recording
    from jaxlocomanip.recording.team import team

    scenario, result = walking
    write_recording(tmp_path / "a.rrd", "a", scenario, result.log)
    members = team(history(scenario, result.log))
    counts = {}
    for chunk in RrdReader(tmp_path / "a.rrd").stream().to_chunks():
        batch = chunk.to_record_batch()
        for name in batch.schema.names:
            if "vertex_positions" in name:
                counts[str(chunk.entity_path)] = len(batch.column(name).to_pylist()[0])
    assert counts["/world/robots/0_aliengo/FR_hip"] == 8  # of the bar
    # The package has no go1, which keeps its primitive solids.
    hip = next(part for part in members[1].parts if part.name == "FR_hip")
    assert counts["/world/robots/1_go1/FR_hip"] == len(hip.mesh.vertices)
