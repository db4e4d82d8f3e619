"""Named observations of a view. A task declares a tuple of names; everything else about them follows from it."""

from collections.abc import Callable, Sequence
from typing import Any, Literal, NamedTuple

import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from humanoid_mjx.robot import Robot
from humanoid_mjx.spec import InputError, known
from humanoid_mjx.tasks.legged.view import View
from humanoid_mjx.thesis.leg import GRAVITY

SPEED, TURN, FORCE, HEIGHT = 5.0, 3.0, 0.6, 0.144
"""Velocity of a joint, rad/s, turn rate of the torso, rad/s, force on a foot, as a share of the weight, and height of a
foot, as one of the legs' length, whose observations are 1."""

FARTHEST = 5.0
"""Size at which observations are cut off."""

POLAR, AXIAL = (1.0, -1.0, 1.0), (-1.0, 1.0, -1.0)
"""Signs of the mirror image of a vector, and of a rotation."""


class Observation(NamedTuple):
    """Numbers that a learner sees."""

    size: int | Literal["joints", "feet"]
    """Number of values, or one for each joint or foot."""
    value: Callable[[View], Any]
    scale: Any = 1.0
    """The value that the learner sees as 1: one number, one for each, or a function of the robot."""
    mirror: tuple[float, ...] | None = None
    """The image in the plane of symmetry: the sign of each number; those of joints and feet change sides."""


OBSERVATIONS = {
    "encoders": Observation("joints", lambda view: view.episode.readings.encoders - view.robot.posture),
    "rates": Observation("joints", lambda view: view.episode.rates, SPEED),
    "gyroscope": Observation(3, lambda view: view.episode.readings.gyroscope, TURN, AXIAL),
    "accelerometer": Observation(3, lambda view: view.episode.readings.accelerometer, GRAVITY, POLAR),
    "down": Observation(3, lambda view: view.episode.down, mirror=POLAR),
    "contact": Observation("feet", lambda view: view.episode.readings.foot_contact, lambda robot: robot.force(FORCE)),
    "offsets": Observation("joints", lambda view: view.episode.offsets),
    "command": Observation(3, lambda view: view.command, (0.5, 0.25, 1.0), (1.0, -1.0, -1.0)),
    "clock": Observation(2, lambda view: clock(view), mirror=(-1.0, -1.0)),
    "true_down": Observation(3, lambda view: -view.up, mirror=POLAR),
    "velocity": Observation(3, lambda view: view.rotation.T @ view.episode.world.qvel[:3], mirror=POLAR),
    "height": Observation(1, lambda view: view.height[None], lambda robot: robot.start_height, (1.0,)),
    "turn_rate": Observation(1, lambda view: view.turn_rate[None], TURN, (-1.0,)),
    "foot_heights": Observation("feet", lambda view: view.feet.height, lambda robot: robot.length(HEIGHT)),
    "foot_loads": Observation("feet", lambda view: view.feet.load, lambda robot: robot.force(FORCE)),
}
"""The observations by name. A task may add its own by putting an `Observation` among the names."""

PROPRIOCEPTION = ("encoders", "rates", "gyroscope", "accelerometer", "down", "contact", "offsets")
"""Encoders about the posture, their rates of change, the torso's gyroscope and accelerometer, the direction of gravity
as estimated, foot contacts, the set-points' offsets."""

PRIVILEGED = ("true_down", "velocity", "height")
"""The true attitude and motion of the torso: direction of gravity and velocity in its frame, height of the hips."""


def clock(view: View) -> Float[Array, "2"]:
    """Sine and cosine of the gait's phase; both 0 while the command is to stand."""
    angle = 2 * jnp.pi * view.episode.phase
    return jnp.where(view.moving, jnp.stack([jnp.sin(angle), jnp.cos(angle)]), 0.0)


class Observed:
    """The observations that a task names, one after the other. An unknown name raises an InputError."""

    def __init__(self, names: Sequence[str | Observation], robot: Robot):
        for name in names:
            if isinstance(name, str) and name not in OBSERVATIONS:
                raise InputError(f"observations: unknown name {name!r}; {known(name, OBSERVATIONS)}.")
        self.parts = [OBSERVATIONS[name] if isinstance(name, str) else name for name in names]
        swaps: dict[Any, Any] = {"joints": robot.joint_images, "feet": (robot.foot_images, np.ones(len(robot.feet)))}
        images = [
            swaps.get(p.size) or (np.arange(p.size), np.array(p.mirror or (1.0,) * int(p.size))) for p in self.parts
        ]
        sizes = [len(order) for order, _ in images]
        self.size, ends = sum(sizes), np.cumsum([0, *sizes])
        scales: list[Any] = [p.scale(robot) if callable(p.scale) else p.scale for p in self.parts]
        self.scales = [np.asarray(scale, np.float32) for scale in scales]
        self.mirror_order = np.concatenate([start + rows for start, (rows, _) in zip(ends, images, strict=False)])
        self.mirror_signs = np.concatenate([signs for _, signs in images]).astype(np.float32)

    def __call__(self, view: View) -> Float[Array, " observation_size"]:
        """The numbers, in their scales, cut off at `FARTHEST`."""
        numbers = [part.value(view) / scale for part, scale in zip(self.parts, self.scales, strict=True)]
        return jnp.clip(jnp.concatenate(numbers), -FARTHEST, FARTHEST).astype(jnp.float32)

    def mirrored(self, obs: Float[Array, " observation_size"]) -> Float[Array, " observation_size"]:
        """Return the observation of the body's mirror image."""
        return obs[self.mirror_order] * self.mirror_signs


def swapped(joints: Float[Array, " joints"], robot: Robot) -> Float[Array, " joints"]:
    """The joints of the body's mirror image."""
    order, signs = robot.joint_images
    return joints[order] * signs.astype(np.float32)
