"""Standing bodies in MJX and in native MuJoCo, for tests of both."""

from functools import cache

import jax
import jax.numpy as jnp
from tree_robots import near_upright

from humanoid_mjx.physics import make_physics
from humanoid_mjx.physics.base import Stages

WORLDS = 4
MJX = make_physics("mjx-jax")
NATIVE = make_physics("mujoco")
VALUES = jax.tree.map(jnp.float32, MJX)
"""MJX with its values as data of a program."""


def hold(stages: Stages):
    """A plain joint servo about the standing posture."""
    return -6.0 * stages.qpos - 0.2 * stages.qvel


step = jax.jit(jax.vmap(lambda physics, world: physics.step(world, hold), in_axes=(None, 0)))
"""One time step of many worlds."""


@cache
def standing():
    return near_upright(MJX)
