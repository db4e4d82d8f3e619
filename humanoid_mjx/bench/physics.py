"""Steps a second of the leg in simulation, under control and without, against MJX and native MuJoCo.

`bench physics`, at 2 ms, followed by the lower body (`ground`) and whole trainings (`postures`):

    chain          this package: `dynamics.rollout`, float32, one program per core on a CPU. The controller's model has
                   the mass of every link 20 % off, one up, the next down: nothing of the plant's can be used again.
    mjx-jax        MJX on the same leg, float32, batched the same way. With the controller, the position and velocity
                   stages run once a step, and their mass matrix and bias make the torque, so its model can be off only
                   by one factor (0.8) for all links: less work than the chain does.
    mjx-jax plain  the same with XLA's default flags, without `compute.XLA_FLAGS`: CPU only
    mujoco         native MuJoCo, float64: `mujoco.rollout`, one thread a core, without a controller only

`bench control`, at 0.5 ms, on the chain; those that end in mjx-jax are the subjects of `bench physics`:

    none               the dynamics alone
    PD                 a servo without a model
    partitioned PD     with the inertia of every joint in its posture, from a model
    computed torque    with the whole dynamics of a model

A step is one of physics, with its control where there is control. On a CPU, MJX runs in a process of its own.
"""

import contextlib
import io
import os
from collections.abc import Callable, Sequence
from functools import cache, partial
from importlib import import_module
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np

from humanoid_mjx import compute
from humanoid_mjx.bench import ground
from humanoid_mjx.bench.measure import (
    CONTROLLED,
    PLAIN,
    Record,
    Subject,
    elsewhere,
    native_rollout,
    native_subject,
    on_all_devices,
    time_rates,
    with_room,
)
from humanoid_mjx.bench.training import postures
from humanoid_mjx.control import Reference, at_rest, pd, servo
from humanoid_mjx.mechanics import dynamics
from humanoid_mjx.robot.chain import Chain
from humanoid_mjx.robot.leg import Leg
from humanoid_mjx.robot.legs import make_mjspec

TIMESTEP, FINE_TIMESTEP = 0.002, 0.0005
"""s. At 2 ms a held torque of the partitioned servo is unstable."""

KP, KD, GOAL = 70.0, 32.0, 0.5
MASS_ERRORS = (0.8, 1.2, 0.8, 1.2, 0.8)
"""The controller's model against the leg, link by link: nothing of the leg's can be used again for it."""

MASS_ERROR = 0.8

SERVO_INERTIA = 1e-4
"""kg m^2, for the gains of a servo without a model: that of the lightest motion, so that its steps are stable."""

UNROLL = {"cpu": 1, "gpu": 4}
"""Steps of the chain in one pass of the loop: a GPU waits for the start of each pass."""

CONTROLLERS = ("none", "PD", "partitioned PD", "computed torque")
ON_MJX = ("none mjx-jax", "computed torque mjx-jax")

MJX_REPEATS = 3

MUJOCO_BATCH = 4096
"""The most legs that native MuJoCo simulates at once: its rate no longer changes, its stored states would."""


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


def run(say: Callable[[str], None]) -> list[Record]:
    """Time the leg, then the lower body on the ground, then training in simulation."""
    return legs(say) + ground.run(say) + postures(say)


def legs(say: Callable[[str], None], setting: Setting | None = None) -> list[Record]:
    """Time the leg in every physics over several numbers of legs."""
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


def control(say: Callable[[str], None], setting: Setting | None = None) -> list[Record]:
    """Time the leg under every controller over several numbers of legs."""
    setting = setting or CONTROL.get(jax.default_backend(), CONTROL["gpu"])
    records: list[Record] = []
    for batch in setting.batches:
        steps = setting.chain_steps
        subjects = {
            name: Subject(chain(batch, steps, name, FINE_TIMESTEP), batch * steps, batch, unit=_unit(name))
            for name in CONTROLLERS
        }
        subjects |= {name: _on_mjx(batch, setting, _unit(name)) for name in ON_MJX}
        found = {one.subject: one for one in time_rates("control", subjects, say, "legs")}
        for name, one in found.items():
            bare = found[ON_MJX[0] if name in ON_MJX else CONTROLLERS[0]]
            if one is not bare:
                say(f"{name}: {1e9 * (1 / one.value - 1 / bare.value):.3g} ns a step for control")
        records += found.values()
    return records


def _unit(name: str) -> str:
    return PLAIN if name.startswith("none") else CONTROLLED


def make_subjects(batch: int, setting: Setting) -> dict[str, Subject]:
    """The subjects of `legs` for a number of legs; those that are controlled end in "with control"."""
    steps = setting.chain_steps
    subjects = {
        "chain with control": Subject(chain(batch, steps, "computed torque"), batch * steps, batch),
        "mjx-jax with control": _on_mjx(batch, setting, CONTROLLED),
        "chain": Subject(chain(batch, steps, "none"), batch * steps, batch, unit=PLAIN),
        "mjx-jax": _on_mjx(batch, setting, PLAIN),
        "mujoco": native_subject(mujoco, batch, MUJOCO_BATCH, setting.mujoco_steps, unit=PLAIN),
    }
    if jax.default_backend() == "cpu":
        call = elsewhere(mjx_jax, batch, setting.mjx_steps, True, plain=True)
        subjects["mjx-jax plain with control"] = Subject(call, batch * setting.mjx_steps, batch, MJX_REPEATS)
    return subjects


def _on_mjx(batch: int, setting: Setting, unit: str) -> Subject:
    call = with_room(mjx_jax, batch, setting.mjx_steps, unit == CONTROLLED)
    return Subject(call, batch * setting.mjx_steps, batch, MJX_REPEATS, unit=unit)


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
    mj: Any = import_module("mujoco")
    model = make_mjspec(Leg.physical(), TIMESTEP).compile()
    model.opt.disableflags |= mj.mjtDisableBit.mjDSBL_CONSTRAINT | mj.mjtDisableBit.mjDSBL_CONTACT
    return model
