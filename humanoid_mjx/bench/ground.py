"""Steps a second of the lower body on the ground, a servo asked at every step, in every physics that is installed.

The torso is free, the feet touch the ground, the joints are held in the posture of the task `stand` by its servo at its
time step of 4 ms: the contacts of all four corners of both feet are solved in every step.

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
from copy import copy
from functools import cache, partial
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np

from humanoid_mjx import compute
from humanoid_mjx.bench.elsewhere import with_room
from humanoid_mjx.bench.legs import check_finite, on_all_devices
from humanoid_mjx.bench.measure import Record, Subject, record, time_in_turn
from humanoid_mjx.bench.native import native_rollout
from humanoid_mjx.control import at_rest
from humanoid_mjx.physics import make_physics
from humanoid_mjx.tasks import make_task
from humanoid_mjx.tasks.legged import Stand
from humanoid_mjx.tasks.legged.body import START_SPREAD

REPEATS = 3

BLOCK = {"cpu": 128, "gpu": 32_768}
"""Bodies at once on a device."""

MUJOCO_BATCH = 1024
"""The most bodies that native MuJoCo simulates at once: its rate no longer changes, its stored states would."""

COMPUTED_TORQUE = "mjx-jax computed torque"

UNIT = "control+physics steps/s"


class Setting(NamedTuple):
    """How much is timed: the numbers of bodies, and steps in a call for each subject."""

    batches: Sequence[int]
    steps: Mapping[str, int]


SETTINGS = {
    "cpu": Setting((16, 256, 1024, 4096), {"tree": 50, "mjx-jax": 10, COMPUTED_TORQUE: 10, "mujoco": 50}),
    "gpu": Setting(
        (256, 4096, 32_768, 131_072), {"tree": 50, "mjx-jax": 50, COMPUTED_TORQUE: 50, "mjx-warp": 50, "mujoco": 100}
    ),
}


def run(say: Callable[[str], None], setting: Setting | None = None) -> list[Record]:
    """Time every physics that is installed over several numbers of bodies."""
    setting = setting or SETTINGS.get(jax.default_backend(), SETTINGS["gpu"])
    warp = importlib.util.find_spec("warp") is not None and jax.default_backend() == "gpu"
    records: list[Record] = []
    for batch in setting.batches:
        subjects: dict[str, Subject] = {}
        for name in setting.steps:
            if name != "mjx-warp" or warp:
                steps, bodies = setting.steps[name], min(batch, MUJOCO_BATCH) if name == "mujoco" else batch
                elsewhere = partial(with_room, compiled, name)
                call = {"tree": partial(compiled, name), "mujoco": mujoco}.get(name, elsewhere)
                device = "cpu" if name == "mujoco" else ""
                subjects[name] = Subject(call(bodies, steps), bodies * steps, bodies, REPEATS, device)
        for name, timing in time_in_turn(subjects).items():
            check_finite(f"{name} ground", timing.result)
            records.append(record("physics", f"{name} ground", subjects[name], timing, UNIT))
            say(f"{name + ' ground':30} {subjects[name].batch:9,} bodies  {records[-1].value:10.3e} {UNIT}"
                f"  compiled in {timing.compile_s:4.1f} s"
                f"{records[-1].in_words()}")  # fmt: skip
    return records


def start(batch: int) -> tuple[np.ndarray, np.ndarray]:
    """Positions and velocities of bodies that stand in nearly the posture, by body and degree of freedom."""
    robot = make_task("stand").robot
    spread = START_SPREAD * np.random.default_rng(0).uniform(-1.0, 1.0, (batch, len(robot.posture)))
    torso = np.tile([0.0, 0.0, robot.start_height, 1.0, 0.0, 0.0, 0.0], (batch, 1))
    qpos = np.concatenate([torso, robot.posture + spread], axis=1).astype(np.float32)
    return qpos, np.zeros((batch, qpos.shape[1] - 1), np.float32)


def compiled(subject: str, batch: int, steps: int) -> Callable[[], Any]:
    """Physics in a jax program, by the name of its subject: the positions after so many steps."""
    devices = jax.local_devices()
    block = BLOCK.get(devices[0].platform, batch)
    at_once = -(-batch // (max(1, batch // (block * len(devices))) * len(devices)))
    return on_all_devices(_program(subject, steps, at_once), start(batch), block)


@cache
def _program(subject: str, steps: int, worlds: int) -> Callable[..., Any]:
    physics = subject.partition(" ")[0]
    task: Stand = make_task("stand", control="grounded") if subject == COMPUTED_TORQUE else make_task("stand")
    room = {"worlds": worlds} if physics == "mjx-warp" else {}
    simulator = make_physics(physics, robot=task.robot, timestep=task.timestep, **room)
    controller = task.control.follow(at_rest(jnp.asarray(task.posture, float)))

    def simulate(qpos: jax.Array, qvel: jax.Array) -> jax.Array:
        world = simulator.run(simulator.start(qpos, qvel), controller, steps)
        return jnp.where(world.diverged, jnp.nan, world.qpos)

    return jax.jit(jax.vmap(simulate), compiler_options=compute.compiler_options(simulator.arithmetic))


def mujoco(batch: int, steps: int) -> Callable[[], Any]:
    """Native MuJoCo, one thread a core: the positions after so many steps."""
    model = _model_with_servo(importlib.import_module("mujoco"))
    call = native_rollout(model, *start(batch), steps, np.tile(make_task("stand").posture, (batch, steps, 1)))
    return lambda: call()[:, 1 : 1 + model.nq]


def _model_with_servo(mj: Any) -> Any:
    """The lower body whose motors are the task's servo, their control being the set-point."""
    task: Stand = make_task("stand", physics="mujoco")
    model = copy(task.simulator.model)  # pyright: ignore[reportAttributeAccessIssue]
    limit = model.actuator_ctrlrange.copy()
    model.opt.disableflags |= mj.mjtDisableBit.mjDSBL_AUTORESET
    model.actuator_ctrllimited[:] = 0
    model.actuator_forcelimited[:] = 1
    model.actuator_forcerange[:] = limit
    model.actuator_biastype[:] = mj.mjtBias.mjBIAS_AFFINE
    servo: Any = task.control
    model.actuator_gainprm[:, 0] = servo.stiffness
    model.actuator_biasprm[:, :3] = 0.0, -servo.stiffness, -servo.damping
    return model
