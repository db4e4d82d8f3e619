"""Config files: task, learner, sweep and length of training. Unknown keys and wrong types are errors."""

import hashlib
import json
import re
import sys
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import pydantic
import yaml

from humanoid_mjx.config.axes import Sweep
from humanoid_mjx.files import find_config, folder, read_text
from humanoid_mjx.spec import ELSEWHERE, InputError, sentence, shown

ELSEWHERE_AT_TOP = ("episodes", "learner", "max_episode_steps", "model", "seeds", "sweep", "task", "total_steps")

BELOW = {
    **{key: f"sweep.{key}" for key in ("axes", "mode", "points")},
    **{name: f"learner.{keys[0]}" for name, keys in ELSEWHERE.items() if keys[0] not in ELSEWHERE_AT_TOP},
    **{key: f"learner.{key}" for key in ("discount", "epsilon", "epsilon_decay", "epsilon_min", "learning_rate")},
    **{key: f"learner.{key}" for key in ("envs", "rollout", "start_from", "trace_decay", "weight_averaging", "width")},
    **{key: f"task.{key}" for key in ("control", "max_episode_steps", "physics", "rewards", "robot", "states")},
}
"""Keys that are wrong at the top level, and their right place."""

TOP_LEVEL = ("episodes", "total_steps", "record", "task")
"""Fields of a learner that a config sets at the top level."""


CHANGES = ("task", "learner", "episodes", "total_steps", "record")
"""Keys that `then` may hold."""


class Config(pydantic.BaseModel):
    """A config: one training run or one sweep. `training.plan` expands it."""

    model_config = pydantic.ConfigDict(frozen=True, extra="forbid", strict=True, allow_inf_nan=False)

    name: str = pydantic.Field(
        pattern=r"^[A-Za-z0-9][A-Za-z0-9._-]{0,199}$",
        description="at most 200 letters, digits and . _ -, the first a letter or digit",
    )
    task: dict[str, Any]
    learner: dict[str, Any]
    sweep: Sweep | None = None
    seeds: int = pydantic.Field(1, ge=1, le=1_000_000)
    seed: int = pydantic.Field(0, ge=0, lt=2**32)
    episodes: int | None = pydantic.Field(None, ge=1, le=1_000_000_000, description="for learners that count episodes")
    total_steps: int | None = pydantic.Field(
        None, ge=1, le=2_000_000_000, description="for learners that count control steps of all environments"
    )
    record: int = pydantic.Field(100, ge=1, le=10_000)
    chunk: int | None = pydantic.Field(
        None, ge=1, le=10_000_000, description="runs that a worker of `--ray` or a job of `--slurm` gets at once"
    )
    then: dict[str, Any] | None = pydantic.Field(
        None, description="keys of task, learner and budget that change when all runs have trained, and train on"
    )
    modules: str | None = pydantic.Field(
        None, description="folder of modules that import paths name, by default that of the config"
    )

    _source: str = pydantic.PrivateAttr("config")

    @property
    def source(self) -> str:
        """Origin of the config, used in messages."""
        return self._source

    def later(self, run: Path | str) -> "Config | None":
        """Return the config of the training that goes on from this one's run folder in the world of `then`."""
        if self.then is None:
            return None
        data = _changed(self.model_dump(mode="json", exclude_none=True, exclude={"then"}), self.then)
        data["learner"]["start_from"] = str(run)
        if isinstance(budget := data.get("episodes", data.get("total_steps")), int) and "record" not in self.then:
            data["record"] = max(1, min(self.record, budget))
        return parse(data, f"{self.source}: then")

    @property
    def physics(self) -> set[Any]:
        """Physics that the task names at any point of the sweep; empty where it names none."""
        swept = self.sweep.axes.get("task.physics") if self.sweep else None
        return set(map(str, swept or filter(None, [self.task.get("physics")])))

    @pydantic.model_validator(mode="before")
    @classmethod
    def _short_runs_record_less(cls, data: Any) -> Any:
        budget = (data.get("episodes") or data.get("total_steps")) if isinstance(data, dict) else None
        return {"record": budget} | data if isinstance(budget, int) and 1 <= budget < 100 else data

    @pydantic.model_validator(mode="after")
    def _keys_fit_together(self) -> "Config":
        for part in ("task", "learner"):
            if "name" not in getattr(self, part):
                raise ValueError(f"{part}.name is required")
            if not isinstance(name := getattr(self, part)["name"], str):
                raise ValueError(f"{part}.name must be a string, got {shown(name)}")
        for key in TOP_LEVEL:
            if key in self.learner:
                raise ValueError(f"learner.{key}: unknown key; {key} stands at the top level")
        if self.then is not None and (odd := sorted(self.then.keys() - {*CHANGES})):
            raise ValueError(f"then.{odd[0]}: unknown key; what may change is {', '.join(CHANGES)}")
        axes, learner = self.sweep.axes if self.sweep else {}, (self.then or {}).get("learner")
        again = isinstance(learner, dict) and "start_from" in learner
        if again or (self.then is not None and "learner.start_from" in axes):
            raise ValueError("then: goes on from the first training; leave learner.start_from out here and there")
        for axis in axes:
            if above := [other for other in axes if axis.startswith(f"{other}.")]:
                raise ValueError(f"sweep.axes.{axis}: values of the axis {above[0]} replace it; leave one of them out")
            if self.then and _holds(self.then, axis.split(".")):
                raise ValueError(f"then.{axis}: is an axis of the sweep; leave it out here or there")
            if not re.fullmatch(r"(task|learner)(\.\w+)+", axis) or re.fullmatch(r"\w+\.name", axis):
                raise ValueError(
                    f"sweep.axes.{axis}: an axis is the dotted name of a value of task or learner, "
                    "such as learner.epsilon"
                )
            if axis.split(".")[0] == "learner" and (key := axis.split(".")[1]) in TOP_LEVEL:
                raise ValueError(f"sweep.axes.{axis}: {key} stands at the top level and cannot be swept there")
        return self


def _changed(data: dict[str, Any], changes: dict[str, Any]) -> dict[str, Any]:
    """`data` with other values; mappings are changed key by key."""
    for key, value in changes.items():
        inside = data.get(key)
        data = data | {key: _changed(inside, value) if isinstance(inside, dict) and isinstance(value, dict) else value}
    return data


def _holds(data: Any, keys: Sequence[str]) -> bool:
    """Return whether nested mappings hold a dotted key, or a value in the place of one of its parents."""
    return not keys or not isinstance(data, dict) or (keys[0] in data and _holds(data[keys[0]], keys[1:]))


def load(config: str | Path, overrides: Sequence[str] = ()) -> Config:
    """Read a config from a path, or a shipped one by its name, and apply overrides such as "learner.epsilon=0.1".

    An override of a swept key also removes its axis from the sweep.

    Raises:
      InputError: no such config, not YAML, or a key or value that cannot be used, in one sentence.
    """
    path = find_config(str(config))
    data = parse_yaml(read_text(path), str(config))
    if not isinstance(data, dict):
        raise InputError(f"{config}: a config is a mapping of keys such as name, task and learner.")
    check_overrides(overrides)
    for override in overrides:
        apply_override(data, override)
        _sweep_no_more(data, override.partition("=")[0])
    if re.search(r"\w:\w|\.ya?ml\b", str(data)):  # an import path or a robot: the run remembers where they are
        beside = Path() if path.parent == folder("configs") else path.parent
        data["modules"] = str((beside / str(data.get("modules", ""))).resolve())
    return parse(data, str(config))


def _sweep_no_more(data: dict[str, Any], key: str) -> None:
    """Remove a key from the axes of the sweep; remove the sweep if no axis is left."""
    axes = sweep.get("axes") if isinstance(sweep := data.get("sweep"), dict) else None
    if isinstance(axes, dict) and key in axes:
        del axes[key]
        data["sweep"] = sweep if axes else None


def _plain(value: Any) -> Any:
    """A value that JSON does not know, such as a number or an array of numpy, as one that it knows."""
    return value.tolist() if hasattr(value, "tolist") else [*value] if isinstance(value, range) else str(value)


def parse(data: dict[str, Any], source: str = "config") -> Config:
    """Build a config from plain values or those of numpy. `source` names their origin in messages.

    Raises:
      InputError: a key or value that cannot be used.
    """
    if odd := [key for key in data if not isinstance(key, str)]:
        raise InputError(f"{source}: a key must be a string, got {odd[0]!r}.")
    if odd := [key for key in data if key in BELOW]:
        raise InputError(f"{source}: {odd[0]}: this key does not stand at the top level; write {BELOW[odd[0]]}.")
    try:
        config = Config(**json.loads(json.dumps(data, default=_plain)))
    except pydantic.ValidationError as error:
        raise InputError(f"{source}: {sentence(error, '', Config)}") from error
    config._source = source
    return config


def check_overrides(overrides: Sequence[str]) -> None:
    """Raise an InputError if these are no overrides, or one undoes an earlier one; the same one again undoes none."""
    if isinstance(overrides, str) or not isinstance(overrides, Sequence):
        raise InputError(f'overrides must be a list such as ["learner.epsilon=0.1"], got {shown(overrides)}.')
    if odd := [override for override in overrides if not isinstance(override, str)]:
        raise InputError(f'an override must be a string such as "learner.epsilon=0.1", got {shown(odd[0])}.')
    earlier: list[str] = []
    for override in dict.fromkeys(overrides):
        key = override.partition("=")[0]
        if any(f"{other}.".startswith(f"{key}.") for other in earlier):
            raise InputError(f"--set {override}: {key} is set twice; leave one of them out.")
        earlier += [key, key.removeprefix("sweep.axes.")]  # a value takes its axis away


def apply_override(data: dict[str, Any], override: str) -> None:
    """Set one dotted key of `data`, as `--set key=value` does. The value is YAML.

    Raises:
      InputError: no `key=value`, a value that is no YAML, or a key below one that holds a value.
    """
    key, sign, text = override.partition("=")
    if not sign or not all(key.split(".")):
        raise InputError(f"--set {override}: write it as key=value, such as --set learner.epsilon=0.1.")
    axis = key.removeprefix("sweep.axes.")
    keys = ["sweep", "axes", axis] if axis != key else key.split(".")
    set_below(data, keys, parse_yaml(text, f"--set {override}"), f"--set {override}")


def set_below(data: dict[str, Any], keys: Sequence[str], value: Any, where: str) -> None:
    """Set the value of nested keys in `data`; mappings on the way are copied, or made where there is none. If a key on
    the way holds a value, raise an InputError, which begins with `where`."""
    *parents, last = keys
    for parent in parents:
        below = {} if data.get(parent) is None else data[parent]
        if not isinstance(below, dict):
            raise InputError(f"{where}: {parent} holds a value and no keys.")
        data[parent] = data = dict(below)
    data[last] = value


MAX_NODES = 1_000_000
"""Largest number of values in a YAML text. Every use of an alias counts: nine lines of ten aliases each are a billion
values, which would fill the memory."""


class _Loader(yaml.SafeLoader):
    """YAML loader that refuses tags and duplicate keys, and reads 1e-3 as a number."""

    def get_single_node(self) -> Any:
        node = super().get_single_node()
        if node is not None and _size(node, {}) > MAX_NODES:
            raise yaml.constructor.ConstructorError(None, None, f"it holds more than {MAX_NODES:,} values")
        return node

    def compose_mapping_node(self, anchor: Any) -> Any:
        node, seen = super().compose_mapping_node(anchor), set[str]()
        for key_node, _ in node.value:
            key = self.construct_object(key_node, deep=True)
            if not isinstance(key, str) or key in seen:
                problem = f"key {shown(key)} {'appears twice' if isinstance(key, str) else 'is no string'}"
                raise yaml.constructor.ConstructorError(None, None, problem, key_node.start_mark)
            seen.add(key)
        return node


def _number(loader: yaml.SafeLoader, node: Any) -> int | float:
    """Return a number. Integers beyond the range of a float are refused, as Python cannot convert or print them; so are
    numbers of base 8 and 60, which look like others."""
    value = getattr(loader, f"construct_yaml_{node.tag.rpartition(':')[2]}")(node)
    if isinstance(value, int) and abs(value) > sys.float_info.max:
        raise yaml.constructor.ConstructorError(None, None, "a number has hundreds of digits", node.start_mark)
    if re.match(r"[-+]?0[\d_]+$|.*:", node.value) and value:
        problem = f"{node.value} is {value} to YAML; write {value}, the number that you mean, or text in quotes"
        raise yaml.constructor.ConstructorError(None, None, problem, node.start_mark)
    return value


_Loader.add_constructor("tag:yaml.org,2002:int", _number)
_Loader.add_constructor("tag:yaml.org,2002:float", _number)
_Loader.add_constructor("tag:yaml.org,2002:merge", yaml.SafeLoader.construct_yaml_str)  # the key <<
_Loader.add_implicit_resolver(
    "tag:yaml.org,2002:float", re.compile(r"^[-+]?(\d[\d_]*\.?[\d_]*|\.\d[\d_]*)[eE][-+]?\d+$"), list("-+.0123456789")
)


def _size(node: yaml.Node, sizes: dict[yaml.Node, int]) -> int:
    """Return the number of values of a node, aliases included; refuse a node that holds itself. `sizes` caches the
    numbers of earlier nodes."""
    if isinstance(node, yaml.ScalarNode):
        return 1
    if node not in sizes:
        sizes[node] = -1
        inside = [part for entry in node.value for part in (entry if isinstance(entry, tuple) else (entry,))]
        sizes[node] = 1 + sum(_size(part, sizes) for part in inside)
    elif sizes[node] < 0:
        raise yaml.constructor.ConstructorError(None, None, "a value holds itself", node.start_mark)
    return sizes[node]


def parse_yaml(text: str, where: str) -> Any:
    """Parse YAML text into plain values.

    Raises:
      InputError: text that is not YAML, is nested too deep, carries tags, holds too much by aliases, or has keys that
        are no strings or appear twice.
    """
    try:
        return yaml.load(text, Loader=_Loader)
    except RecursionError as error:
        raise InputError(f"{where}: this is nested too deep for a config.") from error
    except (yaml.YAMLError, ValueError, TypeError, AttributeError, LookupError, OverflowError) as error:
        mark = getattr(error, "problem_mark", None)
        place = f" in line {mark.line + 1}" if mark else ""
        problem = getattr(error, "problem", None) or "the text cannot be read"
        raise InputError(f"{where}: this is not plain YAML{place}: {problem}.") from error


def dump_yaml(data: dict[str, Any]) -> str:
    """Format plain values as YAML text, keys in their given order."""
    return yaml.safe_dump(data, sort_keys=False, default_flow_style=None, width=110)


def config_digest(data: Mapping[str, Any]) -> str:
    """Return the SHA-256 of a resolved config without `name`, `modules` and `then`. Runs with the same digest have the
    same results."""
    values = {key: value for key, value in data.items() if key not in ("name", "modules", "then")}
    return hashlib.sha256(json.dumps(values, sort_keys=True).encode()).hexdigest()
