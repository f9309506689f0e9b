"""Plane vectors with their components apart.

Arithmetic over many small vectors stored as [..., 2] runs along an axis of length two. With one array a component it
runs along whatever the last axis counts, be it stages of a horizon or lanes of a batch, in contiguous memory.
"""

from __future__ import annotations

from typing import Any

import jax.numpy as jnp
from jax import Array

from jaxlocomanip.numerics import Floats, pytree, sine_and_cosine


@pytree
class Vector:
    """Plane vectors; the components are arrays of one shape [...]."""

    x: Array
    y: Array

    def __add__(self, other: Vector) -> Vector:
        return Vector(self.x + other.x, self.y + other.y)

    def __sub__(self, other: Vector) -> Vector:
        return Vector(self.x - other.x, self.y - other.y)

    def __mul__(self, factor: Floats) -> Vector:
        return Vector(self.x * factor, self.y * factor)

    def __getitem__(self, index: Any) -> Vector:
        return Vector(self.x[index], self.y[index])

    @property
    def turned(self) -> Vector:
        """Turned by +90 degrees; equals e_z x v."""
        return Vector(-self.y, self.x)

    def dot(self, other: Vector) -> Array:
        """Inner products [...]."""
        return self.x * other.x + self.y * other.y

    def cross(self, other: Vector) -> Array:
        """Scalar cross products [...]."""
        return self.x * other.y - self.y * other.x

    def rotated(self, direction: Vector) -> Vector:
        """Turned by the angle whose cosine and sine are the components of `direction`."""
        return Vector(
            direction.x * self.x - direction.y * self.y,
            direction.y * self.x + direction.x * self.y,
        )


def vector(array: Array) -> Vector:
    """Of an array [2, ...], components first."""
    return Vector(array[0], array[1])


def vectors(array: Array) -> Vector:
    """Of an array [..., 2], components last."""
    return Vector(array[..., 0], array[..., 1])


def unit(angle: Array) -> Vector:
    """Unit vectors [...] at angles [...], rad."""
    sine, cosine = sine_and_cosine(angle)
    return Vector(cosine, sine)


def choose(condition: Array, yes: Vector, no: Vector) -> Vector:
    """`yes` where the condition [...] holds, elsewhere `no`."""
    return Vector(jnp.where(condition, yes.x, no.x), jnp.where(condition, yes.y, no.y))


def trailing(values: Array, like: Array) -> Array:
    """`values` with axes of length one appended, as many as `like` has more: they broadcast along the first axes."""
    return values.reshape(values.shape + (1,) * (like.ndim - values.ndim))
