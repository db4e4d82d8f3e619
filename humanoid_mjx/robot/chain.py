"""A serial chain of revolute joints in Denavit-Hartenberg form.

Frame i is reached from frame i-1 by `Rz(q_i + theta_offset_i) Tz(d_i) Tx(a_i) Rx(alpha_i)`. Link i moves with frame i.
"""

import math
from collections.abc import Sequence
from dataclasses import dataclass, field, replace
from typing import Any, NamedTuple, TypeVar

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from humanoid_mjx.spec import InputError
from humanoid_mjx.types import FloatScalar

SomeChain = TypeVar("SomeChain", bound="Chain")


class Structure(NamedTuple):
    """The static part of the mechanics: the angles between the axes, and the places of permanent zeros.

    A program folds these zeros away. Values that vanish here must stay zero when the chain's arrays are changed.
    """

    theta_offset: tuple[float, ...]
    """radians"""
    alpha: tuple[float, ...]
    """radians"""
    has_d: tuple[bool, ...]
    has_a: tuple[bool, ...]
    has_inertia: tuple[tuple[tuple[bool, ...], ...], ...]
    """Places that are not zero, by link, row and column of the pseudo-inertia."""
    has_gravity: tuple[bool, ...]


@jax.tree_util.register_dataclass
@dataclass(frozen=True)
class Chain:
    """A serial chain: a pytree whose structure is static and whose values can be traced, batched and differentiated.

    Build one with `Chain.build`, which checks its values; the constructor does not.
    """

    d: Float[Array, "*batch joints"]
    """Offsets along the joint axes, m."""
    a: Float[Array, "*batch joints"]
    """Lengths along the links' x axes, m."""
    pseudo_inertia: Float[Array, "*batch joints 4 4"]
    """Integrals of r r^T dm over each link, r = [x y z 1] in its own frame: kg m^2, kg m and kg."""
    gravity: Float[Array, "*batch 3"]
    """Acceleration in frame 0, m/s^2."""
    structure: Structure = field(metadata={"static": True})

    @classmethod
    def build(
        cls: type[SomeChain],
        *,
        theta_offset: Sequence[float],
        d: Sequence[float],
        a: Sequence[float],
        alpha: Sequence[float],
        pseudo_inertia: Any,
        gravity: Sequence[float],
    ) -> SomeChain:
        """Check the values of a chain and build it. Angles in radians, the rest as in the class.

        Raises:
          InputError: a wrong shape, a value that is not finite, a pseudo-inertia that no body can have.
        """
        angles, joints = {"theta_offset": theta_offset, "alpha": alpha}, len(theta_offset)
        values = {"d": d, "a": a, "pseudo_inertia": pseudo_inertia, "gravity": gravity}
        expected = dict.fromkeys((*angles, *values), (joints,)) | {"gravity": (3,), "pseudo_inertia": (joints, 4, 4)}
        arrays = {name: _array(name, value) for name, value in (angles | values).items()}
        for name, shape in expected.items():
            if arrays[name].shape != shape:
                raise InputError(f"{name} must have the shape {shape}, got {arrays[name].shape}.")
            if not np.isfinite(arrays[name]).all():
                raise InputError(f"{name} must be finite, got {arrays[name].tolist()}.")
        for link, matrix in enumerate(arrays["pseudo_inertia"], start=1):
            check_pseudo_inertia(matrix, f"link {link}")
        static = (tuple(arrays[name].tolist()) for name in angles)
        structure = Structure(*static, *(_where(arrays[name]) for name in values))
        return cls(**{name: jnp.array(arrays[name]) for name in values}, structure=structure)

    @property
    def num_joints(self) -> int:
        """Number of joints, which is that of links."""
        return len(self.structure.alpha)

    def scaled(self: SomeChain, mass: Any = 1.0) -> SomeChain:
        """The same chain with every link's inertia multiplied by `mass`: a number, or one for each link."""
        factor = jnp.broadcast_to(jnp.asarray(mass, self.pseudo_inertia.dtype), (self.num_joints,))
        return replace(self, pseudo_inertia=self.pseudo_inertia * factor[:, None, None])

    def carrying(self: SomeChain, mass: FloatScalar) -> SomeChain:
        """The same chain with a point mass, kg, at the origin of its last frame: the toe of the leg.

        Raises:
          InputError: the last link has no mass of its own, which the structure takes for granted.
        """
        if not self.structure.has_inertia[-1][3][3]:
            raise InputError("the last link must have a mass to carry another.")
        return replace(self, pseudo_inertia=self.pseudo_inertia.at[..., -1, 3, 3].add(mass))


def check_pseudo_inertia(matrix: np.ndarray, what: str) -> None:
    """Raise an InputError if no distribution of mass has this pseudo-inertia: it must be symmetric and positive
    semi-definite."""
    if not np.allclose(matrix, matrix.T, rtol=1e-12, atol=0):
        raise InputError(f"pseudo_inertia of {what} must be symmetric.")
    scale = np.sqrt(np.maximum(np.diag(matrix), 0.0))
    scale[scale == 0.0] = 1.0
    smallest = float(np.linalg.eigvalsh(matrix / np.outer(scale, scale))[0])
    if smallest < -1e-9:
        raise InputError(
            f"pseudo_inertia of {what} must be positive semi-definite, as every distribution of mass is; "
            f"its smallest eigenvalue is {float(np.linalg.eigvalsh(matrix)[0]):.3g}."
        )


def quarter_turns(angle: float) -> tuple[float, float]:
    """Cosine and sine; exact at multiples of a right angle."""
    turns = angle / (math.pi / 2)
    if abs(turns - round(turns)) < 1e-12:
        return ((1.0, 0.0), (0.0, 1.0), (-1.0, 0.0), (0.0, -1.0))[round(turns) % 4]
    return math.cos(angle), math.sin(angle)


def _array(name: str, value: Any) -> np.ndarray:
    try:
        return np.asarray(value, np.float64)
    except (TypeError, ValueError) as error:
        raise InputError(f"{name} must be numbers, got {value!r}.") from error


def _where(array: Any) -> Any:
    """The places that are not zero, as nested tuples."""
    if array.ndim == 0:
        return bool(array)
    return tuple(_where(row) for row in array != 0.0)
