"""The plan of a sweep: its points, in groups that share one compiled program."""

from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from functools import cached_property
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Int

from humanoid_mjx import compute
from humanoid_mjx.compute import kept, rng
from humanoid_mjx.compute.ways import ways
from humanoid_mjx.config import Config, set_below
from humanoid_mjx.config.axes import sweep_points
from humanoid_mjx.learners import Learner, make_learner
from humanoid_mjx.spec import InputError, Spec, modules_in
from humanoid_mjx.tasks import make_task
from humanoid_mjx.tasks.check import check_task
from humanoid_mjx.training.program import Training, begin, check_learner
from humanoid_mjx.user_code import in_words

MAX_RUNS = 10_000_000
"""The most runs of a sweep: points times seeds."""

TABLES = 160
"""Tables that a CPU core trains side by side at 50 million steps/s; 5 train at 3 million."""

CPU_CACHE_BYTES = 1 << 21
"""Training state per core beyond which a step slows down (measured: about 1,000 agents of `joint_reach`)."""


class Rung(NamedTuple):
    """A stage of a sweep in mode halving (K. Jamieson and A. Talwalkar, 2016): the best points of the rung before train
    anew, with a greater budget. A sweep in another mode has one rung."""

    budget: int
    """Length of each run's training, in `unit`s."""
    points: int
    """Number of points that train."""


def _first_policy(learner: Learner) -> Any:
    return learner.policy(learner.init(rng.key(0)))


@dataclass(frozen=True, eq=False)
class Group:
    """Sweep points whose learners share one structure, and so one compiled program."""

    learners: Learner
    """The points' learners as one, for each rung: every leaf, a traced value, has a leading axis as `points` has."""
    points: np.ndarray
    """(rungs * num_points,) Numbers of the points at each rung: rung * points of the plan + point."""
    seeds: int
    """Runs of each point at a rung."""
    rungs: int = 1

    @property
    def runs(self) -> np.ndarray:
        """(rungs * num_points * seeds,) The group's runs, in order. A run is a point at a rung with a seed:
        (rung * points of the plan + point) * seeds + seed."""
        return (self.points[:, None] * self.seeds + np.arange(self.seeds)).reshape(-1)

    @property
    def first_runs(self) -> np.ndarray:
        """(num_points * seeds,) The runs of the first rung, where all points train."""
        return self.runs[: len(self.points) // self.rungs * self.seeds]

    @cached_property
    def one_run(self) -> Training:
        """The shapes of one run's training state."""
        learner = self.one_learner
        key = jax.eval_shape(lambda: rng.key(0))
        return kept.remembered("run", kept.about(learner), lambda: jax.eval_shape(begin, learner, key))

    @property
    def bytes(self) -> int:
        """Bytes of training state that one run holds."""
        return sum(leaf.size * leaf.dtype.itemsize for leaf in jax.tree.leaves(self.one_run))

    @property
    def one_learner(self) -> Learner:
        """The shapes of one of the learners."""
        return jax.tree.map(lambda x: jax.ShapeDtypeStruct(x.shape[1:], x.dtype), self.learners)

    @property
    def policy(self) -> Any:
        """The shapes of what one run learns. `one_run` has them, too, but traces a step of training: seconds."""
        return jax.eval_shape(_first_policy, self.one_learner)  # which jax traces once for all groups of a structure

    def learner(self, row: int = 0) -> Learner:
        """The learner of one of the points, its traced values as arrays."""
        return jax.tree.map(lambda leaf: jnp.asarray(leaf[row]), self.learners)


@dataclass(frozen=True)
class Plan:
    """Everything that a config asks for."""

    config: Config
    points: list[dict[str, Any]]
    """The swept values of each point, by dotted name."""
    learners: list[Learner]
    """The learner of each point."""

    @property
    def num_runs(self) -> int:
        """Number of runs: one for each point that trains at a rung, and each seed."""
        return sum(rung.points for rung in self.rungs) * self.config.seeds

    @cached_property
    def rungs(self) -> list[Rung]:
        """The rungs, the last of which has the whole budget.

        Raises:
          InputError: too few points, or too small a budget, for so many rungs.
        """
        points, factors = len(self.points), self.config.sweep.factors if self.config.sweep else [1]
        most, least = factors[-1], max(learner.update_steps for learner in self.learners)
        if most > 1 and (points < most or self.budget < most * least):
            raise InputError(
                f"sweep.rungs: {len(factors)} rungs with eta {factors[1]} need {most:,} points and {most * least:,} "
                f"{self.unit}s, and the sweep has {points:,} and {self.budget:,}; take fewer rungs."
            )
        return [Rung(self.budget * on // most, points // on) for on in factors]

    @property
    def work(self) -> float:
        """The training of all rungs, in points that train to the end."""
        return sum(rung.points * rung.budget for rung in self.rungs) / self.budget

    @cached_property
    def groups(self) -> list[Group]:
        """The points whose learners have one structure and so share compiled programs."""
        members: dict[Any, list[int]] = {}
        for index, learner in enumerate(self.learners):
            members.setdefault(jax.tree.structure(learner), []).append(index)
        groups: list[Group] = []
        for indices in members.values():
            learners = jax.tree.map(lambda *values: _column(values), *(self.learners[i] for i in indices))
            if (count := len(self.rungs)) > 1:
                learners = jax.tree.map(lambda leaf: np.concatenate([leaf] * count), learners)
                budgets = np.repeat(np.array([rung.budget for rung in self.rungs], np.int32), len(indices))
                learners = learners.replace(**{learners.unit: budgets})
            points = np.arange(count)[:, None] * len(self.points) + np.array(indices, np.int64)
            groups.append(Group(learners, points.reshape(-1), self.config.seeds, count))
        return groups

    @cached_property
    def chunk(self) -> int:
        """The most runs of a chunk: `config.chunk`, by default one that is wide enough to be fast.

        Tables: `TABLES` or a 64th of the runs, whichever is more. Networks: as many as the cache of a CPU core holds,
        and at most a quarter of the runs.
        """
        if self.config.chunk:
            return self.config.chunk
        if self.learners[0].program == "tabular":
            return min(max(TABLES, -(-self.num_runs // 64)), self.num_runs)
        return max(1, min(CPU_CACHE_BYTES // self.groups[0].bytes, -(-self.num_runs // 4)))

    def width(self, group: Group) -> int | None:
        """Return how many runs train side by side on each device, where another number would change bits that are
        promised: those of networks, on a CPU. None where memory and speed decide."""
        fixed = ways().width_rounds and group.learners.program != "tabular"
        return min(self.chunk, len(group.first_runs)) if fixed else None

    def resolved(self) -> dict[str, Any]:
        """The config as plain values with defaults and `chunk` written out, as `config.yaml` of a run folder has it."""
        return resolved(self.config) | {"chunk": self.chunk}

    @property
    def budget(self) -> int:
        """Length of each run's training, in `unit`s."""
        return self.learners[0].budget

    @property
    def unit(self) -> str:
        """Unit of the length of training: `episode` or `step`."""
        return "step" if self.learners[0].unit == "total_steps" else "episode"

    @cached_property
    def places(self) -> Int[np.ndarray, "rungs record"]:
        """The count in `unit`s at each record point of a run, by its rung."""
        record, sizes = self.config.record, [learner.update_steps for learner in self.learners]
        budgets = np.array([rung.budget for rung in self.rungs])
        places = (np.arange(1, record + 1) * budgets[:, None] - record // 2 - 1) // record + 1
        ends = np.min([-(-budgets // size) * size for size in sizes], axis=0)  # the last update may end beyond a budget
        return np.concatenate([places[:, :-1], ends[:, None]], axis=1)

    def table(self) -> dict[str, list[Any]]:
        """The hyper-parameters as columns: every scalar of task and learner by dotted name, an entry per point."""
        rows = [dict([*_scalars(each.task, "task"), *_scalars(each, "learner")]) for each in self.learners]
        return {name: [row[name] for row in rows] for name in rows[0] if all(name in row for row in rows)}


def _scalars(spec: Spec, prefix: str) -> Iterator[tuple[str, Any]]:
    """The scalars that a config may write in a Spec and the Specs that it holds, by dotted name."""
    for name, field in type(spec).model_fields.items():
        value = getattr(spec, name)
        if not field.exclude and isinstance(value, Spec):
            yield from _scalars(value, f"{prefix}.{name}")
        elif not field.exclude and isinstance(value, (bool, int, float, str)):
            yield f"{prefix}.{name}", value


def points_of(config: Config) -> list[dict[str, Any]]:
    """The swept values of each point, by dotted name; an InputError where the sweep cannot be."""
    try:
        return sweep_points(config.sweep, config.seed) if config.sweep else [{}]
    except InputError as error:
        raise InputError(f"{config.source}: {error}") from error


def make_plan(config: Config) -> Plan:
    """Return the plan of a config; raise an InputError if a task, learner or sweep that it asks for cannot be."""
    if "mjx-jax" in config.physics:
        compute.make_room()
    points = points_of(config)
    try:
        build(config, {})
        if len(points) * config.seeds > MAX_RUNS:
            raise InputError(f"{len(points):,} points x {config.seeds:,} seeds are more than {MAX_RUNS:,} runs.")
        plan = Plan(config, points, [build(config, point) for point in points])
        for group in plan.groups:
            check_task((learner := plan.learners[group.points[0]]).task)
            check_learner(learner)
        return plan
    except InputError as error:
        raise InputError(f"{config.source}: {error}") from error
    except Exception as error:
        if not any(":" in part["name"] for part in (config.task, config.learner)):
            raise
        raise InputError(f"{config.source}: a module that it names cannot be used: {in_words(error)}.") from error


def build(config: Config, point: Mapping[str, Any]) -> Learner:
    """The learner, with its task, of one sweep point.

    Raises:
      InputError: an unknown task, learner or key, a value out of range, or a budget in the wrong unit.
    """
    parts = at_point({"task": dict(config.task), "learner": dict(config.learner)}, point)
    name = parts["learner"].pop("name")
    given = {"episodes": config.episodes, "total_steps": config.total_steps}
    budget = {key: value for key, value in given.items() if value is not None}
    with modules_in(config.modules):
        task = make_task(parts["task"].pop("name"), **parts["task"])
        return make_learner(name, task, record=config.record, **budget, **parts["learner"])


def at_point(config: Mapping[str, Any], values: Mapping[str, Any]) -> dict[str, Any]:
    """A config as plain values, at the point of its sweep with these values by dotted key."""
    alone = {key: value for key, value in config.items() if key not in ("sweep", "then")}
    for key, value in values.items():
        set_below(alone, key.split("."), value, f"sweep.axes.{key}")
    return alone


def resolved(config: Config) -> dict[str, Any]:
    """The config as plain values with defaults written out.

    A value that follows from others (the start and goal of a joint) stays out unless it was written.
    """
    learner = build(config, {})
    data = config.model_dump(mode="json", exclude_none=True) | {learner.unit: learner.budget}
    for part, spec in (("task", learner.task), ("learner", learner)):
        written: dict[str, Any] = getattr(config, part)
        fields = type(spec).model_fields
        values = spec.model_dump(mode="json")
        keep = {name: v for name, v in values.items() if name in written or not fields[name].is_required()}
        data[part] = {"name": written["name"]} | keep
    return data


def _column(values: tuple) -> np.ndarray:
    array = np.asarray(values)
    return array.astype(jnp.int32 if array.dtype.kind in "bi" else jnp.float32)
