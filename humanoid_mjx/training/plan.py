"""From a config to what will run: sweep points, in groups that share one compiled program."""

from collections.abc import Mapping
from dataclasses import dataclass
from functools import cached_property
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np

from humanoid_mjx import rng
from humanoid_mjx.axes import sweep_points
from humanoid_mjx.config import Config
from humanoid_mjx.learners import Learner, make_learner
from humanoid_mjx.spec import InputError
from humanoid_mjx.tasks import make_task
from humanoid_mjx.tasks.check import check_task
from humanoid_mjx.types import Device


@dataclass(frozen=True)
class Group:
    """Sweep points that differ only in traced values."""

    learner: Learner
    """The learner of the group's first point."""
    points: np.ndarray
    """(num_points,) Numbers of the points in the plan."""
    hyper: Any
    """The traced values: the learner's `Params`, every leaf with a leading axis of num_points."""
    seeds: int
    """Runs of each point."""

    @property
    def runs(self) -> np.ndarray:
        """(num_points * seeds,) The group's runs, in order. A run is a point with a seed: point * seeds + seed."""
        return (self.points[:, None] * self.seeds + np.arange(self.seeds)).reshape(-1)

    @cached_property
    def one_run(self) -> Any:
        """The shapes of one run's training state."""
        hyper = jax.tree.map(lambda x: jax.ShapeDtypeStruct(x.shape[1:], x.dtype), self.hyper)
        return jax.eval_shape(self.learner.init, hyper, jax.eval_shape(lambda: rng.key(0)))

    def locate(self, runs: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """The row in `hyper` and the seed number of each run."""
        points, seeds = np.divmod(runs, self.seeds)
        return np.searchsorted(self.points, points), seeds


@dataclass(frozen=True)
class Plan:
    """All that a config asks for."""

    config: Config
    points: list[dict[str, Any]]
    """The swept values of each point, by dotted name."""
    learners: list[Learner]
    """The learner of each point."""

    @property
    def num_runs(self) -> int:
        return len(self.points) * self.config.seeds

    @cached_property
    def groups(self) -> list[Group]:
        members: dict[Learner, list[int]] = {}
        for index, learner in enumerate(self.learners):
            members.setdefault(learner.structure(), []).append(index)
        groups: list[Group] = []
        for indices in members.values():
            hyper = jax.tree.map(lambda *values: _column(values), *(self.learners[i].params for i in indices))
            points = np.array(indices, np.int64)
            groups.append(Group(self.learners[indices[0]], points, hyper, self.config.seeds))
        return groups

    def table(self) -> dict[str, list[Any]]:
        """The hyper-parameters as columns: every scalar of task and learner by dotted name, an entry per point."""
        columns: dict[str, list[Any]] = {}
        for learner in self.learners:
            for part, spec in (("task", learner.task), ("learner", learner)):
                for name in type(spec).model_fields:
                    value = getattr(spec, name)
                    if isinstance(value, (bool, int, float, str)) and name not in ("episodes", "record"):
                        columns.setdefault(f"{part}.{name}", []).append(value)
        return {name: values for name, values in columns.items() if len(values) == len(self.learners)}


def make_plan(config: Config) -> Plan:
    """Give a config its meaning.

    Raises:
      InputError: a task, learner or sweep that the config asks for cannot be.
    """
    try:
        build(config, {})
        points = sweep_points(config.sweep, config.seed) if config.sweep else [{}]
        plan = Plan(config, points, [build(config, point) for point in points])
        for group in plan.groups:
            check_task(group.learner.task)
        return plan
    except InputError as error:
        raise InputError(f"{config.source}: {error}") from error


def build(config: Config, point: Mapping[str, Any]) -> Learner:
    """The learner, with its task, of one sweep point."""
    parts = {"task": dict(config.task), "learner": dict(config.learner)}
    for key, value in point.items():
        part, _, name = key.partition(".")
        parts[part][name] = value
    task = make_task(parts["task"].pop("name"), **parts["task"])
    name = parts["learner"].pop("name")
    return make_learner(name, task, episodes=config.episodes, record=config.record, **parts["learner"])


def resolved(config: Config) -> dict[str, Any]:
    """The config as plain values with defaults written out: what `config.yaml` of a run folder holds.

    A value that follows from others (the start and goal of a joint) stays out unless it was written.
    """
    learner = build(config, {})
    data = config.model_dump(mode="json", exclude_none=True)
    for part, spec in (("task", learner.task), ("learner", learner)):
        written: dict[str, Any] = getattr(config, part)
        fields = type(spec).model_fields
        values = spec.model_dump(mode="json")
        keep = {name: v for name, v in values.items() if name in written or not fields[name].is_required()}
        data[part] = {"name": written["name"]} | keep
    return data


def runs_that_fit(group: Group, device: Device) -> int:
    """How many runs of a group a device can train at once; a CPU no more than its cache serves well.

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


CPU_CACHE_BYTES = 1 << 21
"""Training state per core beyond which a step slows down (measured: about 1,000 agents of `joint_reach`)."""

HOST_MEMORY = 1 << 31
"""Bytes that training may take on all CPU devices, which report no limit: half of the 4 GB a sweep is to stay under."""


def _free_memory(device: Device) -> int:
    """Bytes that training may take on one device."""
    stats = device.memory_stats()
    if stats and "bytes_limit" in stats:
        return (stats["bytes_limit"] - stats["bytes_in_use"]) * 8 // 10
    return HOST_MEMORY // len(jax.local_devices())


def run_bytes(group: Group) -> int:
    """Bytes of training state that one run holds."""
    return sum(leaf.size * leaf.dtype.itemsize for leaf in jax.tree.leaves(group.one_run))


def training_bytes(group: Group) -> int:
    """About what one run takes at the peak of its training: its state, and what works on it."""
    state = run_bytes(group)
    return state + group.learner.working_bytes(state)


def _column(values: tuple) -> np.ndarray:
    array = np.asarray(values)
    return array.astype(jnp.int32 if array.dtype.kind in "bi" else jnp.float32)
