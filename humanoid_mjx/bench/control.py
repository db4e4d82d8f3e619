"""Control steps a second of the leg at 0.5 ms under each controller, and what a step of control costs.

    none               the dynamics alone
    PD                 a servo without a model
    partitioned PD     with the inertia of every joint in its posture, from a model
    computed torque    with the whole dynamics of a model

The model has the mass of every link 20 % off, one up, the next down. These run on the chain. Those that end in mjx-jax
run on MJX, which takes mass matrix and bias from its own stages, off by one factor. All float32, one program per core
on a CPU; every step of physics is one of control.
"""

from collections.abc import Callable, Sequence
from typing import NamedTuple

import jax

from humanoid_mjx.bench.elsewhere import with_room
from humanoid_mjx.bench.legs import chain
from humanoid_mjx.bench.measure import CONTROLLED, PLAIN, Record, Subject, time_rates
from humanoid_mjx.bench.physics import MJX_REPEATS, mjx_jax

TIMESTEP = 0.0005
"""s: at 2 ms a held torque of the partitioned servo is unstable."""

CONTROLLERS = ("none", "PD", "partitioned PD", "computed torque")
ON_MJX = ("none mjx-jax", "computed torque mjx-jax")


class Setting(NamedTuple):
    """How much is timed: the numbers of legs, and steps in a call."""

    batches: Sequence[int]
    steps: int
    mjx_steps: int


SETTINGS = {"cpu": Setting((1024, 8192), 500, 10), "gpu": Setting((32_768, 1_048_576), 500, 50)}


def run(say: Callable[[str], None], setting: Setting | None = None) -> list[Record]:
    """Time all controllers over several numbers of legs."""
    setting = setting or SETTINGS.get(jax.default_backend(), SETTINGS["gpu"])
    records: list[Record] = []
    for batch in setting.batches:
        work, mjx_work = batch * setting.steps, batch * setting.mjx_steps
        subjects = {
            name: Subject(chain(batch, setting.steps, name, TIMESTEP), work, batch, unit=_unit(name))
            for name in CONTROLLERS
        }
        for name in ON_MJX:
            call = with_room(mjx_jax, batch, setting.mjx_steps, not name.startswith("none"))
            subjects[name] = Subject(call, mjx_work, batch, MJX_REPEATS, unit=_unit(name))
        found = {one.subject: one for one in time_rates("control", subjects, say, "legs")}
        for name, one in found.items():
            bare = found[ON_MJX[0] if name in ON_MJX else CONTROLLERS[0]]
            if one is not bare:
                say(f"{name}: {1e9 * (1 / one.value - 1 / bare.value):.3g} ns a step for control")
        records += found.values()
    return records


def _unit(name: str) -> str:
    return PLAIN if name.startswith("none") else CONTROLLED
