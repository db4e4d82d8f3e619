"""The disk that a run folder takes, known before training begins."""

import shutil
from collections.abc import Sequence
from pathlib import Path

import jax
import numpy as np

from humanoid_mjx.learners.base import WholeRunLearner
from humanoid_mjx.runs.disk import disk_used, in_words
from humanoid_mjx.spec import InputError
from humanoid_mjx.training.memory import run_bytes
from humanoid_mjx.training.plan import Group, Plan
from humanoid_mjx.training.program import measures
from humanoid_mjx.training.whole_runs import MEASURES

OVERHEAD = 48 * 1024
"""Bytes of a folder beside its numbers: names of columns and arrays, the config, the provenance."""

KEPT_TWICE = 2
"""A checkpoint is written beside the one that it replaces."""


def check_disk(place: Path, plan: Plan, slots: Sequence[int]) -> None:
    """Refuse a run that its disk cannot hold.

    Args:
      place: the run folder, which need not exist; what it holds already is not needed again.
      plan: what is to be trained.
      slots: how many runs of each group train side by side.

    Raises:
      InputError: the free space is less than what the run is estimated to take.
    """
    needed = disk_bytes(plan, slots)
    there = next(path for path in (place.absolute(), *place.absolute().parents) if path.exists())
    free = shutil.disk_usage(there).free + (disk_used(place) if place.is_dir() else 0)
    if needed > free:
        raise InputError(
            f"{place}: the run takes an estimated {in_words(needed)} on disk and {in_words(free)} are free; train "
            "fewer points or seeds, record fewer points of the curves, or choose another disk with --out."
        )


def disk_bytes(plan: Plan, slots: Sequence[int]) -> int:
    """About the most bytes that a run folder takes: policies, curves and tables of all runs, and the checkpoint of
    those that train side by side. Tables are counted as if they were not compressed; figures are not counted."""
    finished = sum(len(group.runs) * finished_bytes(group) for group in plan.groups)
    under_way = [run_bytes(group) * count for group, count in zip(plan.groups, slots, strict=True)]
    return OVERHEAD + finished + KEPT_TWICE * max(under_way)


def finished_bytes(group: Group) -> int:
    """About what one finished run takes: its policy, and its curves both by themselves and in the tables."""
    learner = jax.tree.map(lambda x: jax.ShapeDtypeStruct(x.shape[1:], x.dtype), group.learners)
    carry = group.one_run.carry
    policy = jax.eval_shape(lambda learner, carry: learner.policy(carry), learner, carry)
    names = len(measures(learner, carry))
    if isinstance(group.learners, WholeRunLearner):
        names = 2 * len(MEASURES)
    elif group.learners.evaluations > 1:
        names += len(MEASURES)
    curves = (names + 1) * group.learners.record * np.dtype(np.float32).itemsize  # and the time of each point
    return sum(leaf.size * leaf.dtype.itemsize for leaf in jax.tree.leaves(policy)) + 2 * curves
