"""Steps a second of the lower body on the ground, a servo asked at every step.

The torso is free, the feet touch the ground, and the servo of the task `stand` drives the joints at its time step of
4 ms. Calm bodies stand in the task's posture: the contacts of all four corners of both feet are solved in every step.
Those that end in `moving` are thrown about as in a training, and are the same ones for every subject (`visited`).

    tree ground      this package's `Physics` written out as a tree, float32, its solver run to the exact minimum

`opponents.py` adds the other physics.
"""

from collections.abc import Callable, Mapping, Sequence
from functools import cache
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from timing import joined, on_all_devices

from humanoid_mjx import compute
from humanoid_mjx.control import at_rest
from humanoid_mjx.physics import make_physics
from humanoid_mjx.tasks import make_task
from humanoid_mjx.tasks.legged import Stand
from humanoid_mjx.tasks.legged.body import START_SPREAD

REPEATS = 3

BLOCK = {"cpu": 128, "gpu": 32_768}
"""Bodies at once on a device."""

MOVING_BLOCK = {"cpu": 1024, "gpu": 32_768}
"""The same for the tree where bodies are thrown about. Some need more Newton steps than others: the more bodies a call
has, the fuller are the blocks into which the solver gathers those."""

COMPUTED_TORQUE = "mjx-jax computed torque"

MOVES, MOVE_STEPS = 10, 50
"""Set-points that a body that is thrown about has had at most, and time steps of each, 0.2 s."""

DISTINCT = 1024
"""The most bodies that are thrown about one by one; more start where these do, to set-points of their own."""

OFFSET = 0.35
"""Largest distance of a random set-point from the posture, rad: that of a choice of `walk`, 20 degrees."""

THROWN = (0.3, 1.5)
"""Standard deviations of the torso's velocity, m/s and rad/s, before a body's first set-point: a push."""


class Setting(NamedTuple):
    """Size of a benchmark: the numbers of bodies, and steps in a call for each subject."""

    batches: Sequence[int]
    steps: Mapping[str, int]


SETTINGS = {
    "cpu": Setting((16, 256, 1024, 4096), {"tree": 50, "mjx-jax": 10, COMPUTED_TORQUE: 10, "mujoco": 50}),
    "gpu": Setting(
        (256, 4096, 32_768, 131_072), {"tree": 50, "mjx-jax": 50, COMPUTED_TORQUE: 50, "mjx-warp": 50, "mujoco": 100}
    ),
}


States = tuple[np.ndarray, np.ndarray, np.ndarray]
"""Positions, velocities and set-points, by body."""


def states_of(batch: int, moving: bool = False) -> States:
    """Bodies that stand in nearly the posture and are to hold it, or those of `visited`."""
    if moving:
        return visited(batch)
    robot = make_task("stand").robot
    spread = START_SPREAD * np.random.default_rng(0).uniform(-1.0, 1.0, (batch, len(robot.posture)))
    torso = np.tile([0.0, 0.0, robot.start_height, 1.0, 0.0, 0.0, 0.0], (batch, 1))
    qpos = np.concatenate([torso, robot.posture + spread], axis=1).astype(np.float32)
    setpoint = np.tile(robot.posture, (batch, 1)).astype(np.float32)
    return qpos, np.zeros((batch, qpos.shape[1] - 1), np.float32), setpoint


@cache
def visited(batch: int) -> States:
    """Bodies as a training throws them about: from the start of an episode, standing, to 2 s later, mostly fallen.

    Each has been pushed and has followed random set-points, from none to `MOVES` of them, and gets another one.
    """
    random = np.random.default_rng(1)
    qpos, qvel, posture = states_of(min(batch, DISTINCT))
    qvel[:, :6] = random.normal(0.0, np.repeat(THROWN, 3), (len(qvel), 6))
    ages = random.integers(0, MOVES, len(qpos), endpoint=True)[:, None]

    def setpoints(bodies: int) -> np.ndarray:
        return (posture[:1] + random.uniform(-OFFSET, OFFSET, (bodies, posture.shape[1]))).astype(np.float32)

    for move in range(MOVES):
        after = joined(compiled("tree", qpos, qvel, setpoints(len(qpos)), MOVE_STEPS)())
        # A body that the physics gives up stays where it was.
        qpos, qvel = (
            np.where((move < ages) & np.isfinite(new), new, old) for new, old in zip(after, (qpos, qvel), strict=True)
        )
    return np.resize(qpos, (batch, qpos.shape[1])), np.resize(qvel, (batch, qvel.shape[1])), setpoints(batch)


def compiled(
    subject: str,
    qpos: np.ndarray,
    qvel: np.ndarray,
    setpoint: np.ndarray,
    steps: int,
    blocks: Mapping[str, int] = BLOCK,
) -> Callable[[], Any]:
    """Physics in a jax program, by the name of its subject: positions and velocities after so many steps."""
    devices, batch = jax.local_devices(), len(qpos)
    block = blocks.get(devices[0].platform, batch)
    at_once = -(-batch // (max(1, batch // (block * len(devices))) * len(devices)))
    return on_all_devices(_program(subject, steps, at_once), (qpos, qvel, setpoint), block)


@cache
def _program(subject: str, steps: int, worlds: int) -> Callable[..., Any]:
    physics = subject.partition(" ")[0]
    task: Stand = make_task("stand", control="grounded") if subject == COMPUTED_TORQUE else make_task("stand")
    room = {"worlds": worlds} if physics == "mjx-warp" else {}
    simulator = make_physics(physics, robot=task.robot, timestep=task.timestep, **room)

    def simulate(qpos: jax.Array, qvel: jax.Array, setpoint: jax.Array) -> tuple[jax.Array, ...]:
        controller = task.control.follow(at_rest(setpoint))
        world = simulator.run(simulator.start(qpos, qvel), controller, steps)
        return tuple(jnp.where(world.diverged, jnp.nan, part) for part in (world.qpos, world.qvel))

    return jax.jit(jax.vmap(simulate), compiler_options=compute.compiler_options(simulator.arithmetic))
