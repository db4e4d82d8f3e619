"""Checked descriptions of things: the base of every task, learner and config.

A `Spec` is a frozen pydantic model. Its fields are what a user may write in a config file. The fields that its
`Params` tuple names are *traced*: they are numbers inside a compiled program, so changing them compiles nothing.
All others are *static*: they shape the program.
"""

import difflib
import importlib
from collections.abc import Iterable, Mapping
from typing import Any, ClassVar, NamedTuple, TypeVar, get_args

import pydantic

SomeSpec = TypeVar("SomeSpec", bound="Spec")


class InputError(ValueError):
    """A value that the user gave cannot be used. The message is one sentence that says what would be right."""


class Spec(pydantic.BaseModel):
    """Base of everything that is built from user input: frozen, strict, no unknown keys, no NaN."""

    model_config = pydantic.ConfigDict(frozen=True, extra="forbid", strict=True, allow_inf_nan=False)

    class Params(NamedTuple):
        """The traced fields, in order."""

    nested: ClassVar[tuple[str, ...]] = ()
    """Fields that hold another Spec, whose traced values belong to this one's."""

    @property
    def params(self) -> Any:
        """The traced values, as a `Params` tuple of Python numbers."""
        return self.Params(*(self._traced(name) for name in self.Params._fields))

    def _traced(self, name: str) -> Any:
        return getattr(self, name).params if name in self.nested else getattr(self, name)

    def structure(self: SomeSpec) -> SomeSpec:
        """This spec with its traced fields blanked: equal for all specs that share one compiled program."""
        blank = {name: getattr(self, name).structure() if name in self.nested else None for name in self.Params._fields}
        return self.model_copy(update=blank)


def make(kind: str, registry: Mapping[str, str], base: type[Spec], name: str, /, **params: Any) -> Any:
    """Build the `kind` of thing called `name`: a name of the registry, or a user's own as "package.module:Class".

    Raises:
      InputError: unknown name, a class that is no `base`, an unknown parameter, a value out of range.
    """
    if not isinstance(name, str):
        raise InputError(f"{kind}.name must be a string, got {name!r}.")
    path = registry.get(name, name)
    if ":" not in path:
        raise InputError(f"{kind}.name: unknown {kind} {name!r}; {known(name, registry)}.")
    module_name, _, attribute = path.partition(":")
    try:
        cls = getattr(importlib.import_module(module_name), attribute)
    except (ImportError, AttributeError) as error:
        missing = (getattr(error, "name", None) or "").partition(".")[0]
        if isinstance(error, ModuleNotFoundError) and missing != module_name.partition(".")[0]:
            raise InputError(f"{kind}.name: {name!r} needs the package {missing!r}, which is not installed.") from error
        raise InputError(f"{kind}.name: {name!r} cannot be imported: {error}.") from error
    if not (isinstance(cls, type) and issubclass(cls, base)):
        raise InputError(f"{kind}.name: {name!r} must be a class derived from {base.__module__}.{base.__name__}.")
    try:
        return cls(**params)
    except pydantic.ValidationError as error:
        raise InputError(sentence(error, kind, cls)) from error


def known(name: str, names: Iterable[str]) -> str:
    """Say which names are known, the likely one first."""
    names = sorted(names)
    close = difflib.get_close_matches(name, names, n=1)
    return (f"did you mean {close[0]!r}? " if close else "") + "known are " + ", ".join(names)


def sentence(error: pydantic.ValidationError, where: str, model: type[pydantic.BaseModel] | None = None) -> str:
    """The first fault of a pydantic error as one sentence that names the key and what would be right."""
    fault: dict[str, Any] = {"ctx": {}} | dict(error.errors()[0])
    key = ".".join(str(part) for part in (where, *fault["loc"]) if part != "")
    got = f", got {fault['input']!r}"
    match fault["type"]:
        case "extra_forbidden":
            fields = [n for n, f in _fields(model, fault["loc"][:-1]).items() if not f.exclude]
            return f"{key}: unknown key; {known(str(fault['loc'][-1]), fields)}."
        case "missing":
            return f"{key}: this key is required."
        case "greater_than_equal" | "less_than_equal" | "greater_than" | "less_than":
            sign = {"greater_than_equal": "at least", "less_than_equal": "at most"}.get(
                fault["type"], fault["type"].replace("_", " ")
            )
            return f"{key} must be {sign} {next(iter(fault['ctx'].values()))}{got}."
        case "value_error":
            return f"{key}: {fault['ctx']['error']}".removeprefix(": ").rstrip(".") + "."
        case "literal_error":
            return f"{key} must be one of {fault['ctx']['expected']}{got}."
        case "model_type":
            return f"{key} must be a {fault['ctx']['class_name']}, got a {type(fault['input']).__name__}."
        case "finite_number":
            return f"{key} must be a finite number{got}."
        case _:
            message = fault["msg"].removeprefix("Input should be ")
            return f"{key} must be {message}{got}."


def _fields(model: type[pydantic.BaseModel] | None, place: Iterable[Any]) -> Mapping[str, Any]:
    """The fields of the model that stands at `place` inside `model`."""
    for name in place:
        kinds = (model.model_fields[name].annotation,) if model else ()
        kinds = [kind for outer in kinds for kind in (outer, *get_args(outer))]
        model = next((kind for kind in kinds if isinstance(kind, type) and issubclass(kind, pydantic.BaseModel)), None)
    return model.model_fields if model else {}
