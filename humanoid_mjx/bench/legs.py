"""Batches of legs to time: the chain under a controller, shared out over the devices."""

from collections.abc import Callable, Sequence
from functools import cache, partial
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np

from humanoid_mjx import compute
from humanoid_mjx.bench.programs import Programs
from humanoid_mjx.control import Reference, at_rest, pd, servo
from humanoid_mjx.mechanics import dynamics
from humanoid_mjx.robot.chain import Chain
from humanoid_mjx.robot.leg import Leg

TIMESTEP = 0.002
KP, KD, GOAL = 70.0, 32.0, 0.5
MASS_ERRORS = (0.8, 1.2, 0.8, 1.2, 0.8)
"""The controller's model against the leg, link by link: nothing of the leg's can be used again for it."""

SERVO_INERTIA = 1e-4
"""kg m^2, for the gains of a servo without a model: that of the lightest motion, so that its steps are stable."""

BLOCK = {"cpu": 512, "gpu": 262_144}
"""Legs at once on a device: as many as its cache holds, of a core with all that a step works on."""

UNROLL = {"cpu": 1, "gpu": 4}
"""Steps of the chain in one pass of the loop: a GPU waits for the start of each pass."""


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


def start(batch: int) -> tuple[np.ndarray, np.ndarray]:
    """Angles and velocities of the legs before the first step, by leg and joint."""
    generator = np.random.default_rng(0)
    qpos, qvel = 0.1 * generator.standard_normal((2, batch, 5), np.float32)
    return qpos, qvel


def chain(batch: int, steps: int, controller: str, timestep: float = TIMESTEP) -> Programs:
    """This package's dynamics under a controller: none, PD, partitioned PD or computed torque."""
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


def on_all_devices(simulate: Callable[..., Any], state: Sequence[np.ndarray], block: int | None = None) -> Programs:
    """A call that shares out what to start from: a thread for each device, block after block of about `block` rows."""
    batch = len(state[0])
    devices = jax.local_devices()[:batch]
    blocks = max(1, batch // ((block or BLOCK.get(devices[0].platform, batch)) * len(devices)))
    shares = zip(*(np.array_split(array, len(devices) * blocks) for array in state), strict=True)
    placed = [jax.device_put(share, devices[i % len(devices)]) for i, share in enumerate(shares)]
    return Programs(simulate, [placed[i :: len(devices)] for i in range(len(devices))])
