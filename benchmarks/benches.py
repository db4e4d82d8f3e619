"""Benchmarks of `humanoid-mjx bench`: functions `(say) -> list[Record]`, whose subjects are timed in turn.

The package's own subjects are in `tabular.py`, `leg_physics.py` and `ground_physics.py`, those of others in
`opponents.py`; `trainings.py` and `startup.py` hold a benchmark each.
"""

from collections.abc import Callable
from itertools import product

import ground_physics as ground
import jax
import leg_physics as leg
import opponents
import tabular
from timing import CONTROLLED, PLAIN, Record, Subject, time_rates

from humanoid_mjx.training.programs import why_no_kernel


def tables(say: Callable[[str], None]) -> list[Record]:
    """Time all subjects over several numbers of agents."""
    records: list[Record] = []
    subjects = dict(tabular.SUBJECTS)
    if why := why_no_kernel(tabular.own_learner()):
        say(f"fused: not measured, for {why}")
        del subjects["fused"]
    for batch in tabular.BATCHES.get(jax.default_backend(), tabular.BATCHES["gpu"]):
        records += tabular.time_trainings(say, batch, subjects | opponents.tables(say, first=not records))
    return records


def physics(say: Callable[[str], None]) -> list[Record]:
    """Time the leg, then the lower body on the ground, then training in simulation."""
    return legs(say) + bodies(say) + opponents.postures(say)


def legs(say: Callable[[str], None], setting: leg.Setting | None = None) -> list[Record]:
    """Time the leg in every physics over several numbers of legs."""
    setting = setting or leg.SETTINGS.get(jax.default_backend(), leg.SETTINGS["gpu"])
    records: list[Record] = []
    for batch in setting.batches:
        subjects = legs_of(batch, setting)
        found = time_rates("physics", subjects, say, "legs")
        ours, *others = zip(subjects, found, strict=True)
        words = (f"{ours[1].value / other.value:.1f} x {name}" for name, other in others)
        say(f"{ours[0]}: {', '.join(words)}")
        records += found
    return records


def legs_of(batch: int, setting: leg.Setting) -> dict[str, Subject]:
    """The subjects of `legs` for a number of legs; those that are controlled end in "with control"."""
    steps = setting.chain_steps
    subjects = {
        "chain with control": Subject(leg.chain(batch, steps, "computed torque"), batch * steps, batch),
        "chain": Subject(leg.chain(batch, steps, "none"), batch * steps, batch, unit=PLAIN),
    }
    return subjects | opponents.legs(batch, setting)


def control(say: Callable[[str], None], setting: leg.Setting | None = None) -> list[Record]:
    """Time the leg under every controller over several numbers of legs."""
    setting = setting or leg.CONTROL.get(jax.default_backend(), leg.CONTROL["gpu"])
    records: list[Record] = []
    for batch in setting.batches:
        steps = setting.chain_steps
        calls = {name: leg.chain(batch, steps, name, leg.FINE_TIMESTEP) for name in leg.CONTROLLERS}
        units = {"none": PLAIN}
        subjects = {
            name: Subject(call, batch * steps, batch, unit=units.get(name, CONTROLLED)) for name, call in calls.items()
        }
        subjects |= opponents.controlled(batch, setting)
        found = {one.subject: one for one in time_rates("control", subjects, say, "legs")}
        for name, one in found.items():
            bare = found["none mjx-jax" if name.endswith("mjx-jax") else "none"]
            if one is not bare:
                say(f"{name}: {1e9 * (1 / one.value - 1 / bare.value):.3g} ns a step for control")
        records += found.values()
    return records


def bodies(say: Callable[[str], None], setting: ground.Setting | None = None) -> list[Record]:
    """Time every physics that is installed over several numbers of bodies, calm and moving."""
    setting = setting or ground.SETTINGS.get(jax.default_backend(), ground.SETTINGS["gpu"])
    records: list[Record] = []
    for batch, moving in product(setting.batches, (False, True)):
        subjects: dict[str, Subject] = {}
        for name, steps in setting.steps.items():
            if name == "tree":
                block = ground.MOVING_BLOCK if moving else ground.BLOCK
                call = ground.compiled(name, *ground.states_of(batch, moving), steps, block)
                subject = Subject(call, batch * steps, batch, ground.REPEATS)
            else:
                subject = opponents.on_ground(name, batch, moving, steps)
            if subject is not None:
                subjects[f"{name} ground" + " moving" * moving] = subject
        records += time_rates("physics", subjects, say, "bodies")
    return records
