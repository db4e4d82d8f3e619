"""Limits of the joints: ranges by name, and the largest torque."""

import numpy as np
from jaxtyping import Float

from humanoid_mjx.spec import InputError, known
from humanoid_mjx.thesis import leg as thesis

TORQUE_LIMIT = 2.0
"""Limit of every joint's torque, N m. Table 4.7's maxima (0.28 and less) are of a leg that hangs. Balancing on one leg
takes 0.69 at the hip's roll, and a squat on one leg with the thigh level 1.35 at the knee; 2.0 leaves a motion half as
much again."""


def joint_ranges(name: str = "proposed") -> Float[np.ndarray, "5 2"]:
    """Lowest and highest angle of each joint, rad: a column of Table 3.2, `proposed` or `human`.

    Raises:
      InputError: an unknown name.
    """
    if name not in thesis.JOINT_RANGES:
        raise InputError(f"joint ranges: unknown name {name!r}; {known(name, thesis.JOINT_RANGES)}.")
    return np.radians(thesis.JOINT_RANGES[name])
