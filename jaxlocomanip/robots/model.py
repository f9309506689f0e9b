"""What the planner knows about a robot, read from its packaged MJCF so that no number is typed twice.

Only the XML is read: the planner and the planar world never need MuJoCo.
"""

from __future__ import annotations

import dataclasses
import difflib
import functools
import importlib.resources
import math
from collections.abc import Iterator
from xml.etree import ElementTree

ROBOT_TYPES: tuple[str, ...] = ("aliengo", "a1", "go1")
"""Names `load_robot` accepts."""

GRAVITY = 9.81
"""Gravitational acceleration, m/s^2."""

PUSH_FRICTION = 0.3
"""Foot friction coefficient behind `push_force_max`: a robot cannot push harder than its feet hold.

0.3 is cautious for rubber feet and gives Aliengo 72.5 N.
"""

PUSH_SPEED_MAX = 1.0
"""Largest forward speed while pushing, m/s; a trot does more without a load."""

SLIDE_SPEED_MAX = 0.5
"""Largest sideways walking speed along the object's face, m/s.

A trot tracks 0.2 to 0.4 m/s sideways within 1 %; 0.5 is taken as its limit.
"""

_FEET = ("FR_foot", "FL_foot", "RR_foot", "RL_foot")
_Point = tuple[float, float, float]


@dataclasses.dataclass(frozen=True)
class RobotModel:
    """A quadruped as the planner sees it: a mass, a rectangle in plan view and limits on what it can do.

    The rectangle bounds the standing robot: from the rearmost point of trunk and hips to the front of the
    pusher, and as wide as feet and hips reach. The robot pushes with the middle of the front edge.
    """

    name: str
    """Robot type, one of `ROBOT_TYPES`."""
    mass: float
    """Total mass, kg."""
    half_length: float
    """Half the rectangle's length, along the robot's heading, m."""
    half_width: float
    """Half the rectangle's width, m."""
    reach: float
    """Distance from the contact point back to the rectangle's centre, m."""
    trunk_offset: float
    """Distance from the contact point back to the trunk's origin, m."""
    push_force_max: float
    """Largest push force, N: `PUSH_FRICTION` times the weight."""
    push_speed_max: float = PUSH_SPEED_MAX
    """Largest forward speed while pushing, m/s."""
    slide_speed_max: float = SLIDE_SPEED_MAX
    """Largest sideways speed along the object's face, m/s."""


@functools.cache
def load_robot(name: str) -> RobotModel:
    """Read a robot's numbers from its packaged MJCF.

    Args:
      name: robot type, one of `ROBOT_TYPES`.

    Returns:
      The robot's model; the same object for every call with one name.

    Raises:
      ValueError: the robot type is unknown.
    """
    if name not in ROBOT_TYPES:
        raise ValueError(_unknown_type(name))
    path = importlib.resources.files("jaxlocomanip.robots").joinpath(f"{name}.xml")
    root = ElementTree.fromstring(path.read_text(encoding="utf-8"))
    mass = sum(float(inertial.attrib["mass"]) for inertial in root.iter("inertial"))

    rear, side = math.inf, 0.0
    front = math.nan
    for body, geom, origin in _geoms(root):
        centre, extent = _bounds(geom, origin)
        if geom.get("name") == "pusher":
            front = centre[0] + extent[0]
        elif body == "trunk" or body.endswith("_hip"):
            rear = min(rear, centre[0] - extent[0])
        if geom.get("name") in _FEET or body.endswith("_hip"):
            side = max(side, abs(centre[1]) + extent[1])

    half_length = 0.5 * (front - rear)
    return RobotModel(
        name=name,
        mass=mass,
        half_length=half_length,
        half_width=side,
        reach=half_length,  # the pusher's front is the rectangle's front edge
        trunk_offset=front,
        push_force_max=PUSH_FRICTION * mass * GRAVITY,
    )


def _unknown_type(name: object) -> str:
    """The sentence that refuses a robot type."""
    nearest = difflib.get_close_matches(str(name).lower(), ROBOT_TYPES, n=1, cutoff=0.0)
    return f"robot type = {name!r}: must be one of {', '.join(ROBOT_TYPES)}; did you mean {nearest[0]!r}?"


def _geoms(root: ElementTree.Element) -> Iterator[tuple[str, ElementTree.Element, _Point]]:
    """Every geom with its body's name and its body's origin in the trunk frame, m.

    Origins are summed without rotating anything. That is exact in x for trunk and hips, which are not turned
    at the stand pose, and in y for feet too: at a hip angle of zero a leg moves in a plane of constant y.
    """
    trunk = root.find("worldbody/body[@name='trunk']")
    assert trunk is not None, "every packaged robot has a body named trunk"
    stack: list[tuple[ElementTree.Element, _Point]] = [(trunk, (0.0, 0.0, 0.0))]
    while stack:
        body, origin = stack.pop()
        for geom in body.findall("geom"):
            yield body.attrib["name"], geom, origin
        stack.extend((child, _add(origin, _point(child.get("pos")))) for child in body.findall("body"))


def _bounds(geom: ElementTree.Element, origin: _Point) -> tuple[_Point, _Point]:
    """Centre and half-extents of a geom's axis-aligned box, m, in the axes of the trunk."""
    size = [float(s) for s in geom.attrib["size"].split()]
    if geom.get("type") == "box":
        return _add(origin, _point(geom.get("pos"))), _point(geom.get("size"))
    if geom.get("type") == "sphere":
        return _add(origin, _point(geom.get("pos"))), (size[0], size[0], size[0])
    # Capsule or cylinder: half the segment plus the radius; a cylinder's flat ends add none along its axis.
    numbers = [float(s) for s in geom.attrib["fromto"].split()]
    half = [0.5 * (b - a) for a, b in zip(numbers[:3], numbers[3:], strict=True)]
    middle = (
        0.5 * (numbers[0] + numbers[3]),
        0.5 * (numbers[1] + numbers[4]),
        0.5 * (numbers[2] + numbers[5]),
    )
    length = math.hypot(*half)
    if geom.get("type") == "cylinder":
        round_off = [size[0] * math.sqrt(max(0.0, 1.0 - (h / length) ** 2)) for h in half]
    else:
        round_off = [size[0]] * 3
    extent = (abs(half[0]) + round_off[0], abs(half[1]) + round_off[1], abs(half[2]) + round_off[2])
    return _add(origin, middle), extent


def _point(text: str | None) -> _Point:
    """Three numbers of an MJCF attribute; the origin if it is missing."""
    x, y, z = (float(s) for s in (text or "0 0 0").split())
    return x, y, z


def _add(a: _Point, b: _Point) -> _Point:
    """Sum of two points, m."""
    return a[0] + b[0], a[1] + b[1], a[2] + b[2]
