# pyright: reportAttributeAccessIssue=false
"""MJX and native MuJoCo on the scenes of `leg_physics.py` and `ground_physics.py`, and trainings on another physics.

Legs on MJX are in float32 and batched as the package's. With the controller, the position and velocity stages run once
a step, and their mass matrix and bias make the torque, so its model can be off only by one factor for all links: less
work than the chain does. Native MuJoCo computes in float64, one thread a core, its solver run to convergence; its legs
have no controller, its robots a servo of its own.
"""

import contextlib
import io
import os
from collections.abc import Callable
from functools import cache
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any, NamedTuple

import ground_physics as ground
import jax
import mujoco as mj
import numpy as np
from leg_physics import GOAL, KD, KP, TIMESTEP, start
from other_calls import native_rollout
from timing import Record, Subject, on_all_devices, time_rates

from humanoid_mjx import compute
from humanoid_mjx.config import load
from humanoid_mjx.robot.chain import Chain
from humanoid_mjx.robot.leg import Leg
from humanoid_mjx.robot.legs import add_chain
from humanoid_mjx.training.plan import make_plan
from humanoid_mjx.training.sweep import sweep

MASS_ERROR = 0.8

LEGS = 4096
"""The most that native MuJoCo simulates at once: its rate no longer changes, its stored states would."""


def native(states: ground.States, steps: int, robot: str = "lower_body") -> Callable[[], Any]:
    """Robots in native MuJoCo: their positions after so many steps."""
    model = ground.native_model(robot)
    call = native_rollout(model, *states[:2], steps, states[2])
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

    # A process may have been started with XLA as it comes.
    ours = compute.XLA_FLAGS in os.environ.get("XLA_FLAGS", "")
    return jax.jit(jax.vmap(simulate), compiler_options=compute.compiler_options("arrays") if ours else None)


def mujoco(batch: int, steps: int) -> Callable[[], Any]:
    """Native MuJoCo, one thread a core: the legs after so many steps."""
    return native_rollout(_mujoco_model(), *start(batch), steps)


def make_mjspec(chain: Chain, timestep: float = TIMESTEP) -> mj.MjSpec:
    """The chain as a model, frame 0 being the world, with this time step, s."""
    spec = mj.MjSpec()
    add_chain(spec.worldbody, chain, [f"joint{i + 1}" for i in range(chain.num_joints)])
    spec.option.timestep, spec.option.gravity = timestep, np.asarray(chain.gravity, np.float64)
    return spec


def _mujoco_model() -> Any:
    """The leg, without the stages that find neither contacts nor constraints in it."""
    model = make_mjspec(Leg.physical()).compile()
    model.opt.disableflags |= mj.mjtDisableBit.mjDSBL_CONSTRAINT | mj.mjtDisableBit.mjDSBL_CONTACT
    return model


class Size(NamedTuple):
    """Size of a training: seeds of every point of the config's sweep, and episodes of each run."""

    seeds: int
    episodes: int


POSTURES = {
    "cpu": {"chain": Size(32, 60), "mjx-jax": Size(2, 4)},
    "gpu": {"chain": Size(256, 60), "mjx-jax": Size(256, 10)},
}


def postures_row(physics: str, size: Size | None = None) -> list[Record]:
    """Time the whole of training tables on `posture_switch` in a physics, by the values of the config of that name.

    Every call is a sweep, from the first episode to the tables on disk. An episode is 40 control steps of two legs for
    each of its decisions. Fewer runs and episodes than the config's are trained where a physics is slow.
    """
    seeds, episodes = size or POSTURES[jax.default_backend()][physics]
    sizes = f"seeds={seeds}", f"episodes={episodes}", "record=1"
    runs = make_plan(load("posture_switch", sizes)).num_runs
    call = train_postures(*sizes, f"task.physics={physics}")
    subject = Subject(call, runs * episodes, runs, 3, unit="episodes/s")
    return time_rates("physics", {f"posture_switch {physics}": subject}, print, "runs")


def train_postures(*overrides: str) -> Callable[[], np.float64]:
    """A call that trains the sweep of `posture_switch` so changed, and counts the steps of all its episodes."""

    def call() -> np.float64:
        with TemporaryDirectory() as folder:
            results = sweep("posture_switch", Path(folder) / "run", overrides=overrides).results
        return np.sum(results["steps"] * results["episode"], dtype=np.float64)

    return call
