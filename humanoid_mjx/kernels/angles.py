"""Sine and cosine in GPU kernels.

Those of CUDA's library are each some seventy instructions with branches, for angles of any size. These share what they
have in common, and have no branch.
"""

from functools import partial

import jax.numpy as jnp
from jaxtyping import Array, Float

HALF_PI = 1.5703125, 4.837512969970703125e-4, 7.54978995489188216e-8
"""Parts of pi / 2: multiples of the first two by up to 2^12 are exact in float32."""

SINE = -1.6666654611e-1, 8.3321608736e-3, -1.9515295891e-4
COSINE = 4.166664568298827e-2, -1.388731625493765e-3, 2.443315711809948e-5
"""Coefficients of S. L. Moshier's Cephes library, for angles of up to pi / 4."""


def sine(angle: Float[Array, " threads"], turned: bool = False) -> Float[Array, " threads"]:
    """Sine of an angle in rad; the error is below 1.2e-7 up to 6,000 rad, and grows with larger angles.

    `turned`: of an angle larger by a quarter turn, which is the cosine.
    """
    turns = jnp.floor(angle * (2.0 / jnp.pi) + 0.5)  # the nearest quarter turn, and the angle from there
    for part in HALF_PI:
        angle = angle - turns * part
    quarter, square = turns.astype(jnp.int32), angle * angle
    quarter = quarter + 1 if turned else quarter
    odd = angle + angle * square * (SINE[0] + square * (SINE[1] + square * SINE[2]))
    even = 1.0 - 0.5 * square + square * square * (COSINE[0] + square * (COSINE[1] + square * COSINE[2]))
    found = jnp.where(quarter & 1 == 0, odd, even)
    return jnp.where(quarter & 2 == 0, found, -found)


cosine = partial(sine, turned=True)

ANGLES = {"sin": sine, "cos": cosine}
"""By primitive."""
