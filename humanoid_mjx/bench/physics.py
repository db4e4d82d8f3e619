"""Steps a second of the leg at 2 ms, with computed torque and without, against MJX and native MuJoCo.

    chain          this package: `dynamics.rollout`, float32, one program per core on a CPU. The controller's model has
                   the mass of every link 20 % off, one up, the next down: nothing of the plant's can be used again.
    mjx-jax        MJX on the same leg, float32, batched the same way. With the controller, the position and velocity
                   stages run once a step, and their mass matrix and bias make the torque, so its model can be off only
                   by one factor (0.8) for all links: less work than the chain does.
    mjx-jax plain  the same with XLA's default flags, without `compute.XLA_FLAGS`: CPU only
    mujoco         native MuJoCo, float64: `mujoco.rollout`, one thread a core, without a controller only

On a CPU, MJX runs in a process of its own (`bench.elsewhere`).

A step is one of physics, with its control where there is control. `ground` and `postures` follow in the same bench.
"""

import contextlib
import io
import os
from collections.abc import Callable, Sequence
from functools import cache
from importlib import import_module
from typing import Any, NamedTuple

import jax

from humanoid_mjx import compute
from humanoid_mjx.bench import ground, postures
from humanoid_mjx.bench.elsewhere import Elsewhere, with_room
from humanoid_mjx.bench.legs import GOAL, KD, KP, TIMESTEP, chain, on_all_devices, start
from humanoid_mjx.bench.measure import PLAIN, Record, Subject, time_rates
from humanoid_mjx.bench.native import native_rollout, native_subject
from humanoid_mjx.robot.leg import Leg
from humanoid_mjx.robot.mjcf import make_mjspec

MJX_REPEATS = 3
MASS_ERROR = 0.8


class Setting(NamedTuple):
    """How much is timed: the numbers of legs, and steps in a call for each subject."""

    batches: Sequence[int]
    chain_steps: int
    mjx_steps: int
    mujoco_steps: int


SETTINGS = {
    "cpu": Setting((16, 256, 1024, 8192), 500, 10, 100),
    "gpu": Setting((256, 4096, 32_768, 262_144, 1_048_576), 500, 100, 100),
}

MUJOCO_BATCH = 4096
"""The most legs that native MuJoCo simulates at once: its rate no longer changes, its stored states would."""


def run(say: Callable[[str], None]) -> list[Record]:
    """Time the leg, then the lower body on the ground, then training in simulation."""
    return legs(say) + ground.run(say) + postures.run(say)


def legs(say: Callable[[str], None], setting: Setting | None = None) -> list[Record]:
    """Time all subjects over several numbers of legs."""
    setting = setting or SETTINGS.get(jax.default_backend(), SETTINGS["gpu"])
    records: list[Record] = []
    for batch in setting.batches:
        subjects = make_subjects(batch, setting)
        found = time_rates("physics", subjects, say, "legs")
        ours, *others = zip(subjects, found, strict=True)
        words = (f"{ours[1].value / other.value:.1f} x {name}" for name, other in others)
        say(f"{ours[0]}: {', '.join(words)}")
        records += found
    return records


def make_subjects(batch: int, setting: Setting) -> dict[str, Subject]:
    """The subjects for a number of legs; those that are controlled end in "with control"."""
    quick, slow = batch * setting.chain_steps, batch * setting.mjx_steps
    subjects = {
        "chain with control": Subject(chain(batch, setting.chain_steps, "computed torque"), quick, batch),
        "mjx-jax with control": Subject(with_room(mjx_jax, batch, setting.mjx_steps, True), slow, batch, MJX_REPEATS),
        "chain": Subject(chain(batch, setting.chain_steps, "none"), quick, batch, unit=PLAIN),
        "mjx-jax": Subject(with_room(mjx_jax, batch, setting.mjx_steps, False), slow, batch, MJX_REPEATS, unit=PLAIN),
        "mujoco": native_subject(mujoco, batch, MUJOCO_BATCH, setting.mujoco_steps, unit=PLAIN),
    }
    if jax.default_backend() == "cpu":
        plain = Elsewhere(mjx_jax, batch, setting.mjx_steps, True, plain=True)
        subjects["mjx-jax plain with control"] = Subject(plain, slow, batch, MJX_REPEATS)
    return subjects


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

    # XLA as it comes is what this process has where `Elsewhere` began it so.
    ours = compute.XLA_FLAGS in os.environ.get("XLA_FLAGS", "")
    return jax.jit(jax.vmap(simulate), compiler_options=compute.compiler_options("arrays") if ours else None)


def mujoco(batch: int, steps: int) -> Callable[[], Any]:
    """Native MuJoCo, one thread a core: the legs after so many steps."""
    return native_rollout(_mujoco_model(), *start(batch), steps)


def _mujoco_model() -> Any:
    """The leg, without the stages that find neither contacts nor constraints in it."""
    mj: Any = import_module("mujoco")
    model = make_mjspec(Leg.physical(), TIMESTEP).compile()
    model.opt.disableflags |= mj.mjtDisableBit.mjDSBL_CONSTRAINT | mj.mjtDisableBit.mjDSBL_CONTACT
    return model
