"""A task and a learner of a user's own: hop along a line to 1, and a deep learner with a small network."""

from typing import ClassVar

import jax
import jax.numpy as jnp

from humanoid_mjx.learners.deep import DeepQ
from humanoid_mjx.spec import traced
from humanoid_mjx.tasks.continuous import ContinuousTask, State, begin


class Hop(ContinuousTask):
    observation_size: ClassVar = 1
    action_bins: ClassVar = (2,)
    stride: float = traced(0.2)

    def reset(self, key):
        place = jax.random.uniform(key, (1,), maxval=0.5)
        return begin((place, jnp.int32(0)), place, ("ahead",))

    def step(self, state, action, key):
        place, hops = state.data
        place = place + self.stride * (2.0 * action - 1.0)
        there, hops = place[0] >= 1.0, hops + 1
        ahead = jnp.clip(place[0], -1.0, 1.0) - 1.0
        return State((place, hops), place, ahead, there, ~there & (hops >= 20), there, place, {"ahead": ahead})


class BoldQ(DeepQ):
    width: int = 16
    layers: int = 1
