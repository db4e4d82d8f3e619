"""Steps a second of the leg in simulation, under control and without.

`bench physics`, at 2 ms, followed by the lower body (`ground`) and whole trainings (`postures`):

    chain          this package: `dynamics.rollout`, float32, one program per core on a CPU. The controller's model has
                   the mass of every link 20 % off, one up, the next down: nothing of the plant's can be used again.

`bench control`, at 0.5 ms, on the chain:

    none               the dynamics alone
    PD                 a servo without a model
    partitioned PD     with the inertia of every joint in its posture, from a model
    computed torque    with the whole dynamics of a model

A step is one of physics, with its control where there is control. `opponents.py` adds MJX and native MuJoCo.
"""

from collections.abc import Callable, Sequence
from functools import cache, partial
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from timing import on_all_devices

from humanoid_mjx import compute
from humanoid_mjx.control import Reference, at_rest, pd, servo
from humanoid_mjx.mechanics import dynamics
from humanoid_mjx.robot.chain import Chain
from humanoid_mjx.robot.leg import Leg

TIMESTEP, FINE_TIMESTEP = 0.002, 0.0005
"""s. At 2 ms a held torque of the partitioned servo is unstable."""

KP, KD, GOAL = 70.0, 32.0, 0.5
MASS_ERRORS = (0.8, 1.2, 0.8, 1.2, 0.8)
"""The controller's model against the leg, link by link: nothing of the leg's can be used again for it."""

SERVO_INERTIA = 1e-4
"""kg m^2, for the gains of a servo without a model: that of the lightest motion, so that its steps are stable."""

UNROLL = {"cpu": 1, "gpu": 4}
"""Steps of the chain in one pass of the loop: a GPU waits for the start of each pass."""

CONTROLLERS = ("none", "PD", "partitioned PD", "computed torque")


class Setting(NamedTuple):
    """Size of a benchmark: the numbers of legs, and steps in a call for each subject."""

    batches: Sequence[int]
    chain_steps: int
    mjx_steps: int
    mujoco_steps: int = 100


SETTINGS = {
    "cpu": Setting((16, 256, 1024, 8192), 500, 10),
    "gpu": Setting((256, 4096, 32_768, 262_144, 1_048_576), 500, 100),
}
CONTROL = {"cpu": Setting((1024, 8192), 500, 10), "gpu": Setting((32_768, 1_048_576), 500, 50)}


def start(batch: int) -> tuple[np.ndarray, np.ndarray]:
    """Angles and velocities of the legs before the first step, by leg and joint."""
    generator = np.random.default_rng(0)
    qpos, qvel = 0.1 * generator.standard_normal((2, batch, 5), np.float32)
    return qpos, qvel


def chain(batch: int, steps: int, controller: str, timestep: float = TIMESTEP) -> Callable[[], Any]:
    """This package's dynamics under one of `CONTROLLERS`."""
    return on_all_devices(_chain_program(steps, controller, timestep), start(batch))


@cache
def _chain_program(steps: int, name: str, timestep: float) -> Callable[..., Any]:
    leg = Leg.physical()
    act = _controller(name, leg.scaled(np.array(MASS_ERRORS)))
    goal = at_rest(jnp.full(5, GOAL))

    def controller(_: Any, qpos: jax.Array, qvel: jax.Array) -> jax.Array:
        return act(goal, qpos, qvel)

    def simulate(qpos: jax.Array, qvel: jax.Array) -> dynamics.State:
        unroll = UNROLL.get(jax.default_backend(), 1)
        return dynamics.rollout(leg, qpos, qvel, controller, timestep, steps, unroll=unroll)[0]

    return jax.jit(jax.vmap(simulate), compiler_options=compute.compiler_options("scalars", every_device=True))


def _controller(name: str, model: Chain) -> Callable[..., Any]:
    """Return the controller of this name: from the reference and the state to torques, N m."""
    kp, kd = jnp.full(5, KP), jnp.full(5, KD)

    def partitioned_pd(reference: Reference, qpos: jax.Array, qvel: jax.Array) -> jax.Array:
        return dynamics.joint_inertias(model, qpos) * servo(kp, kd, reference, qpos, qvel)

    def computed_torque(reference: Reference, qpos: jax.Array, qvel: jax.Array) -> jax.Array:
        return dynamics.inverse_dynamics(model, qpos, qvel, servo(kp, kd, reference, qpos, qvel))

    return {
        "none": lambda reference, qpos, qvel: jnp.zeros(5),
        "PD": partial(pd, SERVO_INERTIA * kp, SERVO_INERTIA * kd),
        "partitioned PD": partitioned_pd,
        "computed torque": computed_torque,
    }[name]
