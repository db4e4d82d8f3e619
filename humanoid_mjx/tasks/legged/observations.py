"""Named observations of a view. A task declares a tuple of names; everything else about them follows from it."""

from collections.abc import Callable, Sequence
from typing import Any, Literal, NamedTuple

import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from humanoid_mjx.spec import InputError, known
from humanoid_mjx.tasks.legged.body import JOINTS, START_HEIGHT
from humanoid_mjx.tasks.legged.view import View
from humanoid_mjx.thesis.leg import GRAVITY

SPEED, TURN, FORCE = 5.0, 3.0, 10.0
"""Velocity of a joint, rad/s, turn rate of the torso, rad/s, and force on a foot, N, whose observations are 1."""

FARTHEST = 5.0
"""Size at which observations are cut off."""

POLAR, AXIAL = (1.0, -1.0, 1.0), (-1.0, 1.0, -1.0)
"""Signs of the mirror image of a vector, and of a rotation."""


class Observation(NamedTuple):
    """Numbers that a learner sees."""

    size: int
    value: Callable[[View], Any]
    scale: Any = 1.0
    """The value that the learner sees as 1: one number, or one for each."""
    mirror: tuple[float, ...] | Literal["swap"] = "swap"
    """The image in the plane of symmetry: left and right halves swapped, or the sign of each number."""
    bounds: tuple[float, float] = (-1.0, 1.0)
    """Bounds in this scale, beyond which a basis may saturate."""


OBSERVATIONS = {
    "encoders": Observation(JOINTS, lambda view: view.readings.encoders - view.posture),
    "rates": Observation(JOINTS, lambda view: view.rates, SPEED),
    "gyroscope": Observation(3, lambda view: view.readings.gyroscope, TURN, AXIAL),
    "accelerometer": Observation(3, lambda view: view.readings.accelerometer, GRAVITY, POLAR),
    "down": Observation(3, lambda view: view.down, mirror=POLAR),
    "contact": Observation(2, lambda view: view.readings.foot_contact, FORCE),
    "offsets": Observation(JOINTS, lambda view: view.offsets),
    "command": Observation(3, lambda view: view.command, (0.5, 0.25, 1.0), (1.0, -1.0, -1.0)),
    "clock": Observation(2, lambda view: clock(view), mirror=(-1.0, -1.0)),
    "true_down": Observation(3, lambda view: view.true_down, mirror=POLAR),
    "velocity": Observation(3, lambda view: view.rotation.T @ view.world.qvel[:3], mirror=POLAR),
    "height": Observation(1, lambda view: view.world.qpos[2:3], START_HEIGHT, (1.0,)),
    "turn_rate": Observation(1, lambda view: view.turn_rate[None], TURN, (-1.0,)),
    "foot_heights": Observation(2, lambda view: view.feet.height, 0.03),
    "foot_loads": Observation(2, lambda view: view.feet.load, FORCE),
}
"""The observations by name. A task may add its own by putting an `Observation` among the names."""

PROPRIOCEPTION = ("encoders", "rates", "gyroscope", "accelerometer", "down", "contact", "offsets")
"""Encoders about the posture, their rates of change, the torso's gyroscope and accelerometer, the direction of gravity
as estimated, foot contacts, the set-points' offsets."""

PRIVILEGED = ("true_down", "velocity", "height")
"""The true attitude and motion of the torso: direction of gravity and velocity in its frame, height of the hips."""


def clock(view: View) -> Float[Array, "2"]:
    """Sine and cosine of the gait's phase; both 0 while the command is to stand."""
    angle = 2 * jnp.pi * view.phase
    return jnp.where(view.moving, jnp.stack([jnp.sin(angle), jnp.cos(angle)]), 0.0)


class Observed:
    """What the names of a task's observations stand for, one after the other."""

    def __init__(self, names: Sequence[str | Observation]):
        """Look the names up.

        Raises:
          InputError: an unknown name.
        """
        for name in names:
            if isinstance(name, str) and name not in OBSERVATIONS:
                raise InputError(f"observations: unknown name {name!r}; {known(name, OBSERVATIONS)}.")
        self.parts = [OBSERVATIONS[name] if isinstance(name, str) else name for name in names]
        self.size = sum(part.size for part in self.parts)
        ends = np.cumsum([0, *(part.size for part in self.parts)])
        order = [np.roll(np.arange(p.size), p.size // 2 if p.mirror == "swap" else 0) for p in self.parts]
        self.mirror_order = np.concatenate([start + rows for start, rows in zip(ends, order, strict=False)])
        signs = [np.ones(p.size) if p.mirror == "swap" else np.array(p.mirror) for p in self.parts]
        self.mirror_signs = np.concatenate(signs).astype(np.float32)
        low, high = np.array([part.bounds for part in self.parts]).T
        sizes = [part.size for part in self.parts]
        self.bounds = np.repeat(low, sizes), np.repeat(high, sizes)

    def __call__(self, view: View) -> Float[Array, " observation_size"]:
        """The numbers, in their scales, cut off at `FARTHEST`."""
        numbers = [part.value(view) / np.asarray(part.scale, np.float32) for part in self.parts]
        return jnp.clip(jnp.concatenate(numbers), -FARTHEST, FARTHEST).astype(jnp.float32)

    def mirrored(self, obs: Float[Array, " observation_size"]) -> Float[Array, " observation_size"]:
        """What the body's mirror image would see."""
        return obs[self.mirror_order] * self.mirror_signs


def swapped(joints: Float[Array, " joints"]) -> Float[Array, " joints"]:
    """The joints of the body's mirror image: left and right change places, and equal signs mean the same."""
    return jnp.roll(joints, JOINTS // 2)
