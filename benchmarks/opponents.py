# pyright: reportAttributeAccessIssue=false
"""What `humanoid-mjx bench` times beside the package, in the same run.

`bench tabular`: `naive_scan`, `python` and `numba` of `other_tables.py`.

`bench physics` and `bench control`, of the leg:

    mjx-jax        MJX on the same leg, float32, batched the same way. With the controller, the position and velocity
                   stages run once a step, and their mass matrix and bias make the torque, so its model can be off only
                   by one factor (0.8) for all links: less work than the chain does.
    mjx-jax plain  the same with XLA's default flags, without `compute.XLA_FLAGS`: CPU only
    mujoco         native MuJoCo, float64: `mujoco.rollout`, one thread a core, without a controller only

Of the lower body on the ground:

    mjx-jax ground   this package's `Physics` on MJX in jax, float32, a few iterations of the solver
    mjx-jax computed torque ground
                     the same, where computed torque within the feet's contacts takes the place of the servo
    mjx-warp ground  the same on MJX with NVIDIA Warp, where warp-lang is installed and the backend is a GPU
    mujoco ground    native MuJoCo, float64, solved to convergence: `mujoco.rollout`, one thread a core, where the servo
                     is MuJoCo's own, so that no step waits for Python

On a CPU, MJX runs in a process of its own.
"""

import contextlib
import io
import os
from collections.abc import Callable, Mapping
from functools import cache, partial
from importlib.util import find_spec
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any, NamedTuple

import ground_physics as ground
import jax
import mujoco as mj
import numpy as np
import other_tables
from leg_physics import GOAL, KD, KP, TIMESTEP, Setting, start
from other_calls import elsewhere, native_rollout, native_subject, with_room, with_servo
from tabular import Made
from timing import CONTROLLED, PLAIN, Record, Subject, on_all_devices, record, time_in_turn

from humanoid_mjx import compute
from humanoid_mjx.config import load
from humanoid_mjx.robot.leg import Leg
from humanoid_mjx.robot.legs import make_mjspec
from humanoid_mjx.tasks import make_task
from humanoid_mjx.training.plan import make_plan
from humanoid_mjx.training.sweep import sweep

MASS_ERROR = 0.8

MJX_REPEATS = 3

LEGS, BODIES = 4096, 1024
"""The most that native MuJoCo simulates at once: its rate no longer changes, its stored states would."""

MOVING = ("mjx-jax", "mujoco")
"""Subjects that also move bodies which are thrown about."""


def tables(say: Callable[[str], None], first: bool) -> dict[str, Callable[..., Made]]:
    """The other tables; plain Python and words of what is not installed only the `first` time."""
    found: dict[str, Callable[..., Made]] = {"naive_scan": other_tables.naive_scan}
    if first:
        found["python"] = other_tables.python
    if find_spec("numba"):
        return found | {"numba": other_tables.numba}
    if first:
        say("numba: not measured, for it is not installed; pip install 'humanoid-mjx[bench]' brings it")
    return found


def controlled(batch: int, setting: Setting) -> dict[str, Subject]:
    """MJX without a controller and under computed torque."""
    units = {"none": PLAIN, "computed torque": CONTROLLED}
    return {f"{name} mjx-jax": _on_mjx(batch, setting, unit) for name, unit in units.items()}


def legs(batch: int, setting: Setting) -> dict[str, Subject]:
    """The leg on MJX and in native MuJoCo; those that are controlled end in "with control"."""
    subjects = {
        "mjx-jax with control": _on_mjx(batch, setting, CONTROLLED),
        "mjx-jax": _on_mjx(batch, setting, PLAIN),
        "mujoco": native_subject(mujoco, batch, LEGS, setting.mujoco_steps, unit=PLAIN),
    }
    if jax.default_backend() == "cpu":
        call = elsewhere(mjx_jax, batch, setting.mjx_steps, True, plain=True)
        subjects["mjx-jax plain with control"] = Subject(call, batch * setting.mjx_steps, batch, MJX_REPEATS)
    return subjects


def _on_mjx(batch: int, setting: Setting, unit: str) -> Subject:
    call = with_room(mjx_jax, batch, setting.mjx_steps, unit == CONTROLLED)
    return Subject(call, batch * setting.mjx_steps, batch, MJX_REPEATS, unit=unit)


def on_ground(name: str, batch: int, moving: bool, steps: int) -> Subject | None:
    """The lower body in another physics; None where it is not installed, or does not move it."""
    if name == "mujoco":
        return native_subject(partial(native_bodies, moving=moving), batch, BODIES, steps, repeats=ground.REPEATS)
    warp = find_spec("warp") is not None and jax.default_backend() == "gpu"
    if (moving and name not in MOVING) or (name == "mjx-warp" and not warp):
        return None
    # States are made in this process, which has the compiled tree, and sent to that of MJX.
    call = with_room(ground.compiled, name, *ground.states_of(batch, moving), steps)
    return Subject(call, batch * steps, batch, ground.REPEATS)


def native_bodies(batch: int, steps: int, moving: bool = False) -> Callable[[], Any]:
    """`native` from `states_of`."""
    return native(*ground.states_of(batch, moving), steps)


def native(qpos: np.ndarray, qvel: np.ndarray, setpoint: np.ndarray, steps: int) -> Callable[[], Any]:
    """Native MuJoCo, one thread a core: the positions after so many steps."""
    task = make_task("stand", physics="mujoco")
    servo: Any = task.control
    model = with_servo(task.simulator.model, np.array([servo.stiffness, servo.damping]))
    call = native_rollout(model, qpos, qvel, steps, setpoint)
    return lambda: call()[:, : model.nq]


def mjx_jax(batch: int, steps: int, controlled: bool) -> Callable[[], Any]:
    """MJX, with the jax implementation of its physics."""
    return on_all_devices(_mjx_program(steps, controlled), start(batch))


@cache
def _mjx_program(steps: int, controlled: bool) -> Callable[..., Any]:
    # Importing MJX tells that warp is missing, and MJX with jax does without it.
    with contextlib.redirect_stdout(io.StringIO()), contextlib.redirect_stderr(io.StringIO()):
        from mujoco import mjx
    model = mjx.put_model(_mujoco_model(), impl="jax")

    def step(data: Any, _: Any) -> tuple[Any, None]:
        if not controlled:
            return mjx.step(model, data), None
        data = mjx.fwd_velocity(model, mjx.fwd_position(model, data))
        wanted = KP * (GOAL - data.qpos) - KD * data.qvel
        torque = MASS_ERROR * (mjx.full_m(model, data) @ wanted + data.qfrc_bias)
        data = mjx.fwd_acceleration(model, data.replace(qfrc_applied=torque))
        return mjx.euler(model, data.replace(qacc=data.qacc_smooth)), None

    def simulate(qpos: jax.Array, qvel: jax.Array) -> tuple[jax.Array, jax.Array]:
        data = mjx.make_data(model).replace(qpos=qpos, qvel=qvel)
        data = jax.lax.scan(step, data, length=steps)[0]
        return data.qpos, data.qvel

    # XLA as it comes is what this process has where `elsewhere` began it so.
    ours = compute.XLA_FLAGS in os.environ.get("XLA_FLAGS", "")
    return jax.jit(jax.vmap(simulate), compiler_options=compute.compiler_options("arrays") if ours else None)


def mujoco(batch: int, steps: int) -> Callable[[], Any]:
    """Native MuJoCo, one thread a core: the legs after so many steps."""
    return native_rollout(_mujoco_model(), *start(batch), steps)


def _mujoco_model() -> Any:
    """The leg, without the stages that find neither contacts nor constraints in it."""
    model = make_mjspec(Leg.physical(), TIMESTEP).compile()
    model.opt.disableflags |= mj.mjtDisableBit.mjDSBL_CONSTRAINT | mj.mjtDisableBit.mjDSBL_CONTACT
    return model


class Size(NamedTuple):
    """Size of a training: seeds of every point of the config's sweep, and episodes of each run."""

    seeds: int
    episodes: int


POSTURES: dict[str, Mapping[str, Size]] = {
    "cpu": {"chain": Size(32, 60), "mjx-jax": Size(2, 4)},
    "gpu": {"chain": Size(256, 60), "mjx-jax": Size(256, 10)},
}


def postures(say: Callable[[str], None], setting: Mapping[str, Size] | None = None) -> list[Record]:
    """Time the whole of training tables on `posture_switch` in each physics, by the values of the config of that name.

    Every call is a sweep, from the first episode to the tables on disk. An episode is short once a table is good, so
    that the steps a second, one for each decision of the learner, stand beside it; each is 40 control steps of two
    legs. Fewer runs and episodes than the config's are trained where a physics is slow.
    """
    setting = setting or POSTURES.get(jax.default_backend(), POSTURES["gpu"])
    records: list[Record] = []
    for physics, size in setting.items():
        sizes = f"seeds={size.seeds}", f"episodes={size.episodes}", "record=1"
        runs = make_plan(load("posture_switch", sizes)).num_runs
        overrides = *sizes, f"task.physics={physics}"
        call = with_room(train_postures, *overrides) if physics.startswith("mjx") else train_postures(*overrides)
        subject = Subject(call, runs * size.episodes, runs, repeats=3)
        name = f"{physics} posture_switch"
        timing = time_in_turn({name: subject})[name]
        records.append(record("physics", name, subject, timing, "episodes/s"))
        records.append(record("physics", name, subject, timing, "steps/s", float(timing.result)))
        say(f"{name:22} {runs:9,} runs  {records[-2].value:10.3e} episodes/s  {records[-1].value:10.3e} steps/s"
            f"  compiled in {timing.compile_s:4.1f} s")  # fmt: skip
    return records


def train_postures(*overrides: str) -> Callable[[], np.float64]:
    """A call that trains the sweep of `posture_switch` so changed, and counts the steps of all its episodes."""

    def call() -> np.float64:
        with TemporaryDirectory() as folder:
            results = sweep("posture_switch", Path(folder) / "run", overrides=overrides).results
        return np.sum(results["steps"] * results["episode"], dtype=np.float64)

    return call
