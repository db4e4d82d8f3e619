"""Steps a second of the lower body on the ground, a servo asked at every step, in every physics that is installed.

The torso is free, the feet touch the ground, and the servo of the task `stand` drives the joints at its time step of
4 ms. Calm bodies stand in the task's posture: the contacts of all four corners of both feet are solved in every step.
Those that end in `moving` are thrown about as in a training, and are the same ones for every subject (`visited`).

    tree ground      this package's `Physics` written out as a tree, float32, its solver run to the exact minimum
    mjx-jax ground   this package's `Physics` on MJX in jax, float32, a few iterations of the solver
    mjx-jax computed torque ground
                     the same, where computed torque within the feet's contacts takes the place of the servo
    mjx-warp ground  the same on MJX with NVIDIA Warp, where warp-lang is installed and the backend is a GPU
    mujoco ground    native MuJoCo, float64, solved to convergence: `mujoco.rollout`, one thread a core, where the servo
                     is MuJoCo's own, so that no step waits for Python
"""

import importlib.util
from collections.abc import Callable, Mapping, Sequence
from functools import cache, partial
from itertools import product
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np

from humanoid_mjx import compute
from humanoid_mjx.bench.measure import (
    Record,
    Subject,
    joined,
    native_rollout,
    native_subject,
    on_all_devices,
    time_rates,
    with_room,
    with_servo,
)
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

MUJOCO_BATCH = 1024
"""The most bodies that native MuJoCo simulates at once: its rate no longer changes, its stored states would."""

COMPUTED_TORQUE = "mjx-jax computed torque"

MOVING = ("tree", "mjx-jax", "mujoco")
"""Subjects that also move bodies which are thrown about."""

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


def run(say: Callable[[str], None], setting: Setting | None = None) -> list[Record]:
    """Time every physics that is installed over several numbers of bodies, calm and moving."""
    setting = setting or SETTINGS.get(jax.default_backend(), SETTINGS["gpu"])
    warp = importlib.util.find_spec("warp") is not None and jax.default_backend() == "gpu"
    records: list[Record] = []
    for batch, moving in product(setting.batches, (False, True)):
        subjects: dict[str, Subject] = {}
        for name, steps in setting.steps.items():
            subject = f"{name} ground" + " moving" * moving
            if name == "mujoco":
                subjects[subject] = native_subject(
                    partial(mujoco, moving=moving), batch, MUJOCO_BATCH, steps, repeats=REPEATS
                )
            elif (name in MOVING or not moving) and (name != "mjx-warp" or warp):
                # States are made in this process, which has the compiled tree, and sent to that of MJX.
                states = states_of(batch, moving)
                if name == "tree":
                    call = compiled(name, *states, steps, MOVING_BLOCK if moving else BLOCK)
                else:
                    call = with_room(compiled, name, *states, steps)
                subjects[subject] = Subject(call, batch * steps, batch, REPEATS)
        records += time_rates("physics", subjects, say, "bodies")
    return records


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


def mujoco(batch: int, steps: int, moving: bool = False) -> Callable[[], Any]:
    """`native` from `states_of`."""
    return native(*states_of(batch, moving), steps)


def native(qpos: np.ndarray, qvel: np.ndarray, setpoint: np.ndarray, steps: int) -> Callable[[], Any]:
    """Native MuJoCo, one thread a core: the positions after so many steps."""
    task: Stand = make_task("stand", physics="mujoco")
    servo: Any = task.control
    model = with_servo(task.simulator.model, np.array([servo.stiffness, servo.damping]))
    call = native_rollout(model, qpos, qvel, steps, setpoint)
    return lambda: call()[:, : model.nq]
