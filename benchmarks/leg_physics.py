"""Steps a second of the leg in the air, under computed torque or without a controller, at 2 ms.

The physics is this package's chain, float32: `ChainPhysics.run`, on a CPU one program per core. The controller's model
has the mass of every link 20 % off, one up, the next down: nothing of the plant's can be used again. `opponents.py`
adds MJX and native MuJoCo.
"""

from collections.abc import Callable
from functools import cache
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
from timing import on_all_devices

from humanoid_mjx import compute, make_physics
from humanoid_mjx.control import at_rest, servo
from humanoid_mjx.control.stages import Stages

TIMESTEP = 0.002
"""s."""

KP, KD, GOAL = 70.0, 32.0, 0.5
MASS_ERRORS = (0.8, 1.2, 0.8, 1.2, 0.8)
"""The controller's model against the leg, link by link."""


def start(batch: int) -> tuple[np.ndarray, np.ndarray]:
    """Angles and velocities of the legs before the first step, by leg and joint."""
    generator = np.random.default_rng(0)
    qpos, qvel = 0.1 * generator.standard_normal((2, batch, 5), np.float32)
    return qpos, qvel


def chain(batch: int, steps: int, controlled: bool = True, again: int = 1) -> Callable[[], Any]:
    """This package's dynamics, run `again` times a call."""
    return on_all_devices(_chain_program(steps, controlled), start(batch), again=again)


@cache
def _chain_program(steps: int, controlled: bool) -> Callable[..., Any]:
    physics, errors = make_physics("chain", robot="leg", timestep=TIMESTEP), jnp.array(MASS_ERRORS)
    kp, kd, goal = jnp.full(5, KP), jnp.full(5, KD), at_rest(jnp.full(5, GOAL))

    def law(state: Stages) -> jax.Array:
        return state.torque_for(servo(kp, kd, goal, state.qpos, state.qvel), errors) if controlled else jnp.zeros(5)

    def simulate(qpos: jax.Array, qvel: jax.Array) -> Any:
        return physics.run(physics.start(qpos, qvel), law, steps)

    return jax.jit(jax.vmap(simulate), compiler_options=compute.compiler_options("scalars", every_device=True))
