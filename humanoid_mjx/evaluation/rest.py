"""A policy that nobody trained: a robot's servo alone, which shows what the robot does before it has learned."""

from typing import Any

import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float, Key

from humanoid_mjx.learners.deep import DeepQ
from humanoid_mjx.tasks.legged.episode import Episode
from humanoid_mjx.tasks.legged.events import Fall
from humanoid_mjx.tasks.legged.stand import Stand
from humanoid_mjx.types import FloatScalar

TURNING = 90.0
"""Speed at which set-points go where a person wants them, degrees/s: a jump would throw the robot."""


class AtRest(DeepQ):
    """The middle choice always: each set-point stays at the posture that the task begins with."""

    def init_value(self, key: Key[Array, ""]) -> tuple[Any, Any]:
        return {"params": {"scale": jnp.ones(())}}, ()

    def q_values(self, value: Any, obs: Float[Array, "*batch size"]) -> Float[Array, "*batch joints bins"]:
        middle = (np.array(self.env.action_bins)[:, None] - 1) // 2
        values = -value["params"]["scale"] * jnp.abs(jnp.arange(self.bins) - middle)
        return jnp.broadcast_to(values, (*obs.shape[:-1], *values.shape))


class Posed(Stand):
    """A robot whose command is the set-points of its joints, degrees. It may crouch; only a lean ends the episode."""

    @classmethod
    def of(cls, task: Stand) -> "Posed":
        """Return the task with this command in place of the learner's offsets."""
        return cls.model_construct(**dict(task)).replace(fall=Fall(height=0.0))

    @property
    def home(self) -> dict[str, float]:
        """Set-points of the joints in the robot's posture, degrees."""
        return dict(zip(self.robot.joints, np.degrees(self.robot.posture).tolist(), strict=True))

    @property
    def told_ranges(self) -> dict[str, tuple[float, float]]:
        """The joints' ranges, degrees, within those of set-points; joints without one turn half round from home."""
        robot, half = self.robot, [-np.pi, np.pi]
        limited, free = robot.model.jnt_limited[robot.driven, None], robot.posture[:, None] + half
        ends = np.where(limited, robot.ranges_rad, free).T
        lows, highs = np.degrees(np.clip(ends, *robot.setpoint_limits)).tolist()
        return dict(zip(robot.joints, zip(lows, highs, strict=True), strict=True))

    def steered(self, data: Episode, told: dict[str, FloatScalar]) -> Episode:
        away = jnp.stack([told[name] - home for name, home in self.home.items()]) / self.action_scale
        step = TURNING * self.period / self.action_scale
        return data._replace(offsets=data.offsets + jnp.clip(away - data.offsets, -step, step))

    def offsets(self, before: Episode, command: Float[Array, " joints"]) -> Float[Array, " joints"]:
        return before.offsets
