"""How many runs a device can train at once."""

import jax
import numpy as np
from jax.extend import core

from humanoid_mjx.learners.base import WholeRunLearner
from humanoid_mjx.spec import InputError
from humanoid_mjx.training.plan import Group
from humanoid_mjx.training.program import advance
from humanoid_mjx.types import Device

CPU_CACHE_BYTES = 1 << 21
"""Training state per core beyond which a step slows down (measured: about 1,000 agents of `joint_reach`)."""

HOST_MEMORY = 1 << 31
"""Bytes that training may take on all CPU devices, which report no limit: half of the 4 GB that a sweep should stay
under."""


def runs_that_fit(group: Group, device: Device) -> int:
    """How many runs of a group a device can train at once; on a CPU no more than its cache serves well.

    Raises:
      InputError: not even one.
    """
    per_run, memory = training_bytes(group), _free_memory(device)
    size = memory // per_run
    if size < 1:
        raise InputError(
            f"one run needs about {per_run / 2**20:,.0f} MiB and {memory / 2**20:,.0f} MiB are free; "
            "make the task or the learner smaller."
        )
    return min(size, max(1, CPU_CACHE_BYTES // run_bytes(group))) if device.platform == "cpu" else size


def run_bytes(group: Group) -> int:
    """Bytes of training state that one run holds."""
    return sum(leaf.size * leaf.dtype.itemsize for leaf in jax.tree.leaves(group.one_run))


def training_bytes(group: Group) -> int:
    """Approximate bytes of one run at the peak of its training: its state before and after, and intermediate values."""
    if isinstance(group.learners, WholeRunLearner):
        return 4 * run_bytes(group)
    learner = jax.tree.map(lambda x: jax.ShapeDtypeStruct(x.shape[1:], x.dtype), group.learners)
    program = jax.make_jaxpr(advance)(learner, group.one_run, jax.ShapeDtypeStruct((), np.int32))
    return 2 * run_bytes(group) + working_bytes(program.jaxpr)


def working_bytes(jaxpr: core.Jaxpr) -> int:
    """The most bytes that the values computed in a program hold at once, each until its last use.

    Loops and calls count by their inside. XLA holds less where it computes elementwise operations in one pass.
    """
    last_use = {var: len(jaxpr.eqns) for var in jaxpr.outvars if isinstance(var, core.Var)}
    for place in reversed(range(len(jaxpr.eqns))):
        for var in jaxpr.eqns[place].invars:
            if isinstance(var, core.Var):
                last_use.setdefault(var, place)
    held, peak, sizes = 0, 0, {}
    for place, equation in enumerate(jaxpr.eqns):
        inside = [working_bytes(inner) for inner in core.jaxprs_in_params(equation.params)]
        sizes |= {var: _bytes(var.aval) for var in equation.outvars if last_use.get(var, place) > place}
        new = sum(_bytes(var.aval) for var in equation.outvars)
        peak = max(peak, held + max(new, *inside, 0))
        held += sum(sizes[var] for var in equation.outvars if var in sizes)
        ended = {var for var in equation.invars if _is_var(var)} & {var for var in sizes if last_use[var] == place}
        held -= sum(sizes.pop(var) for var in ended)
    return peak


def _is_var(atom: object) -> bool:
    return isinstance(atom, core.Var)


def _bytes(aval: object) -> int:
    shape, dtype = getattr(aval, "shape", ()), getattr(aval, "dtype", np.dtype(np.float32))
    return int(np.prod(shape)) * dtype.itemsize


def _free_memory(device: Device) -> int:
    """Bytes that training may take on one device."""
    stats = device.memory_stats()
    if stats and "bytes_limit" in stats:
        return (stats["bytes_limit"] - stats["bytes_in_use"]) * 8 // 10
    return HOST_MEMORY // len(jax.local_devices())
