"""From a config to what will run: groups of sweep points that share one compiled program, in blocks that fit memory."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from functools import cached_property
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np

from humanoid_mjx.axes import sweep_points
from humanoid_mjx.config import Config
from humanoid_mjx.learners import Learner, make_learner
from humanoid_mjx.spec import InputError
from humanoid_mjx.tasks import make_task


@dataclass(frozen=True)
class Group:
    """Sweep points that differ only in traced values."""

    learner: Learner
    """The learner of the group's first point."""
    points: np.ndarray
    """(num_points,) Numbers of the points in the plan."""
    hyper: Any
    """The traced values: the learner's `Params`, every leaf with a leading axis of num_points."""


@dataclass(frozen=True)
class Block:
    """Runs (pairs of sweep point and seed) that train at once."""

    index: int
    group: Group
    size: int
    """Runs in each of the group's blocks but the last, which may hold fewer."""
    rows: np.ndarray
    """(len(self),) Each run's row in the group's `hyper`."""
    seeds: np.ndarray
    """(len(self),) Each run's seed number."""

    @property
    def points(self) -> np.ndarray:
        return self.group.points[self.rows]

    def __len__(self) -> int:
        return len(self.rows)


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
        return [self._group(indices) for indices in members.values()]

    def _group(self, indices: list[int]) -> Group:
        params = [self.learners[i].params for i in indices]
        hyper = jax.tree.map(lambda *values: _column(values), *params)
        return Group(self.learners[indices[0]], np.array(indices), hyper)

    def block_sizes(self, size: int | None, devices: int, memory: int) -> list[int]:
        """How many runs of each group train at once: `size`, or what `memory` bytes and a CPU's cache hold.

        Raises:
          InputError: not even one run fits.
        """
        return [self._block_size(group, size, devices, memory) for group in self.groups]

    def _block_size(self, group: Group, size: int | None, devices: int, memory: int) -> int:
        runs = len(group.points) * self.config.seeds
        if size is None:
            size = runs_that_fit(group, devices, memory)
        return -(-runs // -(-runs // size))

    def blocks(self, sizes: Sequence[int]) -> list[Block]:
        """All runs, in blocks of the given size for each group."""
        blocks: list[Block] = []
        for group, size in zip(self.groups, sizes, strict=True):
            runs = np.arange(len(group.points) * self.config.seeds)
            for start in range(0, len(runs), size):
                rows, seeds = np.divmod(runs[start : start + size], self.config.seeds)
                blocks.append(Block(len(blocks), group, size, rows, seeds))
        return blocks

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
        return Plan(config, points, [build(config, point) for point in points])
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
    """The config as plain values with every default written out: what `config.yaml` of a run folder holds."""
    learner = build(config, {})
    data = config.model_dump(mode="json", exclude_none=True)
    for part, spec in (("task", learner.task), ("learner", learner)):
        data[part] = {"name": getattr(config, part)["name"]} | spec.model_dump(mode="json")
    return data


def runs_that_fit(group: Group, devices: int, memory: int) -> int:
    """Runs that `memory` bytes hold in training; on a CPU no more than its caches serve well.

    Raises:
      InputError: a single run does not fit.
    """
    per_run = run_bytes(group)
    size = memory // (WORKING_COPIES * per_run)
    if size < 1:
        raise InputError(
            f"one run needs about {WORKING_COPIES * per_run / 2**20:,.0f} MiB and {memory / 2**20:,.0f} MiB are free; "
            "make the task or the learner smaller."
        )
    if jax.default_backend() == "cpu":
        size = min(size, devices * max(1, CPU_CACHE_BYTES // per_run))
    return size


WORKING_COPIES = 4
"""Room that training takes, in copies of its state: the state, its successor, and what a step works on."""

CPU_CACHE_BYTES = 1 << 21
"""Training state per core beyond which a step slows down (measured: about 1,000 agents of `joint_reach`)."""


def run_bytes(group: Group) -> int:
    """Bytes of training state that one run holds."""
    hyper = jax.tree.map(lambda x: jax.ShapeDtypeStruct(x.shape[1:], x.dtype), group.hyper)
    carry = jax.eval_shape(group.learner.init, hyper, jax.eval_shape(lambda: jax.random.key(0)))
    return sum(leaf.size * leaf.dtype.itemsize for leaf in jax.tree.leaves(carry))


def _column(values: tuple) -> np.ndarray:
    array = np.asarray(values)
    return array.astype(jnp.int32 if array.dtype.kind in "bi" else jnp.float32)
