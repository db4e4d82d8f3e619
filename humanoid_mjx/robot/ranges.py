"""The ranges of the joints by name."""

import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from humanoid_mjx.spec import InputError, known
from humanoid_mjx.thesis import leg as thesis


def joint_ranges(name: str = "proposed") -> Float[Array, "5 2"]:
    """Lowest and highest angle of each joint, rad: a column of Table 3.2, `proposed` or `human`.

    Raises:
      InputError: an unknown name.
    """
    if name not in thesis.JOINT_RANGES:
        raise InputError(f"joint ranges: unknown name {name!r}; {known(name, thesis.JOINT_RANGES)}.")
    return jnp.array(np.radians(thesis.JOINT_RANGES[name]))
