"""Elliptic cones of friction.

MuJoCo's cost of such a contact (see "Computation" in its documentation) is half a weight times the squared distance of
the residual from a cone. In a frame with stretched tangents this cone is round: `normal >= slope * |tangential|`. So
MuJoCo's three zones are the cone itself, where no force acts; its polar cone, whose points are nearest to the tip, and
where the contact sticks; and what is between, nearest to the side, where it slides.
"""

from typing import Any, NamedTuple

import jax.numpy as jnp
import numpy as np

from humanoid_mjx.mechanics.tree.algebra import column, dot, transposed, turn


class Cone(NamedTuple):
    """The cone in its stretched frame. The pull of a residual is the way to it from the nearest point of the cone; a
    contact's force is less its pull, times its weight."""

    slope: Any
    first: Any
    second: Any
    """Factors that stretch the tangents."""

    @classmethod
    def of(cls, first: Any, second: Any, impratio: float) -> "Cone":
        """The cone of these coefficients of friction, where friction is `impratio` times as stiff as the normal."""
        root = impratio**0.5
        return cls(first / root, np.full((1, 1), root), root * second / first)

    def stretched(self, v: Any) -> Any:
        """A vector of the contact's frame in this one."""
        x, y, z = jnp.unstack(v, axis=-3)
        return column([x, self.first * y, self.second * z])

    def root(self, residual: Any) -> Any:
        """R, (..., 3, 3, lanes, 1), of which `R^T R` is the derivative of the pull. `R^T R residual` is the pull."""
        x, y, z = jnp.unstack(residual, axis=-3)
        inverse, length, share, apart, sticks = self._zones(x, y, z)
        y, z = jnp.where(length > 0.0, y * inverse, 1.0), z * inverse
        one = jnp.where(sticks, 1.0, jnp.sqrt(share))
        lean = jnp.where(sticks, 0.0, self.slope * one)
        bend = share * self.slope * (self.slope - x * inverse)
        across = jnp.sqrt(jnp.where(sticks | apart, 1.0, bend))
        along, none = jnp.where(sticks, 1.0, 0.0), np.zeros((1, 1))
        rows = (one, -lean * y, -lean * z), (none, along * y, along * z), (none, -across * z, across * y)
        return jnp.where(apart[..., None, None, :, :], 0.0, jnp.stack([column(row) for row in rows], axis=-4))

    def along(self, residual: Any, way: Any) -> tuple[Any, Any]:
        """The first and the second derivative of half the squared distance from the cone along a way."""
        (x, y, z), (a, b, c) = (jnp.unstack(v, axis=-3) for v in (residual, way))
        inverse, length, share, apart, sticks = self._zones(x, y, z)
        speed = (y * b + z * c) * inverse
        excess, change = x - self.slope * length, a - self.slope * speed
        bend = self.slope * excess * (b * b + c * c - speed * speed) * inverse
        first = jnp.where(sticks, x * a + y * b + z * c, share * excess * change)
        second = jnp.where(sticks, a * a + b * b + c * c, share * (change * change - bend))
        return jnp.where(apart, 0.0, first), jnp.where(apart, 0.0, second)

    def bends(self, before: Any, now: Any, size: Any, errors: Any) -> Any:
        """True where the pull at `now` is not that by its derivative at `before`, but for so many rounding errors of
        itself and of accelerations of this size."""
        one, two = (turn(transposed(rows), turn(rows, now)) for rows in map(self.root, (before, now)))
        change = one - two
        error, stretched = errors * jnp.finfo(change.dtype).eps, self.first * size
        return dot(change, change) > error * error * (dot(two, two) + stretched * stretched)

    def _zones(self, x: Any, y: Any, z: Any) -> tuple[Any, Any, Any, Any, Any]:
        """The tangential part's inverse length, or 1, and length; the squared distance from the side by that along the
        axis; masks of the cone and of its polar cone."""
        square = y * y + z * z
        inverse = 1.0 / jnp.sqrt(jnp.where(square > 0.0, square, 1.0))
        length = square * inverse
        share = 1.0 / (1.0 + self.slope * self.slope)
        return inverse, length, share, x >= self.slope * length, self.slope * x + length <= 0.0
