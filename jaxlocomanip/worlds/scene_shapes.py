"""What stands on the floor of a scene besides the robots, in MuJoCo's terms: floor and light, object, obstacles."""

# Most of MuJoCo's names come out of its C library, where pyright cannot see them.
# pyright: reportAttributeAccessIssue=false

from __future__ import annotations

from typing import Any

import jax.numpy as jnp
import mujoco
import numpy as np
from numpy.typing import NDArray

from jaxlocomanip.scenario import ObjectModel, Obstacles, Scenario

Floats = NDArray[np.floating[Any]]

OBSTACLE_HEIGHT = 0.5
"""m, obstacles are drawn this high; the planner knows no height"""
CORNER_RADIUS = 0.005
"""m, of the spheres that carry an object that is not a box"""
OBSTACLE_RGBA = (0.46, 0.50, 0.56, 1.0)
MOVING_RGBA = (0.81, 0.19, 0.24, 1.0)
OBJECT_RGBA = (0.79, 0.63, 0.41, 1.0)
FLOOR_RGB = ((0.87, 0.885, 0.90), (0.79, 0.81, 0.84))
SKY_RGB = ((0.93, 0.96, 1.0), (0.45, 0.62, 0.82))

_GEOM, _TEXTURE = mujoco.mjtGeom, mujoco.mjtTexture
_ROUND = 24
"""corners that stand for a whole circle in the hull of a rounded polygon"""


def add_floor(spec: mujoco.MjSpec) -> mujoco.MjsGeom:
    """The floor, an infinite plane named `floor`."""
    return spec.worldbody.add_geom(name="floor", type=_GEOM.mjGEOM_PLANE, size=[0, 0, 0.05], contype=0, conaffinity=0)


def add_scenery(spec: mujoco.MjSpec, floor: mujoco.MjsGeom, scenario: Scenario) -> None:
    """A sky, squares of 1 m on the floor, and a light whose shadows reach from the object's start to its goal."""
    start, goal = (np.asarray(pose, dtype=float)[:2] for pose in (scenario.start, scenario.goal.pose))
    middle = 0.5 * (start + goal)
    spec.stat.center = [*middle, 0.2]
    spec.stat.extent = max(4.0, float(np.linalg.norm(goal - start)))
    spec.add_texture(
        name="sky",
        type=_TEXTURE.mjTEXTURE_SKYBOX,
        builtin=mujoco.mjtBuiltin.mjBUILTIN_GRADIENT,
        rgb1=SKY_RGB[0],
        rgb2=SKY_RGB[1],
        width=256,
        height=1536,
    )
    spec.add_texture(
        name="checker",
        type=_TEXTURE.mjTEXTURE_2D,
        builtin=mujoco.mjtBuiltin.mjBUILTIN_CHECKER,
        mark=mujoco.mjtMark.mjMARK_EDGE,
        rgb1=FLOOR_RGB[0],
        rgb2=FLOOR_RGB[1],
        markrgb=FLOOR_RGB[1],
        width=256,
        height=256,
    )
    material = spec.add_material(name="floor", texrepeat=[1, 1], texuniform=True, reflectance=0.03)
    material.textures[mujoco.mjtTextureRole.mjTEXROLE_RGB] = "checker"
    floor.material = "floor"
    spec.worldbody.add_light(
        name="sun",
        type=mujoco.mjtLightType.mjLIGHT_DIRECTIONAL,
        pos=[*middle, 2.5],  # a higher one speckles the floor: the shadow map runs out of depth
        dir=[-0.3, 0.4, -1.0],
        diffuse=[0.55, 0.55, 0.52],
        specular=[0.2, 0.2, 0.2],
    )
    spec.visual.headlight.ambient = [0.35, 0.35, 0.37]
    spec.visual.headlight.diffuse = [0.35, 0.35, 0.35]
    spec.visual.headlight.specular = [0.05, 0.05, 0.05]
    spec.visual.quality.shadowsize = 4096
    spec.visual.global_.offwidth, spec.visual.global_.offheight = 1920, 1080
    spec.visual.global_.azimuth, spec.visual.global_.elevation = 125.0, -28.0


def footprint(shape: ObjectModel) -> Floats:
    """[V, 2] m, the corners of an object's footprint without the padding."""
    vertices = np.asarray(shape.vertices, dtype=float)
    different = np.linalg.norm(np.diff(vertices, axis=0), axis=1) > 1e-6
    return vertices[np.concatenate([[True], different])]


def as_rectangle(corners: Floats) -> tuple[Floats, Floats, float] | None:
    """Centre [2] m, half sizes [2] m and yaw in rad of a polygon [V, 2] that is a rectangle, else nothing."""
    if len(corners) != 4:
        return None
    a, b = corners[1] - corners[0], corners[2] - corners[1]
    closes = np.linalg.norm(corners[3] - corners[0] - b)
    lengths = np.linalg.norm(a), np.linalg.norm(b)
    if closes > 1e-5 * max(lengths) or abs(a @ b) > 1e-5 * lengths[0] * lengths[1]:
        return None
    return corners.mean(axis=0), 0.5 * np.array(lengths), float(np.arctan2(a[1], a[0]))


def solid_inertia(corners: Floats, height: float, mass: float, central_inertia: float) -> Floats:
    """Inertia tensor [3, 3] kg m^2 about its centre of mass of an upright prism.

    Mass is spread like that of the uniform prism, but drawn together or apart sideways until the moment about the
    vertical is `central_inertia`; so the tensor is that of real matter whatever its value.

    Args:
      corners: [V, 2] m, counter-clockwise.
      height: m.
      mass: kg.
      central_inertia: kg m^2, about the vertical through the centre of mass.
    """
    x, y = corners.T
    u, v = np.roll(corners, -1, axis=0).T
    area = x * v - u * y  # twice that of the triangle over each edge
    total = area.sum() / 2.0
    center = np.array([((x + u) * area).sum(), ((y + v) * area).sum()]) / (6.0 * total)
    xx, yy = ((p * p + p * q + q * q) @ area / 12.0 for p, q in ((x, u), (y, v)))
    xy = (x * v + 2.0 * x * y + 2.0 * u * v + u * y) @ area / 24.0
    plan = np.array([[xx, xy], [xy, yy]]) / total - np.outer(center, center)
    spread = np.zeros((3, 3))
    spread[:2, :2] = plan * central_inertia / (mass * np.trace(plan))
    spread[2, 2] = height**2 / 12.0
    return mass * (np.trace(spread) * np.eye(3) - spread)


def add_object(spec: mujoco.MjSpec, shape: ObjectModel, mass: float, com: Floats, inertia: float) -> list[str]:
    """The pushed object, a free body named `object` with its origin at the body point p, at its lower face.

    Its shape is the geom `object`: a box, or a mesh for any other footprint. MuJoCo rests a mesh on at most three
    points, which may leave the centre of mass outside; such an object stands on a small sphere in each corner.

    Args:
      spec: the scene.
      shape: footprint and height.
      mass: kg.
      com: [2] m, centre of mass from p; at half the height.
      inertia: kg m^2, about the vertical through the centre of mass.

    Returns:
      Names of the geoms that touch the floor.
    """
    corners, height = footprint(shape), float(shape.height)
    body = spec.worldbody.add_body(name="object")
    body.add_freejoint(name="object")
    tensor = solid_inertia(corners, height, mass, inertia)
    body.explicitinertial = True
    body.mass, body.ipos = mass, [*com, 0.5 * height]
    body.fullinertia = [*np.diag(tensor), tensor[0, 1], tensor[0, 2], tensor[1, 2]]
    silent: dict[str, Any] = {"mass": 0.0, "contype": 0, "conaffinity": 0}
    box = as_rectangle(corners)
    if box is not None:
        (x, y), half, yaw = box
        body.add_geom(
            name="object",
            type=_GEOM.mjGEOM_BOX,
            size=[*half, 0.5 * height],
            pos=[x, y, 0.5 * height],
            quat=[np.cos(0.5 * yaw), 0.0, 0.0, np.sin(0.5 * yaw)],
            rgba=OBJECT_RGBA,
            **silent,
        )
        return ["object"]
    _add_prism(spec, "object", corners, height)
    body.add_geom(name="object", type=_GEOM.mjGEOM_MESH, meshname="object", rgba=OBJECT_RGBA, **silent)
    feet = [f"object_corner{i}" for i in range(len(corners))]
    for name, (x, y) in zip(feet, corners, strict=True):
        place, size = [x, y, CORNER_RADIUS], [CORNER_RADIUS, 0, 0]
        body.add_geom(name=name, type=_GEOM.mjGEOM_SPHERE, size=size, pos=place, group=3, **silent)
    return feet


def add_obstacles(spec: mujoco.MjSpec, obstacles: Obstacles) -> tuple[int, ...]:
    """Obstacles to look at; nothing collides with them. Those that may move are mocap bodies.

    Returns:
      [N_o] number of each obstacle among the mocap bodies; -1 for one at rest or absent.
    """
    positions = np.asarray(obstacles.at(jnp.zeros(())), dtype=float)
    dynamic, mask = np.asarray(obstacles.dynamic), np.asarray(obstacles.mask)
    numbers = []
    for i in range(len(mask)):
        moves = bool(dynamic[i] and mask[i])
        numbers.append(1 + max(numbers, default=-1) if moves else -1)
        if not mask[i]:
            continue
        body = spec.worldbody.add_body(name=f"obstacle{i}", pos=[*positions[i], 0.0], mocap=moves)
        look: dict[str, Any] = {"rgba": MOVING_RGBA if moves else OBSTACLE_RGBA, "contype": 0, "conaffinity": 0}
        vertices, radius = np.asarray(obstacles.vertices[i], dtype=float), float(obstacles.radius[i])
        if np.ptp(vertices, axis=0).max() < 1e-9:
            size, place = [radius, 0.5 * OBSTACLE_HEIGHT, 0], [*vertices[0], 0.5 * OBSTACLE_HEIGHT]
            body.add_geom(type=_GEOM.mjGEOM_CYLINDER, size=size, pos=place, **look)
            continue
        if radius > 0.0:
            turns = 2.0 * np.pi * np.arange(_ROUND) / _ROUND
            rim = radius * np.stack([np.cos(turns), np.sin(turns)], axis=1)
            vertices = (vertices[:, None] + rim).reshape(-1, 2)
        _add_prism(spec, f"obstacle{i}", np.unique(vertices, axis=0), OBSTACLE_HEIGHT)
        body.add_geom(type=_GEOM.mjGEOM_MESH, meshname=f"obstacle{i}", **look)
    return tuple(numbers)


def _add_prism(spec: mujoco.MjSpec, name: str, points: Floats, height: float) -> None:
    """An upright mesh on z = 0 over the convex hull of points [V, 2]; without faces MuJoCo takes the hull."""
    layers = [np.column_stack([points, np.full(len(points), z)]) for z in (0.0, height)]
    spec.add_mesh(name=name, uservert=np.concatenate(layers).ravel())
