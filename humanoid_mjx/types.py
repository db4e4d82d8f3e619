"""Types that many signatures share: scalars that are arrays inside jit and may be Python numbers outside, and arrays of
either jax or numpy."""

from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from typing import TypeAlias

    FloatScalar: TypeAlias = Any
    IntScalar: TypeAlias = Any
    BoolScalar: TypeAlias = Any
    Device: TypeAlias = Any
    MassFactor: TypeAlias = Any
    AnyArray: TypeAlias = Any
else:
    import numpy as np
    from jax import Device  # noqa: F401
    from jaxtyping import Array, Bool, Float, Int

    FloatScalar = Float[Array, ""] | float
    IntScalar = Int[Array, ""] | int
    BoolScalar = Bool[Array, ""] | bool
    AnyArray = Array | np.ndarray
    MassFactor = FloatScalar | Float[AnyArray, " joints"]
    """A number for the whole robot, or one for the link behind each actuated joint."""
