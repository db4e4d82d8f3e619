# pyright: reportAttributeAccessIssue=false
"""The frame of a robot's trunk: turned so that it is upright where the robot stands at home."""

import mujoco
import numpy as np

from humanoid_mjx.robot.compiling import checked
from humanoid_mjx.spec import InputError

TURNED = 1e-4
"""Smallest turn of a frame, rad, that is more than rounding."""

Quat = tuple[float, float, float, float]


def turn_at_home(model: mujoco.MjModel, key: str) -> Quat:
    """Return the orientation of the trunk at home: as its body is drawn, leant as a keyframe leans it. The heading of a
    keyframe does not count.

    Raises:
      InputError: the body is turned about the vertical alone, so that nothing says where its front is.
    """
    drawn = model.qpos0[3:7] / np.linalg.norm(model.qpos0[3:7])
    if key:
        given = model.key(key).qpos[3:7] / np.linalg.norm(model.key(key).qpos[3:7])
        w, _, _, z = _product(given, drawn * (1, -1, -1, -1))
        drawn = _product(np.array([w, 0, 0, -z]) / np.hypot(w, z) if w or z else np.array([1.0, 0, 0, 0]), given)
    if np.linalg.norm(drawn[1:]) <= TURNED:
        return 1.0, 0.0, 0.0, 0.0
    if np.linalg.norm(drawn[1:3]) <= TURNED:
        raise InputError(
            f"model: the body {model.body(1).name!r} is turned about the vertical; write it without this turn, so that "
            "the robot's front is along x (each episode begins with a random heading)"
        )
    return tuple(drawn.tolist())


def set_upright(spec: mujoco.MjSpec, turn: Quat) -> None:
    """Turn the frame of the free body, and all in it back, so that the body is upright where it had this orientation.

    Raises:
      InputError: an equality constraint holds the body by places in its frame.
    """
    if turn[0] == 1.0:
        return
    trunk, given = spec.worldbody.first_body(), mujoco.mjtOrientation.mjORIENTATION_QUAT
    if held := [e.name for e in spec.equalities if trunk.name in (e.name1, e.name2)]:
        raise InputError(f"model: {trunk.name!r} is turned, and the equality {held[0]!r} holds it by its frame")
    model = checked(spec.compile)[0]
    parts = *trunk.geoms, *trunk.sites, *trunk.bodies, *trunk.cameras, *trunk.lights, *trunk.frames
    frame = trunk.add_frame(quat=turn)
    for part in parts:
        if part.frame is None:
            part.set_frame(frame)
    if trunk.explicitinertial:
        mujoco.mju_rotVecQuat(trunk.ipos, model.body_ipos[1].copy(), turn)
        trunk.iquat, trunk.ialt.type = _product(turn, model.body_iquat[1]), given
        trunk.inertia = trunk.mass / model.body_mass[1] * model.body_inertia[1]  # the compiler may scale them
        trunk.fullinertia = np.full(6, np.nan)
    trunk.quat, trunk.alt.type = (1, 0, 0, 0), given
    trunk.quat = checked(spec.compile)[0].qpos0[3:7] * (1, -1, -1, -1)  # against a <frame> around the body


def _product(one: np.ndarray | Quat, other: np.ndarray) -> np.ndarray:
    product = np.empty(4)
    mujoco.mju_mulQuat(product, one, other)
    return product
