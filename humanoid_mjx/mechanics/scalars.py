"""Scalar arithmetic that folds constants while a program is traced.

Sums and products with a known 0 and products with a known 1 or -1 cost nothing: they never reach the compiled program.
"""

import operator
from collections.abc import Callable, Sequence
from typing import Any, NamedTuple

import jax.numpy as jnp
import numpy as np
from jax import lax
from jaxtyping import Array, Shaped


class Scalar:
    """A number: `value` is a Python float, known while tracing, or an array that jax traces."""

    __slots__ = ("value",)

    def __init__(self, value: Any) -> None:
        self.value = value

    def is_known(self, number: float) -> bool:
        """Return whether the value is known to be this number."""
        return isinstance(self.value, float) and self.value == number

    def __neg__(self) -> "Scalar":
        return Scalar(-self.value if isinstance(self.value, float | np.ndarray) else lax.neg(self.value))

    def __add__(self, other: "Scalar") -> "Scalar":
        if self.is_known(0.0) or other.is_known(0.0):
            return other if self.is_known(0.0) else self
        return Scalar(_apply(operator.add, lax.add, self.value, other.value))

    def __sub__(self, other: "Scalar") -> "Scalar":
        if self.is_known(0.0) or other.is_known(0.0):
            return -other if self.is_known(0.0) else self
        return Scalar(_apply(operator.sub, lax.sub, self.value, other.value))

    def __mul__(self, other: "Scalar") -> "Scalar":
        for one, two in ((self, other), (other, self)):
            if one.is_known(0.0):
                return one
            if one.is_known(1.0):
                return two
            if one.is_known(-1.0):
                return -two
        return Scalar(_apply(operator.mul, lax.mul, self.value, other.value))

    def __truediv__(self, other: "Scalar") -> "Scalar":
        return self if self.is_known(0.0) else Scalar(_apply(operator.truediv, lax.div, self.value, other.value))


def _apply(general: Callable[..., Any], direct: Callable[..., Any], a: Any, b: Any) -> Any:
    """An operation on two values, `direct` where they fit each other: that traces three times as fast."""
    if isinstance(a, float | np.ndarray) and isinstance(b, float | np.ndarray):
        return general(a, b)
    if isinstance(a, float) or isinstance(b, float) or (a.shape == b.shape and a.dtype == b.dtype):
        return direct(a, b)
    return general(a, b)


ZERO, HALF, ONE, TWO = (Scalar(number) for number in (0.0, 0.5, 1.0, 2.0))


class Vector(NamedTuple):
    """Components along the axes of a frame."""

    x: Scalar
    y: Scalar
    z: Scalar


NULL = Vector(ZERO, ZERO, ZERO)


class Symmetric(NamedTuple):
    """A symmetric 3x3 matrix."""

    xx: Scalar = ZERO
    xy: Scalar = ZERO
    xz: Scalar = ZERO
    yy: Scalar = ZERO
    yz: Scalar = ZERO
    zz: Scalar = ZERO

    def plus(self, other: "Symmetric") -> "Symmetric":
        """The sum of two."""
        return Symmetric(*(a + b for a, b in zip(self, other, strict=True)))

    def apply(self, v: Vector) -> Vector:
        """Its product with a vector."""
        return Vector(dot(self[:3], v), dot((self.xy, self.yy, self.yz), v), dot((self.xz, self.yz, self.zz), v))

    @property
    def rows(self) -> tuple[Vector, Vector, Vector]:
        """The entries row by row."""
        return Vector(*self[:3]), Vector(self.xy, self.yy, self.yz), Vector(self.xz, self.yz, self.zz)


class Turn(NamedTuple):
    """A rotation about one axis, by the cosine and sine of its angle."""

    cos: Scalar
    sin: Scalar

    def apply(self, a: Scalar, b: Scalar) -> tuple[Scalar, Scalar]:
        """Rotate the two components across the axis."""
        return self.cos * a - self.sin * b, self.sin * a + self.cos * b

    def undo(self, a: Scalar, b: Scalar) -> tuple[Scalar, Scalar]:
        """Rotate the two components across the axis backwards."""
        return self.cos * a + self.sin * b, self.cos * b - self.sin * a

    def apply_symmetric(self, aa: Scalar, ab: Scalar, bb: Scalar) -> tuple[Scalar, Scalar, Scalar]:
        """Rotate the block of a symmetric matrix that lies across the axis, by the double angle."""
        if self.sin.is_known(0.0):
            return aa, ab, bb
        if self.cos.is_known(0.0):
            return bb, -ab, aa
        mean, difference = HALF * (aa + bb), HALF * (aa - bb)
        twice = Turn(self.cos * self.cos - self.sin * self.sin, TWO * self.sin * self.cos)
        difference, ab = twice.apply(difference, ab)
        return mean + difference, ab, mean - difference


def dot(a: Sequence[Scalar], b: Sequence[Scalar]) -> Scalar:
    """The scalar product of two sequences of one length."""
    total = ZERO
    for one, two in zip(a, b, strict=True):
        total = total + one * two
    return total


def add(a: Vector, b: Vector) -> Vector:
    """The sum of two vectors."""
    return Vector(a.x + b.x, a.y + b.y, a.z + b.z)


def scale(factor: Scalar, a: Vector) -> Vector:
    """A number times a vector."""
    return Vector(factor * a.x, factor * a.y, factor * a.z)


def cross(a: Vector, b: Vector) -> Vector:
    """The vector product."""
    return Vector(a.y * b.z - a.z * b.y, a.z * b.x - a.x * b.z, a.x * b.y - a.y * b.x)


def unstack(array: Shaped[Array, "n ..."]) -> list[Scalar]:
    """The elements along the first axis of an array."""
    return [Scalar(element) for element in array]


def stack(scalars: Sequence[Scalar], like: Shaped[Array, " _"]) -> Shaped[Array, " n"]:
    """The scalars as an array with the element type of `like`, or with the one they were traced with if that is
    wider."""
    return jnp.stack([jnp.asarray(s.value, like.dtype if isinstance(s.value, float) else None) for s in scalars])


def solve(matrix: Sequence[Sequence[Scalar]], vector: Sequence[Scalar]) -> list[Scalar]:
    """x of `matrix x = vector` for a symmetric, positive definite matrix: L D L^T without pivoting.

    Only the lower triangle of the matrix is read.
    """
    size = len(vector)
    lower = [[ZERO] * size for _ in range(size)]
    inverse, x = [ZERO] * size, list(vector)
    for row in range(size):
        times_diagonal: list[Scalar] = []
        for column in range(row):
            times_diagonal.append(matrix[row][column] - dot(lower[column][:column], times_diagonal))
            lower[row][column] = times_diagonal[column] * inverse[column]
        inverse[row] = ONE / (matrix[row][row] - dot(lower[row][:row], times_diagonal))
        x[row] = x[row] - dot(lower[row][:row], x[:row])
    for row in reversed(range(size)):
        below = [lower[k][row] for k in range(row + 1, size)]
        x[row] = x[row] * inverse[row] - dot(below, x[row + 1 :])
    return x
