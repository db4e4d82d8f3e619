"""The leg of the thesis: five revolute joints (Table 4.1), the torso fixed.

At `q = 0` the leg hangs along -y0 and z0 points sideways. The joint axes are then +z0 (hip pitch), -y0 (yaw), -x0
(roll), -z0 (knee) and -z0 (ankle).
"""

import math
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from humanoid_mjx.robot.chain import Chain
from humanoid_mjx.spec import InputError
from humanoid_mjx.thesis import leg as thesis

ALONG_THE_LEG = (0.0, -thesis.GRAVITY, 0.0)
"""Gravity of a standing robot."""

AS_PRINTED = (0.0, 0.0, -thesis.GRAVITY)
"""Gravity of appendix H and the MATLAB script: sideways in the frames of Table 4.1."""

FRAME_0 = np.array([[1.0, 0.0, 0.0], [0.0, 0.0, -1.0], [0.0, 1.0, 0.0]])
"""From frame 0 of the right leg (x forward, y up, z to the right) to a world with x forward, y left and z up."""

MIRROR = np.diag([1.0, -1.0, 1.0])
"""Reflection across the sagittal plane of that world, to the left leg."""

HIP_DIAMETER = thesis.BODY_MM["upper_leg_circumference"] * 1e-3 * thesis.SCALE / math.pi
"""Thickness of the cylinders that stand for links 1 to 3 in `Leg.physical`: the upper leg's. Nothing is printed."""

SHANK_DIAMETER = thesis.BODY_MM["lower_leg_circumference"] * 1e-3 * thesis.SCALE / math.pi
"""Thickness of links 4 and 5: the lower leg's."""


@jax.tree_util.register_dataclass
@dataclass(frozen=True)
class Leg(Chain):
    """The five-joint leg. The four sets of parameters are `physical`, `thesis`, `matlab_script` and `figure_7_5`."""

    @classmethod
    def from_links(
        cls, lengths: Sequence[float], pseudo_inertia: Any, gravity: Sequence[float] = ALONG_THE_LEG
    ) -> "Leg":
        """A leg with the axes of Table 4.1, from l1 to l5, m, the pseudo-inertia (5, 4, 4) of each link in its own
        frame, and gravity in frame 0, m/s^2.

        Raises:
          InputError: a wrong shape, or values that no leg has.
        """
        if len(lengths) != 5 or not all(isinstance(x, (int, float)) and 0 < x < math.inf for x in lengths):
            raise InputError(f"lengths must be five positive numbers of metres, got {list(lengths)}.")
        l1, l2, l3, l4, l5 = lengths
        return cls.build(
            theta_offset=np.radians(thesis.DH_THETA_OFFSETS).tolist(),
            d=(l1, l2, 0.0, 0.0, 0.0),
            a=(0.0, 0.0, l3, l4, l5),
            alpha=np.radians(thesis.DH_ALPHAS).tolist(),
            pseudo_inertia=pseudo_inertia,
            gravity=gravity,
        )

    @classmethod
    def physical(cls, gravity: Sequence[float] = ALONG_THE_LEG) -> "Leg":
        """The recovered lengths, the masses of Table 4.3, and solid cylinders in the places of the links."""
        return cls.from_links(thesis.LINK_LENGTHS, cylinder_inertias(), gravity)

    @classmethod
    def thesis(cls, gravity: Sequence[float] = ALONG_THE_LEG) -> "Leg":
        """The recovered lengths and the inertias of section 4.6, corrected as `thesis.leg.INERTIA_CORRECTIONS` says."""
        return cls.from_links(thesis.LINK_LENGTHS, corrected_inertias(), gravity)

    @classmethod
    def matlab_script(cls, gravity: Sequence[float] = ALONG_THE_LEG) -> "Leg":
        """The lengths, masses and thin rods of the MATLAB script."""
        return cls.from_links(thesis.SCRIPT_LENGTHS, script_inertias(), gravity)

    @classmethod
    def figure_7_5(cls) -> "Leg":
        """The recovered model behind the torques of section 7 C: `thesis` with other masses and gravity sideways.

        Section 7 C determines only masses and centroids; second moments are those of `thesis`, scaled by mass.
        """
        scale = np.array(thesis.FIGURE_7_5_MASSES) / np.array(thesis.LINK_MASSES)
        return cls.from_links(thesis.LINK_LENGTHS, corrected_inertias() * scale[:, None, None], AS_PRINTED)

    @property
    def lengths(self) -> Float[Array, "*batch 5"]:
        """l1 to l5, m."""
        return jnp.concatenate([self.d[..., :2], self.a[..., 2:]], axis=-1)


def corrected_inertias() -> np.ndarray:
    """(5, 4, 4) Section 4.6 as a physical body: the corrections, and first moments = mass x centroid."""
    inertia = np.array(thesis.PSEUDO_INERTIAS)
    for link, (row, column), value in thesis.INERTIA_CORRECTIONS:
        inertia[link - 1, row - 1, column - 1] = inertia[link - 1, column - 1, row - 1] = value
    first = np.array(thesis.LINK_MASSES)[:, None] * np.array(thesis.LINK_CENTROIDS)
    inertia[:, :3, 3] = inertia[:, 3, :3] = first
    return inertia


def script_inertias() -> np.ndarray:
    """(5, 4, 4) The MATLAB script's links: thin rods along x, from the frame's origin backwards."""
    inertia = np.zeros((5, 4, 4))
    for link, (mass, length) in enumerate(zip(thesis.SCRIPT_MASSES, thesis.SCRIPT_LENGTHS, strict=True)):
        inertia[link, 0, 0], inertia[link, 3, 3] = mass * length**2 / 3, mass
        inertia[link, 0, 3] = inertia[link, 3, 0] = -mass * length / 2
    return inertia


def cylinder_inertias() -> np.ndarray:
    """(5, 4, 4) Solid cylinders between the frames: along y for links 1 and 2, along x for the others."""
    diameters = (HIP_DIAMETER,) * 3 + (SHANK_DIAMETER,) * 2
    middles = ((1, -0.5), (1, 0.5), (0, -0.5), (0, -0.5), (0, -0.5))
    inertia = np.zeros((5, 4, 4))
    for link, (axis, share) in enumerate(middles):
        mass, length, radius = thesis.LINK_MASSES[link], thesis.LINK_LENGTHS[link], diameters[link] / 2
        second = np.full(3, mass * radius**2 / 4)
        second[axis] = mass * length**2 / 12 + mass * (share * length) ** 2
        inertia[link, (0, 1, 2), (0, 1, 2)] = second
        inertia[link, axis, 3] = inertia[link, 3, axis] = mass * share * length
        inertia[link, 3, 3] = mass
    return inertia
