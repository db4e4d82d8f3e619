"""A task as a user writes it, whose robot hangs and leans: its state is a dict that holds a world somewhere."""

from typing import ClassVar

import jax.numpy as jnp

from humanoid_mjx.physics import make_physics
from humanoid_mjx.tasks.continuous import ContinuousTask, State, begin


class Sway(ContinuousTask):
    """Keep both legs at a lean for 0.4 s. It is pushed sideways with 2 N from 0.12 to 0.2 s."""

    observation_size: ClassVar = 1
    action_bins: ClassVar = (3,)

    period: float = 0.04

    @property
    def simulator(self):
        return make_physics("mujoco", robot="legs", timestep=0.02)

    def reset(self, key):
        world = self.simulator.start(jnp.zeros(10), jnp.zeros(10))
        return begin({"robot": (world,), "decisions": jnp.int32(0)}, jnp.zeros(1), ())

    def step(self, state, action, key):
        (world,), decisions = state.data["robot"], state.data["decisions"] + 1
        world = self.simulator.run(world, lambda stages: 5.0 * (0.1 * action - stages.qpos), 2)
        obs, no = world.qpos[:1].astype(jnp.float32), jnp.bool_(False)
        data = {"robot": (world,), "decisions": decisions}
        return State(data, obs, jnp.float32(0), no, decisions >= 10, jnp.bool_(True), obs, {})

    def told(self, data):
        return {"lean, rad": jnp.where(data["decisions"] < 5, 0.1, 0.2)}

    def push_on(self, data, key):
        due = (data["decisions"] >= 3) & (data["decisions"] < 5)
        return jnp.where(due, 2.0, 0.0) * jnp.array([0.0, 1.0, 0.0])
