"""`Spec`: the base of tasks, learners, physics, control laws and robots.

A `Spec` is a frozen pydantic model and a pytree. Its fields are the keys that a config may hold. A field declared with
`traced` is a leaf of the pytree: data of a compiled program, which an array may replace without another compilation. A
field that holds another Spec is a subtree. Every other field is *static*: it shapes the program. Specs of the same
`jax.tree.structure` share one compiled program.
"""

import difflib
import importlib
import importlib.util
import os
import re
import sys
from collections.abc import Callable, Iterable, Iterator, Mapping
from contextlib import contextmanager
from contextvars import ContextVar
from importlib.machinery import PathFinder
from math import inf
from pathlib import Path
from types import ModuleType
from typing import Any, TypeVar, get_args

import jax
import numpy as np
import pydantic
from pydantic_core import PydanticKnownError

from humanoid_mjx.user_code import in_words

SMALLEST, LARGEST = (float(getattr(np.finfo(np.float32), name)) for name in ("tiny", "max"))
"""The ends of the numbers that float32 holds in full."""

SomeSpec = TypeVar("SomeSpec", bound="Spec")
Some = TypeVar("Some")


class InputError(ValueError):
    """A value from the user that cannot be used. The message is one sentence that says which values can."""


def check_count(what: str, value: Any, least: int) -> None:
    """Raise an InputError unless this is an integer of at least `least`; the message begins with `what`."""
    if isinstance(value, bool) or not isinstance(value, (int, np.integer)) or value < least:
        raise InputError(f"{what} must be an integer of at least {least}, got {shown(value)}.")


def check_folder(file: Path, option: str = "") -> None:
    """Raise an InputError, whose message begins with `option`, unless a file can be written: its folder exists, and it
    is no folder itself."""
    if str(file) == "-" or (file.exists() and not file.is_file()):
        kind = "the standard output" if str(file) == "-" else "a folder" if file.is_dir() else "a pipe or device"
        raise InputError(f"{option} {file}: this is {kind}; name a file.".lstrip())
    if not file.parent.is_dir():
        what = f"{file.parent} is a file and no folder" if file.parent.exists() else f"there is no folder {file.parent}"
        raise InputError(f"{option} {file}: {what}.".lstrip())


def traced(default: Any = ..., **constraints: Any) -> Any:
    """Declare a field of a `Spec` that compiled programs take as data. `constraints` are those of `pydantic.Field`."""
    return pydantic.Field(default, json_schema_extra={"traced": True}, **constraints)


def is_traced(field: Any) -> bool:
    """Return whether a field of `model_fields` was declared with `traced`."""
    return isinstance(field.json_schema_extra, dict) and bool(field.json_schema_extra.get("traced"))


class Spec(pydantic.BaseModel):
    """Base of everything that is built from user input: a pytree, frozen and strict, without unknown keys and NaN.

    The constructor checks values. `replace` and jax put other values in their place without a check.
    """

    model_config = pydantic.ConfigDict(frozen=True, extra="forbid", strict=True, allow_inf_nan=False)

    @classmethod
    def __pydantic_init_subclass__(cls, **kwargs: Any) -> None:
        super().__pydantic_init_subclass__(**kwargs)
        jax.tree_util.register_pytree_with_keys(cls, _flatten_with_keys, cls._unflatten, _flatten)

    @classmethod
    def _unflatten(cls, structure: tuple[tuple[str, ...], tuple[tuple[str, Any], ...]], nodes: Iterable[Any]) -> Any:
        names, static = structure
        return cls.model_construct(**dict(static), **dict(zip(names, nodes, strict=True)))

    @pydantic.model_validator(mode="before")
    @classmethod
    def _keys_of_a_branch_change_its_default(cls, data: Any) -> Any:
        """Complete the values given for a nested Spec from the field's default."""
        if not isinstance(data, dict):
            return data
        defaults = {name: cls.model_fields[name].default for name in data if name in cls.model_fields}
        branches = {name: default for name, default in defaults.items() if isinstance(default, Spec)}
        return data | {name: _completed(default, data[name]) for name, default in branches.items()}

    @pydantic.field_validator("*", mode="before")
    @classmethod
    def _numbers_are_what_programs_compute_with(cls, value: Any, info: Any) -> Any:
        """Refuse numbers that are infinite or 0 in float32; and `true` and 1.0 where integers are listed: pydantic
        compares by `==`, as Python does."""
        number = isinstance(value, (int, float)) and value == value and value not in (0, inf, -inf)
        if number and not SMALLEST <= abs(value) <= LARGEST:  # pydantic refuses what is not finite
            raise ValueError(f"a number must be 0 or from {SMALLEST:.3g} to {LARGEST:.3g}, got {shown(value)}")
        kinds = (cls.model_fields[info.field_name].annotation,)
        if isinstance(value, (bool, float)) and (numbers := [k for k in within(kinds) if type(k) is int]):
            raise PydanticKnownError("literal_error", {"expected": ", ".join(map(str, numbers))})
        return value

    def replace(self: SomeSpec, **values: Any) -> SomeSpec:
        """Return a copy with other values in some fields. Traced fields take arrays, whose values are not checked.

        Raises:
          InputError: no such field; in a static field an array, or text that is none of its choices.
        """
        for name, value in values.items():
            place = f"{type(self).__name__}.replace: {name}"
            if (field := type(self).model_fields.get(name)) is None:
                raise InputError(f"{place}: unknown field; {known(name, type(self).model_fields)}.")
            choices = [kind for kind in within([field.annotation]) if isinstance(kind, str)]
            if isinstance(value, str) and choices and value not in choices:
                raise InputError(f"{place} must be one of {', '.join(choices)}, got {value!r}.")
            if isinstance(value, (jax.Array, np.ndarray)) and not is_traced(field):
                why = "it shapes the program, so no array can stand there; take its values one by one in a Python loop"
                raise InputError(f"{place} is static: {why}.")
        return self.model_copy(update=values)


def within(kinds: Iterable[Any]) -> Iterator[Any]:
    """Yield annotations and all their parts, with the values of a `Literal`."""
    for kind in kinds:
        yield kind
        yield from within(get_args(kind))


def kinds(spec: Spec) -> Iterator[type[Spec]]:
    """Yield the classes of a Spec and of the Specs in its fields."""
    yield type(spec)
    for value in vars(spec).values():
        if isinstance(value, Spec):
            yield from kinds(value)


def ships(kind: type[Spec]) -> bool:
    """Return whether a class is one of this package, and not a user's."""
    return kind.__module__.startswith("humanoid_mjx.")


def _flatten(spec: Spec) -> tuple[list[Any], tuple[tuple[str, ...], tuple[tuple[str, Any], ...]]]:
    """Return the nodes of the pytree; their names, and the static fields."""
    nodes, static = {}, {}
    for name, field in type(spec).model_fields.items():
        value = getattr(spec, name)
        (nodes if is_traced(field) or isinstance(value, Spec) else static)[name] = value
    return list(nodes.values()), (tuple(nodes), tuple(static.items()))


def _flatten_with_keys(spec: Spec) -> tuple[list[tuple[Any, Any]], Any]:
    values, structure = _flatten(spec)
    return list(zip(map(jax.tree_util.GetAttrKey, structure[0]), values, strict=True)), structure


def _completed(default: Spec, written: Any) -> Any:
    """Return the values given for a nested Spec, completed from its default if both have the same `name`."""
    values = {name: getattr(default, name) for name in type(default).model_fields}
    if isinstance(written, str) and "name" in values:
        written = {"name": written}
    if not isinstance(written, dict) or written.get("name", values.get("name")) != values.get("name"):
        return written
    branches = {name: values[name] for name in written if isinstance(values.get(name), Spec)}
    return values | written | {name: _completed(default, written[name]) for name, default in branches.items()}


class Named(Spec):
    """Base of Specs that a config selects by `name`. Each kind, such as tasks or control laws, derives its own base."""

    name: str = ""

    @pydantic.model_validator(mode="before")
    @classmethod
    def _named_by_its_place(cls, data: Any) -> Any:
        """Name a class of the user by its import path, so that a stored config can be read again."""
        unnamed = isinstance(data, dict) and not cls.model_fields["name"].default
        return {"name": f"{cls.__module__}:{cls.__qualname__}"} | data if unnamed else data


def make(kind: str, registry: Mapping[str, str], base: type[Any], name: str, /, **values: Any) -> Any:
    """Build the task, learner, physics, ... (`kind`) called `name`: a name of the registry, or "package.module:Class".

    Raises:
      InputError: unknown name, a class that is no `base`, an unknown key, a value out of range, or an error that a
        user's own class raises.
    """
    cls = find(kind, registry, base, name)
    if issubclass(base, Named) and name not in registry:
        values |= {"name": name}
    try:
        return cls(**values)
    except pydantic.ValidationError as error:
        shown = {"task": name, "learner": name, "robot": "robot"}.get(kind, "TASK")
        raise InputError(sentence(error, kind, cls, f"info {shown} --keys")) from error
    except Exception as error:
        if ":" not in name or isinstance(error, InputError):
            raise
        raise InputError(f"{kind}.name: {name!r} cannot be built: {in_words(error)}.") from error


def written(kind: str, make: Callable[..., Any]) -> pydantic.BeforeValidator:
    """Return the validator of a field that holds a `Named` of this kind.

    A config gives a name, or a mapping with `name` and other values; `make(name, **values)` builds the object.
    """

    def build(given: Any) -> Any:
        if not isinstance(given, (str, Mapping)):
            return given
        values = {"name": given} if isinstance(given, str) else dict(given)
        if "name" not in values:
            raise InputError(f"{kind}.name: this key is required")
        return make(values.pop("name"), **values)

    return pydantic.BeforeValidator(build)


_folder: ContextVar[str | None] = ContextVar("_folder", default=None)


@contextmanager
def modules_in(folder: str | None) -> Iterator[None]:
    """Within the block, search this folder for modules that Python does not find."""
    before = _folder.set(folder)
    try:
        yield
    finally:
        _folder.reset(before)


_strangers: ContextVar[tuple[Path, ...] | None] = ContextVar("_strangers", default=None)
"""Folders below the working directory whose modules are not imported; None: every module may be imported."""


@contextmanager
def own_modules_only(*strangers: Path) -> Iterator[None]:
    """Within the block, configs and policies may import only this package's modules and modules below the working
    directory. Installed packages and modules below a folder of `strangers` are refused."""
    before = _strangers.set(tuple(path.resolve() for path in strangers))
    try:
        yield
    finally:
        _strangers.reset(before)


def _is_run(module: str) -> bool:
    """Return whether `own_modules_only` allows a module. A module that does not exist is left to `_import`."""
    strangers, top = _strangers.get(), module.partition(".")[0]
    if strangers is None or top == __package__:
        return True
    try:
        found = importlib.util.find_spec(top) or PathFinder.find_spec(top, search_folders())
    except ValueError:  # of a program that is no file
        return False
    if found is None:
        return True
    places = [found.origin, *(found.submodule_search_locations or ())]
    path = Path(next((place for place in places if place and os.path.exists(place)), os.sep)).resolve()
    installed = "site-packages" in path.parts
    return path.is_relative_to(Path.cwd()) and not installed and not any(map(path.is_relative_to, strangers))


def search_folders() -> list[str]:
    """Return the folder of `modules_in`, if there is one, and the working directory."""
    return list(dict.fromkeys(filter(None, (_folder.get(), os.getcwd()))))


def _import(name: str) -> ModuleType:
    """Import a module from Python's path, the folder of `modules_in` or the working directory."""
    try:
        return importlib.import_module(name)
    except ModuleNotFoundError as error:
        if error.name != name.partition(".")[0]:
            raise
        folders = search_folders()
        sys.path += (added := [folder for folder in folders if folder not in sys.path])
        try:
            return importlib.import_module(name)
        except BaseException as error:
            for folder in added:
                sys.path.remove(folder)
            if isinstance(error, ModuleNotFoundError) and error.name == name.partition(".")[0]:
                words = f"{error.msg} on Python's path or in {' or '.join(folders)}"
                raise ModuleNotFoundError(words, name=error.name) from None
            raise


def package(name: str, extra: str, what: str) -> Any:
    """Return a package that an extra of this one brings; if it is not installed, raise an InputError that `what` needs
    it."""
    try:
        return importlib.import_module(name)
    except ImportError as error:
        raise InputError(f"{what} needs the package {name}; pip install 'humanoid-mjx[{extra}]' brings it.") from error


def find(kind: str, registry: Mapping[str, str], base: type[Some], name: str) -> type[Some]:
    """Return the class of the task, learner, physics, ... (`kind`) called `name`.

    Raises:
      InputError: unknown name, a module that cannot be imported, a class that is no `base`.
    """
    if not isinstance(name, str):
        hint = f'; write "{name.__module__}:{name.__name__}", or {name.__name__}(...)' if isinstance(name, type) else ""
        raise InputError(f"{kind}.name must be a string, got {name!r}{hint}.")
    path = registry.get(name, name)
    if ":" not in path:
        raise InputError(f"{kind}.name: unknown {kind} {name!r}; {known(name, registry)}.")
    module_name, _, attribute = path.partition(":")
    if not _is_run(module_name):
        raise InputError(
            f"{kind}.name: {name!r} is code that is neither this package's nor below the working directory; "
            "add --trust to run it."
        )
    try:
        cls = getattr(_import(module_name), attribute)
    except (ImportError, AttributeError, ValueError) as error:
        missing = (getattr(error, "name", None) or "").partition(".")[0]
        if isinstance(error, ModuleNotFoundError) and missing != module_name.partition(".")[0]:
            raise InputError(f"{kind}.name: {name!r} needs the package {missing!r}, which is not installed.") from error
        raise InputError(f"{kind}.name: {name!r} cannot be imported: {error}.") from error
    if not (isinstance(cls, type) and issubclass(cls, base)):
        raise InputError(f"{kind}.name: {name!r} must be a class derived from {base.__module__}.{base.__name__}.")
    return cls


ELSEWHERE = {
    "batch_size": ("minibatches",),
    **dict.fromkeys(("eps", "epsilon_start", "exploration_initial_eps"), ("epsilon",)),
    **dict.fromkeys(("epsilon_end", "exploration_final_eps"), ("epsilon_min",)),
    "gamma": ("discount", "discounting"),
    **dict.fromkeys(("hidden_dim", "hidden_size"), ("width",)),
    "max_grad_norm": ("max_gradient",),
    "max_steps": ("max_episode_steps", "total_steps"),
    "num_episodes": ("episodes",),
    "num_layers": ("layers",),
    "num_seeds": ("seeds",),
    "tau": ("temperature", "weight_averaging"),
    **dict.fromkeys(("alpha", "lr"), ("learning_rate",)),
    **dict.fromkeys(("gae_lambda", "lam", "lambda"), ("trace_decay", "gae_lambda")),
    **dict.fromkeys(("n_envs", "num_envs"), ("envs", "num_envs")),
    **dict.fromkeys(("n_steps", "num_steps"), ("rollout", "steps", "unroll_length")),
    **dict.fromkeys(("timesteps", "total_timesteps"), ("total_steps",)),
    **dict.fromkeys(("agent", "algo", "algorithm", "model"), ("learner",)),
    **dict.fromkeys(("mjcf", "xml"), ("model",)),
    **dict.fromkeys(("env", "env_id", "environment"), ("task",)),
    **dict.fromkeys(("grid", "hyperparameters", "parameters"), ("sweep",)),
}
"""Names of keys in other libraries, and the keys of this package."""


SHOWN_LETTERS = 200


def shown(value: Any) -> str:
    """Return a value that a user wrote as text, cut to `SHOWN_LETTERS`."""
    text = repr(value).replace("\n", "")  # of arrays
    return text if len(text) <= SHOWN_LETTERS else f"{text[:SHOWN_LETTERS]}..."


LISTED_LETTERS, NEAR = 120, 5
"""Length of a list of names that is shown whole, and the names that are shown of a longer one."""


def known(name: str, names: Iterable[str], command: str = "") -> str:
    """Return words that list the known names, of a long list the nearest and the `command` that shows all."""
    names = sorted(set(names))
    close = [here for here in ELSEWHERE.get(name, ()) if here in names] or difflib.get_close_matches(name, names, n=1)
    shown, more = names, ""
    if len(", ".join(names)) > LISTED_LETTERS:
        shown = difflib.get_close_matches(name, names, n=NEAR, cutoff=0.0)
        more = f" and {len(names) - NEAR} more" + (f": humanoid-mjx {command} shows them" if command else "")
    return (f"did you mean {close[0]!r}? " if close else "") + f"known are {', '.join(shown)}{more}"


SENTENCES = {
    "dict_type": "must be a mapping of keys, such as {{name: ...}}",
    "finite_number": "must be a finite number",
    "greater_than": "must be greater than {gt}",
    "greater_than_equal": "must be at least {ge}",
    "less_than": "must be less than {lt}",
    "less_than_equal": "must be at most {le}",
    "list_type": "must be a list",
    "literal_error": "must be one of {expected}",
}
"""Descriptions of the allowed values, by the type of pydantic's error."""


ALTERNATIVES = "", "bool", "float", "int", "str"
"""Parts of a place in pydantic's errors that are no keys but kinds of values; others have brackets."""


def sentence(
    error: pydantic.ValidationError, where: str, model: type[pydantic.BaseModel] | None = None, command: str = ""
) -> str:
    """Return the first fault of a pydantic error as one sentence with the key and the allowed values; `command` shows
    the keys."""
    faults = error.errors()
    # A key that is nearly right is also missing: its near name says more.
    first = next((fault for fault in faults if fault["type"] == "extra_forbidden"), faults[0])
    fault: dict[str, Any] = {"ctx": {}} | dict(first)
    parts = [str(part) for part in (where, *fault["loc"])]
    key = ".".join(part for part in parts if part not in ALTERNATIVES and "[" not in part)
    got, nested = f", got {shown(fault['input'])}", "." in key.removeprefix("sweep.")
    match fault["type"]:
        case "float_type" | "int_type" if isinstance(fault["input"], (jax.Array, np.ndarray, np.generic)):
            last = fault["loc"][-1]
            return f"{key} must be a number{got}; build with a number, then .replace({last}=...) takes an array."
        case kind if kind in SENTENCES:
            return f"{key} {SENTENCES[kind].format(**fault['ctx'])}{got}."
        case "extra_forbidden":
            return f"{key}: unknown key; {known(str(fault['loc'][-1]), _fields(model, fault['loc'][:-1]), command)}."
        case "missing":
            return f"{key}: this key is required."
        case "value_error":
            parents, _, last = key.rpartition(".")
            message = str(fault["ctx"]["error"]).rstrip(".") + "."
            if last and re.match(rf"{re.escape(last)}[. :]", message):  # it says the key itself, and what is in it
                return f"{parents}.{message}".removeprefix(".")
            return f"{key}: {message}".removeprefix(": ")
        case "model_type":
            if "name" in (fields := _fields(model, fault["loc"])):
                return f"{key} must be a name, or a mapping of keys with a name{got}."
            return f"{key} must be a mapping of keys{got}; {known('', fields, command)}."
        case "string_pattern_mismatch":
            field = _fields(model, fault["loc"][:-1]).get(fault["loc"][-1])
            meaning = f", {field.description}" if field and field.description else ""
            return f"{key} must match the pattern {fault['ctx']['pattern']}{meaning}{got}."
        case "too_short":
            least = fault["ctx"]["min_length"]
            return f"{key} must hold at least {least} {'entry' if least == 1 else 'entries'}{got}."
        case "int_type" if isinstance(fault["input"], float) and fault["input"].is_integer():
            return f"{key} must be an integer; write {int(fault['input'])}{got}."
        case "int_type" | "float_type" if isinstance(fault["input"], (list, dict)) and nested:
            return f"{key} must be a number{got}; several values are an axis: write sweep.axes.{key}."
        case "string_type" if isinstance(fault["input"], (bool, int, float)):
            return f"{key} must be text{got}; put it into quotes."
        case _:
            message = fault["msg"].removeprefix("Input should be ")
            return f"{key} must be {message}{got}."


def _fields(model: type[pydantic.BaseModel] | None, place: Iterable[Any]) -> Mapping[str, Any]:
    """Return the fields of the model at `place` inside `model` that a config may hold."""
    for name in place:
        kinds = (model.model_fields[name].annotation,) if model else ()
        model = next(
            (kind for kind in within(kinds) if isinstance(kind, type) and issubclass(kind, pydantic.BaseModel)), None
        )
    return {name: field for name, field in model.model_fields.items() if not field.exclude} if model else {}
