"""The cost of training: the memory that runs take on a device, and so how many train at once; the disk that a run
folder takes."""

import shutil
from collections import Counter
from collections.abc import Sequence
from functools import lru_cache
from pathlib import Path
from typing import Any

import jax
import numpy as np
from jax.extend import core
from rich.filesize import decimal

from humanoid_mjx import compute
from humanoid_mjx.compute import kept
from humanoid_mjx.kernels.primitives import ELEMENTWISE
from humanoid_mjx.runs.folder import disk_used
from humanoid_mjx.spec import InputError
from humanoid_mjx.training.plan import CPU_CACHE_BYTES, Group, Plan
from humanoid_mjx.training.program import SHOWN, advance

MEMORY_SHARE = 0.8
"""The share of a device's free memory, or of a machine's for all its CPU devices together, that training may take."""

OVERHEAD = 48 * 1024
"""Fixed size of a run folder, bytes: names of columns and arrays, the config, the provenance."""

KEPT_TWICE = 2
"""A checkpoint is written beside the one that it replaces."""


def runs_at_once(group: Group, pool_size: int | None = None, width: int | None = None) -> int:
    """Return the number of a group's runs that this process trains at once: `pool_size` a device, or as many as its
    memory holds, on CPUs no more than caches serve well. Raise an InputError if not even one fits."""
    device, devices = jax.local_devices()[0], jax.local_device_count()
    if pool_size:
        return pool_size * devices
    stats = device.memory_stats() or {}  # CPU devices share the memory of the machine
    free = stats["bytes_limit"] - stats["bytes_in_use"] if "bytes_limit" in stats else compute.available_memory()
    per_run = training_bytes(group)
    fit = int(MEMORY_SHARE * free) // per_run
    if width and 1 <= fit < width:
        raise InputError(
            f"chunk: {width} networks side by side need about {width * per_run / 2**20:,.0f} MiB, more "
            f"than {MEMORY_SHARE:.0%} of the {free / 2**20:,.0f} MiB that are free; write --set chunk={fit}."
        )
    if fit < 1:
        raise InputError(
            f"one run needs about {per_run / 2**20:,.0f} MiB, more than {MEMORY_SHARE:.0%} of the "
            f"{free / 2**20:,.0f} MiB that are free; make the task or the learner smaller."
        )
    if device.platform != "cpu":
        return fit * devices
    return min(fit, devices * (width or max(1, CPU_CACHE_BYTES // group.bytes)))


@lru_cache(maxsize=16)
def training_bytes(group: Group) -> int:
    """About what one run takes at the peak of its training: its state before and after, and what works on it."""
    learner = group.one_learner

    def working() -> int:
        program = jax.make_jaxpr(advance)(learner, group.one_run, jax.ShapeDtypeStruct((), np.int32))
        return working_bytes(program.jaxpr)

    return 2 * group.bytes + kept.remembered("bytes", kept.about(learner), working)


ARRANGED = {"broadcast_in_dim", "iota", "reshape", "squeeze"}
FUSED = ELEMENTWISE | ARRANGED | {"cos", "logistic", "pow", "rsqrt", "sin", "tanh"}
"""Primitives that XLA fuses into their consumer: a result that is used once is never in memory."""


def working_bytes(jaxpr: Any) -> int:
    """The most bytes that the values computed in a program hold at once, each until its last use.

    Loops and calls count with their insides; results that XLA fuses into their consumer (`FUSED`) count nothing.
    """
    uses = Counter(var for equation in jaxpr.eqns for var in equation.invars if _is_var(var))
    last_use = {var: len(jaxpr.eqns) for var in jaxpr.outvars if _is_var(var)}
    for place in reversed(range(len(jaxpr.eqns))):
        for var in filter(_is_var, jaxpr.eqns[place].invars):
            last_use.setdefault(var, place)
    held, peak, sizes = 0, 0, {}
    for place, equation in enumerate(jaxpr.eqns):
        kernel = equation.primitive.name == "pallas_call"  # what one computes is in registers
        inside = [] if kernel else [working_bytes(inner) for inner in core.jaxprs_in_params(equation.params)]
        fused = equation.primitive.name in FUSED and uses[equation.outvars[0]] == 1
        new = {var: 0 if fused else var.aval.size * var.aval.dtype.itemsize for var in equation.outvars}
        peak = max(peak, held + max(sum(new.values()), *inside, 0))
        sizes |= {var: size for var, size in new.items() if last_use.get(var, place) > place}
        held += sum(size for var, size in new.items() if var in sizes)
        ended = {var for var in equation.invars if _is_var(var)} & {var for var in sizes if last_use[var] == place}
        held -= sum(sizes.pop(var) for var in ended)
    return peak


def _is_var(atom: object) -> bool:
    return isinstance(atom, core.Var)


def check_disk(place: Path, plan: Plan, slots: Sequence[int]) -> None:
    """Raise an InputError if a run is estimated to take more than the free space of its disk.

    `place`: the run folder, which need not exist; what it holds already is not needed again. `slots`: runs of each
    group that train side by side.
    """
    needed = disk_bytes(plan, slots)
    there = next(path for path in (place.absolute(), *place.absolute().parents) if path.exists())
    free = shutil.disk_usage(there).free + (disk_used(place) if place.is_dir() else 0)
    if needed > free:
        raise InputError(
            f"{place}: the run takes an estimated {decimal(needed)} on disk and {decimal(free)} are free; train "
            "fewer points or seeds, record fewer points of the curves, or choose another disk with out=PATH."
        )


def disk_bytes(plan: Plan, slots: Sequence[int]) -> int:
    """About the most bytes that a run folder takes: policies, curves and tables of all runs, and the checkpoint of
    those that train side by side. Tables are counted as if they were not compressed; figures are not counted."""
    finished = sum(len(group.runs) * finished_bytes(group) for group in plan.groups)
    finished = finished * plan.num_runs // sum(len(group.runs) for group in plan.groups)
    under_way = [group.bytes * count for group, count in zip(plan.groups, slots, strict=True)]
    return OVERHEAD + finished + KEPT_TWICE * max(under_way)


def finished_bytes(group: Group) -> int:
    """About what one finished run takes: its policy, and its curves both by themselves and in the tables."""
    names = group.one_run.record.shape[1]
    if group.learners.evaluations > 1:
        names += len(SHOWN)  # of greedy episodes
    curves = (names + 1) * group.learners.record * np.dtype(np.float32).itemsize  # and the time of each point
    return sum(leaf.size * leaf.dtype.itemsize for leaf in jax.tree.leaves(group.policy)) + 2 * curves
