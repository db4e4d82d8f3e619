"""Five environments of one idea each, with known values, as one continuous task whose tables are traced."""

from typing import Any, ClassVar

import jax
import jax.numpy as jnp
import numpy as np
from pydantic import model_validator

from humanoid_mjx.spec import traced
from humanoid_mjx.tasks.continuous import ContinuousTask, State, begin

END = 2
"""The number of the terminal state."""


class Probe(ContinuousTask):
    """States 0 and 1, two choices for each of two joints; every table leads with the state."""

    observation_size: ClassVar = 1

    joints: int = 1
    obs: Any = traced()
    start: Any = traced()
    next_state: Any = traced()
    reward: Any = traced()
    max_episode_steps: int = traced(10)

    @property
    def action_bins(self):
        return (2,) * self.joints

    def reset(self, key):
        state = (jax.random.uniform(key) < self.start).astype(jnp.int32)
        return begin((state, jnp.int32(0)), self.obs[state][None], ("right",))

    def step(self, state, action, key):
        place, length = state.data
        right = action.mean()
        reward = self.reward[place, 0] * (1 - right) + self.reward[place, 1] * right
        following = self.next_state[place]
        over = following == END
        obs = self.obs[jnp.minimum(following, 1)][None]
        cut, data = ~over & (length + 1 >= self.max_episode_steps), (jnp.minimum(following, 1), length + 1)
        return State(data, obs, reward, over, cut, over & (reward > 0), obs, {"right": right})


def make(joints, obs, start, next_state, reward, cap=10):
    arrays = (jnp.asarray(x, jnp.float32) for x in (obs, start))
    obs, start = arrays
    return Probe(
        joints=joints, obs=obs, start=start, next_state=jnp.asarray(next_state, jnp.int32),
        reward=jnp.asarray(reward, jnp.float32), max_episode_steps=cap,
    )  # fmt: skip


DISCOUNT = 0.5

PROBES = {
    # name: (observations of states 0 and 1, probability to start in 1, next states, rewards by choice, Q by state)
    "constant reward": ((0.0, 0.0), 0.0, (END, END), ((1, 1), (1, 1)), ((1, 1), (1, 1))),
    "reward from the observation": ((-1.0, 1.0), 0.5, (END, END), ((-1, -1), (1, 1)), ((-1, -1), (1, 1))),
    "delayed reward": ((-1.0, 1.0), 0.0, (1, END), ((0, 0), (1, 1)), ((0.5, 0.5), (1, 1))),
    "choice": ((0.0, 0.0), 0.0, (END, END), ((-1, 1), (-1, 1)), ((-1, 1), (-1, 1))),
    "both": ((-1.0, 1.0), 0.5, (END, END), ((1, -1), (-1, 1)), ((1, -1), (-1, 1))),
}


def probe(name, joints=1):
    obs, start, following, reward, q = PROBES[name]
    return make(joints, obs, start, following, reward), np.asarray(obs, np.float32)[:, None], np.asarray(q, np.float32)


class NamedProbe(Probe):
    """A probe by its name, as a config can write it."""

    which: str
    obs: Any = traced(None, exclude=True)
    start: Any = traced(None, exclude=True)
    next_state: Any = traced(None, exclude=True)
    reward: Any = traced(None, exclude=True)

    @model_validator(mode="before")
    @classmethod
    def _tables_follow_from_the_name(cls, data):
        return dict(probe(data["which"])[0]) | data
