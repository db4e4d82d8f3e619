"""Policies: the results of training, from a run folder or a file of their own.

A policy file is a numpy archive: `header`, a JSON text with the config of the policy's sweep point, its scores and
where it comes from; and the policy's arrays by their paths. It holds no Python objects.
"""

import json
import sys
from collections.abc import Sequence
from contextlib import suppress
from pathlib import Path
from typing import Annotated, Any, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
import pydantic

from humanoid_mjx.compute import made_by
from humanoid_mjx.config import Config, apply_override, check_overrides, parse
from humanoid_mjx.files import folder, kind_of, meant, names, refusing, whole_file
from humanoid_mjx.learners import LEARNERS, Learner
from humanoid_mjx.mechanics.tree.refusing import faults
from humanoid_mjx.robot import ROBOTS, make_robot
from humanoid_mjx.robot.description import IMU
from humanoid_mjx.runs.archive import HEADER, check_finite, read_archive
from humanoid_mjx.runs.folder import read_config, read_provenance
from humanoid_mjx.runs.ranking import ranked
from humanoid_mjx.runs.tables import WHOLE, finished_runs, kept_runs, scores
from humanoid_mjx.spec import InputError, check_count, check_folder, known, sentence, shown
from humanoid_mjx.tasks import TASKS, name_of
from humanoid_mjx.training.plan import MAX_RUNS, at_point, build, make_plan, points_of, resolved
from humanoid_mjx.training.state import from_arrays, to_arrays

FORMAT = "humanoid_mjx policy, version 1"

UNMODIFIED = "unmodified"
"""The physics of a robot's file as it is."""

OBSERVED = "task.observe", "task.symmetric"
"""Values of tasks that change what a policy observes, but not always how many numbers."""


class _Origin(pydantic.BaseModel):
    """Origin of a policy: `StoredPolicy.origin`."""

    model_config = pydantic.ConfigDict(extra="forbid", strict=True)

    scores: dict[Annotated[str, pydantic.Field(pattern=r"^final\.greedy_\w+$")], float]
    provenance: dict[str, Any]


class _Header(pydantic.BaseModel):
    """The header of a policy file."""

    model_config = pydantic.ConfigDict(extra="forbid", strict=True)

    format: str
    name: str
    point: int = pydantic.Field(ge=0, lt=MAX_RUNS)
    seed: int = pydantic.Field(ge=0, lt=MAX_RUNS)
    config: dict[str, Any]
    origin: _Origin


class StoredPolicy(NamedTuple):
    """The policy of one run of a sweep, from a run folder or a policy file."""

    learner: Learner
    """The learner, with the hyper-parameters of its sweep point as arrays."""
    policy: Any
    point: int
    seed: int
    name: str
    config: Config
    """Config of the policy's sweep point alone."""
    origin: dict[str, Any]
    """`scores` of the run at its end and its `provenance`."""

    @property
    def title(self) -> str:
        """The name, and the task where the name does not say it."""
        task = self.config.task["name"]
        return task if self.name == task else f"{self.name}: {task}"

    def as_json(self) -> dict[str, Any]:
        """Everything but the arrays, as plain values."""
        place = {"name": self.name, "point": self.point, "seed": self.seed}
        return place | {"config": resolved(self.config), "origin": self.origin}


def check_single(learner: Learner) -> None:
    """Raise an InputError if a `jax.vmap` has stacked learners: their length of training has axes."""
    if axes := np.shape(learner.budget):
        one = f"jax.tree.map(lambda x: x[{', '.join('0' * len(axes))}], policy)"
        raise InputError(f"policy: these are policies of shape {axes}; choose one by {one}, or map by jax.vmap.")


def with_config(learner: Learner, policy: Any) -> StoredPolicy:
    """Give a policy that was trained without a config the config of its learner and task.

    Raises:
      InputError: a class that no import path names, or a value that a config cannot have.
    """
    check_single(learner)
    plain = jax.tree.map(_plain, learner)
    data: dict[str, Any] = {"name": name_of(plain.task), "record": plain.record, plain.unit: plain.budget}
    for part, spec, registry in (("task", plain.task, TASKS), ("learner", plain, LEARNERS)):
        path = f"{type(spec).__module__}:{type(spec).__qualname__}"
        data[part] = spec.model_dump() | {"name": {p: name for name, p in registry.items()}.get(path, path)}
        module = sys.modules[type(spec).__module__]
        if path not in registry.values() and (file := getattr(module, "__file__", None)):
            data["modules"] = str(Path(file).resolve().parents[module.__name__.count(".")])
    config = parse(data, data["name"])
    build(config, {})
    return StoredPolicy(learner, policy, 0, 0, config.name, config, {"scores": {}, "provenance": made_by()})


def _plain(x: Any) -> Any:
    """A number as Python has it, a float by its shortest decimals, or a list of numbers."""
    x = np.asarray(x)
    return [_plain(each) for each in x] if x.ndim else float(str(x[()])) if x.dtype.kind == "f" else x.item()


def find_policy(name: Path | str, point: int | None = None, overrides: Sequence[str] = ()) -> StoredPolicy:
    """The best policy of a run folder, or of one point of its sweep; that of a file; the shipped one of this name; or
    none but the servo of the robot of this name or YAML (`evaluation.rest`).

    `overrides`: those of `in_world`; a robot that they name is taken as it is now.

    Raises:
      InputError: there is nothing of the kind, or it cannot be read; `point` is given for what is no run folder.
    """
    check_overrides(overrides)
    if point is not None:
        check_count("point", point, 0)
    if not isinstance(name, (str, Path)):
        raise InputError(f"a policy is named by a run folder, a policy file or a shipped name, got {shown(name)}.")
    name = str(name)
    path, shipped = Path(name), folder("policies") / f"{name}.npz"
    if path.is_dir():
        return policies_of_best(path, point, most=1, overrides=overrides)[0]
    if point is None and (name in ROBOTS or name in names("robots", ".yaml") or kind_of(path) == "robot"):
        return at_rest(name)
    file = path if path.exists() or path.suffix == ".npz" or path.name != name else shipped
    if not file.exists():
        instead = meant(name, "run", "policy") or f"; {known(name, names('policies', '.npz'), 'info')}"
        raise InputError(f"{name}: neither a run folder nor a policy{instead}.")
    if point is not None:
        raise InputError(f"--point: {name} is no run folder, and only a sweep has points.")
    return read_policy(file, overrides)


def at_rest(robot: str) -> StoredPolicy:
    """The policy that holds a robot's home posture by its servo, on the task `stand` without pushes; in native MuJoCo
    where the tree cannot represent the robot.

    `robot`: a name, or the path of a YAML.

    Raises:
      InputError: there is no such robot, or it cannot stand on the ground.
    """
    physics = "mujoco" if faults(make_robot(robot).model, IMU) else "tree"
    task = {"name": "stand", "robot": robot, "push": {"impulse": 0.0}, "physics": physics}
    learner = {"name": f"{__package__}.rest:AtRest"}
    config = parse({"name": Path(robot).stem, "task": task, "learner": learner, "total_steps": 4096}, robot)
    (group,) = make_plan(config).groups
    policy = jax.tree.map(lambda leaf: jnp.ones(leaf.shape, leaf.dtype), group.policy)
    return StoredPolicy(group.learner(), policy, 0, 0, config.name, config, {"scores": {}, "provenance": {}})


def policies_of_best(
    path: Path, point: int | None = None, most: int | None = None, overrides: Sequence[str] = ()
) -> list[StoredPolicy]:
    """The runs of a run folder's best point (`runs.ranking`), or of the point of this number, one for each training
    seed that is finished: all, or so many at most. First comes the most often successful, among equals the quickest or
    that of the highest return.

    Raises:
      InputError: this is no run folder, nothing in it or of the point is finished, or its files are damaged.
    """
    data = _as_now(read_config(path), overrides)
    config = parse(data, str(path / "config.yaml"))
    points, quickest = points_of(config), config.episodes is not None
    arrays = kept_runs(path, (names := ("point", "seed", *(f"curve.{name}" for name in WHOLE), "final.")))
    if not arrays:
        raise InputError(f"{path}: holds no finished run; --resume it first.")
    if point is not None and point not in arrays["point"]:
        raise InputError(f"--point {point}: {path} holds no finished run of it; it has {len(points)}, from 0 on.")
    try:
        if point is None:
            rung = {name: array for name, array in arrays.items() if name in ("point", "rung")}
            point = ranked((), rung | scores(arrays), quickest)[0].point
        arrays = finished_runs(path, (*names, "policy"), point)
        cost = arrays["final.greedy_steps"] if quickest else -arrays["final.greedy_return"]
        order, values = np.lexsort((cost, -arrays["final.greedy_success"])), points[point]
    except LookupError as error:
        raise InputError(f"{path / 'checkpoint'}: what it holds does not fit the config beside it.") from error
    alone = parse(at_point(data, values) | {"seeds": 1}, config.source)
    provenance, (group,) = read_provenance(path), make_plan(alone).groups
    found, like = [], group.policy
    for row in order[arrays["point"][order] == point][:most].tolist():
        final = {name: float(array[row]) for name, array in arrays.items() if name.startswith("final.greedy_")}
        learned = {name: array[row] for name, array in arrays.items() if name.startswith("policy")}
        place, origin = (point, int(arrays["seed"][row])), {"scores": final, "provenance": provenance}
        policy = _policy(like, learned, f"{path}: the run of point {point} with seed {place[1]}")
        found.append(StoredPolicy(group.learner(), policy, *place, path.resolve().name, alone, origin))
    return found


def save_policy(trained: StoredPolicy, path: Path) -> None:
    """Write a policy file.

    Raises:
      InputError: it does not end in .npz, there is no such folder, or it cannot be written.
    """
    if path.suffix != ".npz":
        raise InputError(f"{path}: a policy file must end in .npz; humanoid-mjx export writes .onnx and .c from it.")
    check_folder(path)
    text = np.array(json.dumps({"format": FORMAT} | trained.as_json()))
    with refusing(path), whole_file(path) as temporary, temporary.open("wb") as file:
        np.savez_compressed(file, allow_pickle=False, header=text, **to_arrays(trained.policy, "policy"))


def read_policy(path: Path, overrides: Sequence[str] = ()) -> StoredPolicy:
    """Read a policy file.

    Raises:
      InputError: there is none, it is truncated or of another kind, or what it needs has changed.
    """
    if not path.exists():
        raise InputError(f"{path}: there is no such file.")
    other = meant(str(path), "run", "policy") if kind_of(path) != "policy" else ", or a truncated or damaged one"
    damage = f"this is no policy file{other}"
    text = read_archive(path, ("header",), damage=damage)
    try:
        data = json.loads(str(text["header"]))
        version = data["format"]
    except (LookupError, TypeError, ValueError, RecursionError) as error:
        raise InputError(f"{path}: {damage}.") from error
    if version != FORMAT:
        raise InputError(f"{path}: this is a {version!r}, but {FORMAT!r} is wanted; export it again from its run.")
    try:
        header = _Header(**data)
    except pydantic.ValidationError as error:
        words = sentence(error, "header", _Header).rstrip(".")
        raise InputError(f"{path}: {words}; export it again from its run.") from error
    parsed = parse(_as_now(header.config, overrides), str(path))
    if parsed.sweep:
        raise InputError(f"{path}: its config has a sweep, and a policy has one point.")
    (group,) = make_plan(parsed).groups
    like = group.policy
    most = sum(leaf.size * leaf.dtype.itemsize + HEADER for leaf in (*jax.tree.leaves(like), text["header"]))
    arrays = read_archive(path, most=most, damage=damage)
    policy = _policy(like, arrays, f"{path}: this policy")
    if more := sorted(arrays.keys() - text.keys() - to_arrays(policy, "policy").keys()):
        raise InputError(f"{path}: {more[0]}: a policy has no such array; export it again from its run.")
    origin = header.origin.model_dump()
    return StoredPolicy(group.learner(), policy, header.point, header.seed, header.name, parsed, origin)


def _as_now(config: dict[str, Any], overrides: Sequence[str]) -> dict[str, Any]:
    """The data of a config, without the digest of its robot's files where an override names a robot."""
    task = config.get("task")
    robot = task.get("robot") if isinstance(task, dict) else None
    if isinstance(robot, dict) and any(override.startswith("task.robot=") for override in overrides):
        robot.pop("content", None)
    return config


def in_world(trained: StoredPolicy, physics: str | None, overrides: Sequence[str] = ()) -> StoredPolicy:
    """The same policy in another world: its task simulated by another physics, if one is named, and values of its task
    changed, such as "task.friction=0.5".

    Raises:
      InputError: the task has no choice of physics, or not this one; or what is no value of the task, or one that it
        cannot have, or that changes what the policy observes or chooses from.
    """
    if physics is not None:
        if "physics" not in type(trained.learner.task).model_fields:
            without = "leave --physics and --unmodified out"
            raise InputError(f"the task {trained.config.task['name']} has no choice of physics; {without}.")
        overrides = [f"task.physics={physics}", *overrides]
    if not overrides:
        return trained
    data = {"task": trained.config.task}
    check_overrides(overrides)
    for override in overrides:
        apply_override(data, override)
        key = override.partition("=")[0]
        if not key.startswith("task.") or key == "task.name":
            raise InputError(f"--set {override}: a policy stays as it is; change its task, as task.friction=0.5 does.")
        if key in OBSERVED:
            raise InputError(f"--set {override}: this would change what the policy observes.")
    config = trained.config.model_copy(update=data)
    (group,) = make_plan(config).groups
    learner = group.learner()
    fits = _shapes(group.policy) == _shapes(trained.policy)
    if not fits or learner.env.action_bins != trained.learner.env.action_bins:
        raise InputError(f"--set {' '.join(overrides)}: this would change what the policy observes or chooses from.")
    return trained._replace(config=config, learner=learner)


def in_worlds(
    policies: Sequence[StoredPolicy], worlds: Sequence[str | None], overrides: Sequence[str]
) -> list[StoredPolicy]:
    """Each policy on each of these physics and in a changed world (`in_world`); an unmodified one's name says so."""
    every = [(physics, in_world(trained, physics, overrides)) for trained in policies for physics in worlds]
    return [found._replace(name=found.name + f", {UNMODIFIED}" * (physics == UNMODIFIED)) for physics, found in every]


def played_by(policies: Sequence[StoredPolicy]) -> list[str]:
    """A sentence for each policy that plays in an unmodified file: what moves the robot there."""
    tasks: dict[str, Any] = {each.name: each.learner.task for each in policies}
    own = {name: task for name, task in tasks.items() if getattr(task, "physics", None) == UNMODIFIED}
    return [f"{name}: {task.simulator.words(task.period)}." for name, task in own.items()]


def on_native(trained: StoredPolicy) -> StoredPolicy:
    """The same policy on native MuJoCo, which moves one robot without compiling, as far as its task can."""
    with suppress(InputError):
        return in_world(trained, "mujoco")
    return trained


def on_plane(trained: StoredPolicy) -> StoredPolicy:
    """The same policy on a level plane, which is all that web pages draw."""
    shaped = getattr(trained.learner.task, "terrain", None)
    return in_world(trained, None, ["task.terrain=null"]) if shaped else trained


def _shapes(policy: Any) -> Any:
    return jax.tree.map(lambda leaf: (leaf.shape, str(leaf.dtype)), policy)


def _policy(like: Any, arrays: dict[str, np.ndarray], what: str) -> Any:
    """The policy that arrays hold; `like` has its shapes, and `what` begins an error."""
    check_finite(arrays, what)
    return jax.tree.map(jnp.asarray, from_arrays(like, arrays, "policy", what))
