"""A chain as a MuJoCo model: fixed torso, a body at each Denavit-Hartenberg frame, no geometry, no contacts."""

import math
from collections.abc import Sequence
from typing import Any

import numpy as np
from jax.core import Tracer

from humanoid_mjx.robot.chain import Chain
from humanoid_mjx.robot.leg import Leg
from humanoid_mjx.spec import InputError
from humanoid_mjx.thesis.leg import JOINT_NAMES

SMALLEST_INERTIA = 1e-13
"""Inertia added where a link has none about some axis, such as a thin rod, kg m^2: MuJoCo requires inertias above
1e-15."""


def make_mjspec(chain: Chain, timestep: float = 0.002) -> Any:
    """The chain as a `mujoco.MjSpec`, frame 0 being the world; its `compile()` and `to_xml()` lead on from there.

    Args:
      chain: with concrete values.
      timestep: s.

    Raises:
      InputError: the values are traced or batched, or a link has no mass.
    """
    from mujoco import MjSpec  # pyright: ignore[reportAttributeAccessIssue]

    spec = MjSpec()
    spec.option.timestep = timestep
    names = JOINT_NAMES if isinstance(chain, Leg) else [f"joint{i + 1}" for i in range(chain.num_joints)]
    add_chain(spec.worldbody, chain, names)
    spec.option.gravity = np.asarray(chain.gravity, np.float64)
    return spec


def add_chain(parent: Any, chain: Chain, joint_names: Sequence[str], prefix: str = "", mirrored: bool = False) -> Any:
    """Add a chain's bodies, called `prefix`link1, link2, ..., to the body that is its frame 0; the last of them.

    A mirrored chain is the chain's image across the plane y = 0 of its frame 0; equal angles are images of each other.

    Raises:
      InputError: the values are traced or batched, or a link has no mass.
    """
    if isinstance(chain.d, Tracer) or chain.d.ndim != 1:
        raise InputError("a MuJoCo model needs one chain with concrete values, outside jit and vmap.")
    structure, body = chain.structure, parent
    side = np.array([1.0, -1.0 if mirrored else 1.0, 1.0])
    # A reflection turns rotations the other way: what is an axis for points is its opposite for angles.
    turn = -side if mirrored else side
    inertias, offsets, lengths = (np.asarray(x, np.float64) for x in (chain.pseudo_inertia, chain.d, chain.a))
    dh = zip(joint_names, offsets, lengths, structure.theta_offset, structure.alpha, strict=True)
    for i, (name, d, a, start, alpha) in enumerate(dh):
        body = body.add_body(name=f"{prefix}link{i + 1}")
        body.pos = side * [a * math.cos(start), a * math.sin(start), d]
        body.quat = np.r_[1.0, turn] * _turned(start, alpha)
        axis = np.array([0.0, math.sin(alpha), math.cos(alpha)])
        body.add_joint(name=name, axis=turn * axis, pos=side * [-a, -d * axis[1], -d * axis[2]])
        _set_inertia(body, inertias[i] * np.outer(np.r_[side, 1.0], np.r_[side, 1.0]))
    return body


def _set_inertia(body: Any, pseudo_inertia: np.ndarray) -> None:
    mass = pseudo_inertia[3, 3]
    if mass <= 0.0:
        raise InputError(f"a MuJoCo model needs links with mass, but that of {body.name} is {mass:g} kg.")
    center = pseudo_inertia[:3, 3] / mass
    second = pseudo_inertia[:3, :3] - mass * np.outer(center, center)
    inertia = np.trace(second) * np.eye(3) - second
    if np.linalg.eigvalsh(inertia)[0] < SMALLEST_INERTIA:
        inertia += SMALLEST_INERTIA * np.eye(3)
    body.explicitinertial, body.mass, body.ipos = True, mass, center
    body.fullinertia = inertia[(0, 1, 2, 0, 0, 1), (0, 1, 2, 1, 2, 2)]


def _turned(start: float, alpha: float) -> np.ndarray:
    """Return the quaternion of a turn by `start` about z, then by `alpha` about the new x, rad."""
    about_z, about_x = (np.array([math.cos(angle / 2), math.sin(angle / 2)]) for angle in (start, alpha))
    return np.outer(about_z, about_x).reshape(-1)[[0, 1, 3, 2]]
