"""A path of object poses with its steady pushes, read by arc length."""

from __future__ import annotations

import dataclasses

import jax
import jax.numpy as jnp
from jax import Array

from jaxlocomanip.numerics import Floats, pytree, wrap_angle
from jaxlocomanip.planar.dynamics import Body
from jaxlocomanip.planar.geometry import perpendicular, rotate
from jaxlocomanip.planner.authority import share, sliding_wrench
from jaxlocomanip.planner.shapes import Shapes
from jaxlocomanip.scenario import Goal, Team

UNPLANNED = 1e4
"""cost of a path that nobody has planned"""
POINTS = 128
"""points of a path"""
_AHEAD = 6
"""points to both sides that a limit of the speed extends to"""
_BRAKING = 1.2
"""m/s^2, with which friction stops the object at least"""
_STANDOFF, _LEAST_ROOM = 0.02, 0.04
"""m, left where the object could stop, and the room below which paths get no slower"""
_WINDOW = 2
"""half-width, in points, of the window that smooths a path"""


@pytree
class Aim:
    """Where a path leads: to the goal, or to where the team walks around the object to push at other faces."""

    goal: Goal
    """pose to come to rest at, and how precisely"""
    formation: Array
    """[] int, formation to take there; the present one at the goal itself"""
    beyond: Array
    """[] m, cost of the walk and of the way after it"""


@pytree
class Path:
    """Polyline of poses with its arc length."""

    poses: Array
    """[POINTS, 3] m, m, rad (continuous heading)"""
    arc: Array
    """[POINTS] m, generalised length, in which a turn counts v_avg / w_avg per rad"""
    force: Array
    """[POINTS, N_r] steady push along the path, in multiples of F_c"""
    offset: Array
    """[POINTS, N_r] m, contact offsets of that push"""
    walk: Array
    """[POINTS] largest sideways walking speed of a robot per unit of arc rate, as a fraction of what it can; > 0"""
    cost: Array
    """[] m, of the way to its aim"""
    aim: Aim
    """where it leads"""

    @property
    def length(self) -> Array:
        """[] m."""
        return self.arc[-1]

    def at(self, s: Array) -> Array:
        """[..., 3] poses at arc lengths [...]; held at the ends."""
        return self._read(s, self.poses)

    def feed_forward(self, s: Array) -> tuple[Array, Array]:
        """Pushes [..., N_r], in multiples of F_c, and contact offsets [..., N_r] m, at arc lengths [...]."""
        return self._read(s, self.force), self._read(s, self.offset)

    def speed_limit(self, s: Array) -> Array:
        """[...] m/s of arc at which some robot would have to walk sideways as fast as it can, at arc lengths [...]."""
        return 1.0 / self._read(s, self.walk[:, None])[..., 0]

    def _read(self, s: Array, values: Array) -> Array:
        # The arc is evenly spaced, so that no search is needed.
        where = jnp.clip(s / jnp.maximum(self.length, 1e-6), 0.0, 1.0) * (POINTS - 1)
        # Where a place is a point but for its rounding, the compiler may round it one way for the index and another way
        # for the part, and read a whole point off; places just before a point are not as common.
        low = jnp.minimum((where + 1e-3).astype(jnp.int32), POINTS - 2)
        part = (where - low)[..., None]
        return (1.0 - part) * values[low] + part * values[low + 1]


def straight_poses(start: Array, goal: Array, count: int) -> Array:
    """[count, 3] poses on a straight line between two poses [3], the heading turning evenly the shorter way."""
    end = jnp.concatenate([goal[:2], start[2:] + wrap_angle(goal[2:] - start[2:])])
    blend = jnp.linspace(0.0, 1.0, count, dtype=start.dtype)[:, None]
    return start + blend * (end - start)


def at_goal(goal: Goal, formation: Array) -> Aim:
    """The goal itself, with the team as it is."""
    return Aim(goal, formation, jnp.zeros_like(goal.position_tolerance))


def unsearched(pose: Array, robots: int, aim: Aim) -> Path:
    """A path that stays at a pose [3], until the first search."""
    poses = jnp.tile(pose, (POINTS, 1))
    still = jnp.zeros((POINTS, robots), pose.dtype)
    return Path(
        poses,
        jnp.zeros_like(poses[:, 0]),
        still,
        still,
        jnp.ones_like(poses[:, 0]),
        jnp.full((), UNPLANNED, pose.dtype),
        aim,
    )


def pace(
    poses: Array,
    shapes: Shapes,
    body: Body,
    turn_radius: Floats,
    cost: Floats = UNPLANNED,
    aim: Aim | None = None,
) -> Path:
    """Path through poses [n, 3], smoothed with its ends kept and evenly spaced, with its steady pushes.

    It leads to its last pose, give or take 1 m and 1 rad, unless an aim is given.
    """
    even = resample(resample(poses, turn_radius)[0], turn_radius)[0]
    window = jnp.hanning(2 * _WINDOW + 3)[1:-1].astype(poses.dtype)
    head = 2.0 * even[:1] - even[_WINDOW:0:-1]
    tail = 2.0 * even[-1:] - even[-2 : -_WINDOW - 2 : -1]
    padded = jnp.concatenate([head, even, tail])
    smooth = jax.vmap(lambda v: jnp.convolve(v, window / jnp.sum(window), mode="valid"), 1, 1)(padded)
    final, arc = resample(smooth, turn_radius)
    force, offset = steady_pushes(final, shapes, body)
    walk = sideways(final, arc, offset, jnp.zeros_like(offset), shapes.team)
    one = jnp.ones((), arc.dtype)
    aim = at_goal(Goal(final[-1], one, one), jnp.zeros((), jnp.int32)) if aim is None else aim
    return Path(final, arc, force, offset, walk, jnp.asarray(cost, arc.dtype), aim)


def with_pushes(path: Path, force: Array, offset: Array, room: Array, team: Team) -> Path:
    """The path with pushes, contact offsets [n, N_r] and room to obstacles [n] m at the middles of n even parts."""
    count = force.shape[0]
    middles = (jnp.arange(count, dtype=force.dtype) + 0.5) / count
    where = jnp.linspace(0.0, 1.0, POINTS, dtype=force.dtype)

    def spread(values: Array) -> Array:
        return jax.vmap(lambda v: jnp.interp(where, middles, v), 1, 1)(values)

    force, offset = spread(force), spread(offset)
    # Slow enough past an obstacle to stop before it.
    stop = jnp.maximum(spread(room[:, None])[:, 0], _LEAST_ROOM) - _STANDOFF
    slow = 1.0 / jnp.sqrt(2.0 * _BRAKING * stop)
    walk = jnp.maximum(sideways(path.poses, path.arc, offset, _slope(offset), team), _widest(slow))
    return dataclasses.replace(path, force=force, offset=offset, walk=walk)


def steady_pushes(poses: Array, shapes: Shapes, body: Body) -> tuple[Array, Array]:
    """Pushes [n, N_r], in multiples of F_c, and contact offsets [n, N_r] that slide the object along poses [n, 3]."""
    ratio = body.friction_moment / jnp.maximum(body.friction_force, 1e-3)
    one = jnp.ones_like(ratio)
    unit = Body(body.mass, body.inertia, body.com, one, jnp.maximum(ratio, 0.5 * shapes.torsion_radius))
    change = _slope(poses)

    def at(pose: Array, direction: Array) -> tuple[Array, Array]:
        scale = jnp.sqrt(jnp.sum(direction**2)) + 1e-6
        twist_B = jnp.concatenate([rotate(-pose[2], direction[:2]), direction[2:]]) / scale
        force, arms, _ = share(
            shapes.team,
            sliding_wrench(unit, twist_B, 0.0),
            shapes.torsion_radius,
            shapes.team.force_max / jnp.maximum(body.friction_force, 1.0),
        )
        # A robot that hardly pushes here keeps to the middle of its face.
        return force, arms * force / (force + 0.05)

    return jax.vmap(at)(poses, change)


def sideways(poses: Array, arc: Array, offset: Array, slide: Array, team: Team) -> Array:
    """[n] sideways speed of the busiest robot, relative to its limit, per unit of arc rate.

    Args:
      poses: [n, 3] along the path.
      arc: [n] m.
      offset: [n, N_r] m, contact offsets there.
      slide: [n, N_r] m, their change per point.
      team: the robots.
    """
    spacing = jnp.maximum(arc[1], 1e-6)

    def at(pose: Array, rate: Array, d: Array, along: Array) -> Array:
        points = team.contact_points(d)
        velocity = rotate(-pose[2], rate[:2]) + rate[2] * perpendicular(points)
        return jnp.max(jnp.abs(jnp.sum(velocity * team.tangent, axis=-1) + along) / team.slide_speed_max)

    each = jax.vmap(at)(poses, _slope(poses) / spacing, offset, slide / spacing)
    return jnp.maximum(_widest(each), 0.1)


def _widest(values: Array) -> Array:
    """[n] the largest of neighbours: slow down before a bend, not in it."""
    padded = jnp.pad(values, _AHEAD, mode="edge")
    return jnp.max(jnp.stack([padded[i : i + POINTS] for i in range(2 * _AHEAD + 1)]), axis=0)


def _slope(poses: Array) -> Array:
    """[n, k] change per point of values [n, k], by central differences."""
    padded = jnp.concatenate([2.0 * poses[:1] - poses[1:2], poses, 2.0 * poses[-1:] - poses[-2:-1]])
    return 0.5 * (padded[2:] - padded[:-2])


def resample(poses: Array, turn_radius: Floats, count: int = POINTS) -> tuple[Array, Array]:
    """[count, 3] poses evenly spaced along a polyline [n, 3], and their arc lengths [count]."""
    change = jnp.diff(poses, axis=0)
    steps = jnp.sqrt(jnp.sum(change[:, :2] ** 2, axis=1) + (turn_radius * change[:, 2]) ** 2)
    arc = jnp.concatenate([jnp.zeros(1, poses.dtype), jnp.cumsum(steps + 1e-6)])
    even = jnp.linspace(0.0, 1.0, count, dtype=poses.dtype) * arc[-1]
    return jnp.stack([jnp.interp(even, arc, poses[:, i]) for i in range(3)], axis=1), even
