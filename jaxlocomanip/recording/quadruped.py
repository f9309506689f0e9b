"""The shape of a quadruped: the geoms of its packaged MJCF, body by body or standing as one mesh.

Only the XML is read, so a recording needs no physics engine.
"""

from __future__ import annotations

import importlib.resources
from collections.abc import Iterator
from typing import Any, NamedTuple
from xml.etree import ElementTree

import numpy as np
from numpy.typing import NDArray

from jaxlocomanip.locomotion.robot import LEGS
from jaxlocomanip.recording import geometry
from jaxlocomanip.recording.geometry import Mesh
from jaxlocomanip.recording.palette import DARK, RGB
from jaxlocomanip.robots.model import load_robot

Floats = NDArray[np.floating[Any]]

_PAINT: dict[str, RGB] = {"dark": DARK, "accent": (245, 246, 248), "rubber": (24, 25, 28)}
"""Colours of the parts by material; the shell takes the robot's own colour."""


class Part(NamedTuple):
    """One body of a robot."""

    name: str
    mesh: Mesh
    """in the body's own frame"""
    rotation: Floats
    """[3, 3] of the body at the stand keyframe"""
    origin: Floats
    """[3] m, of the body at the stand keyframe"""


class Feet(NamedTuple):
    """Where the feet are, in the order of the legs."""

    body: NDArray[np.integer[Any]]
    """[4] which of the robot's bodies each of them belongs to"""
    center: Floats
    """[4, 3] m, in the frame of that body"""
    radius: Floats
    """[4] m"""


def parts(name: str, color: RGB) -> list[Part]:
    """A robot's bodies in the order of its MJCF, which is that of a world's bodies.

    Args:
      name: robot type, one of `robots.model.ROBOT_TYPES`.
      color: colour of the shell.
    """
    return [
        Part(body.attrib["name"], geometry.join([_solid(g, color) for g in body.findall("geom")]), rotation, origin)
        for body, rotation, origin in _placed_bodies(_read(name))
    ]


def feet(name: str) -> Feet:
    """The feet of a robot type."""
    found: dict[str, tuple[int, Floats, float]] = {}
    for index, (body, _, _) in enumerate(_placed_bodies(_read(name))):
        for geom in body.findall("geom[@name]"):
            center, size = _numbers(geom.get("pos", "0 0 0")), _numbers(geom.attrib["size"])
            found[geom.attrib["name"]] = index, center, float(size[0])
    body, center, radius = zip(*[found[f"{leg}_foot"] for leg in LEGS], strict=True)
    return Feet(np.array(body), np.stack(center), np.array(radius))


def stand_height(name: str) -> float:
    """Height of the trunk's origin, m, of a standing robot."""
    return float(next(_placed_bodies(_read(name)))[2][2])


def quadruped(name: str, color: RGB) -> Mesh:
    """A standing robot, its shell in `color`.

    Args:
      name: robot type, one of `robots.model.ROBOT_TYPES`.
      color: colour of the shell.

    Returns:
      Mesh in the frame of the robot's rectangle: origin on the ground under its centre, x along the heading,
      z up, m.
    """
    whole = geometry.join([geometry.moved(part.mesh, part.rotation, part.origin) for part in parts(name, color)])
    model = load_robot(name)
    # The keyframe's trunk is above the origin and lies `trunk_offset` behind the contact point.
    return geometry.moved(whole, np.eye(3), [model.reach - model.trunk_offset, 0.0, 0.0])


def _read(name: str) -> ElementTree.Element:
    path = importlib.resources.files("jaxlocomanip.robots").joinpath(f"{name}.xml")
    return ElementTree.fromstring(path.read_text(encoding="utf-8"))


def _placed_bodies(root: ElementTree.Element) -> Iterator[tuple[ElementTree.Element, Floats, Floats]]:
    """Every body with its rotation [3, 3] and its origin [3] m at the stand keyframe, in document order."""
    trunk, key = root.find("worldbody/body[@name='trunk']"), root.find("keyframe/key[@name='stand']")
    assert trunk is not None and key is not None, "every packaged robot has a trunk and a stand keyframe"
    qpos = _numbers(key.attrib["qpos"])
    angles = iter(qpos[7:])  # after the free joint, in document order
    axes = {
        d.attrib["class"]: _numbers(j.attrib["axis"]) for d in root.iter("default") for j in d.findall("joint[@axis]")
    }

    def walk(
        body: ElementTree.Element, rotation: Floats, origin: Floats
    ) -> Iterator[tuple[ElementTree.Element, Floats, Floats]]:
        for joint in body.findall("joint"):
            rotation = rotation @ _turn(axes[joint.attrib["class"]], next(angles))
        yield body, rotation, origin
        for child in body.findall("body"):
            yield from walk(child, rotation, origin + rotation @ _numbers(child.get("pos", "0 0 0")))

    yield from walk(trunk, np.eye(3), qpos[:3])


def _solid(geom: ElementTree.Element, color: RGB) -> Mesh:
    """A geom in the frame of its body."""
    size = _numbers(geom.attrib["size"])
    material = geom.get("material", "rubber").rpartition("_")[2]
    paint = _PAINT.get(material, color)
    center = _numbers(geom.get("pos", "0 0 0"))
    if geom.attrib["type"] == "box":
        return geometry.box(center, size, paint)
    if geom.attrib["type"] == "sphere":
        return geometry.capsule(center, center, size[0], paint)
    ends = _numbers(geom.attrib["fromto"])
    solid = geometry.capsule if geom.attrib["type"] == "capsule" else geometry.cylinder
    return solid(ends[:3], ends[3:], size[0], paint)


def _turn(axis: Floats, angle: float) -> Floats:
    """Rotation matrix [3, 3] about a unit axis (Rodrigues)."""
    x, y, z = axis
    cross = np.array([[0.0, -z, y], [z, 0.0, -x], [-y, x, 0.0]])
    return np.eye(3) + np.sin(angle) * cross + (1.0 - np.cos(angle)) * cross @ cross


def _numbers(text: str) -> Floats:
    return np.array([float(t) for t in text.split()])
