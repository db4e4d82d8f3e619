"""Reference of the keys of a config, read from the classes of tasks and learners."""

from collections.abc import Iterator
from typing import Annotated, Any, Literal, NamedTuple, get_args, get_origin

from humanoid_mjx.spec import Spec, is_traced, within

BOUNDS = {"ge": "at least", "gt": "above", "le": "at most", "lt": "below"}


class Key(NamedTuple):
    """One key of a config."""

    name: str
    """Dotted, as `--set` and axes have it."""
    default: str
    """As YAML has it; empty where the key is required or follows from others."""
    allowed: str
    """The kind of value and its range."""
    traced: bool
    """True for data of a compiled program: sweeping it compiles nothing."""
    meaning: str


def keys_of(cls: type[Spec], prefix: str, branch: Spec | None = None) -> Iterator[Key]:
    """Yield the keys of a Spec and of the Specs that its fields hold or, where the default is null, may hold.

    `branch` is the default of a nested Spec.
    """
    for name, field in cls.model_fields.items():
        if field.exclude and not field.description:  # set by no user
            continue
        dotted = name if field.exclude else f"{prefix}.{name}"  # those excluded stand at the top level of a config
        default = getattr(branch, name) if branch else field.default
        if isinstance(default, Spec):
            named = getattr(default, "name", "")
            yield Key(dotted, str(named), "keys below", False, _meaning(cls, name))
            yield from keys_of(type(default), dotted, default)
            continue
        shown = "" if field.is_required() and not branch else _plain(default)
        meaning = _meaning(cls, name) or (f"kind of {prefix.rpartition('.')[2]}" if name == "name" else "")
        yield Key(dotted, shown, _allowed(field), is_traced(field), meaning)
        for part in within([field.annotation]) if default is None else ():
            if isinstance(part, type) and issubclass(part, Spec):
                yield from keys_of(part, dotted)


def _meaning(cls: type[Spec], name: str) -> str:
    """Return the description of a field, from the class or the nearest base that has one."""
    fields = (getattr(base, "model_fields", {}).get(name) for base in cls.__mro__)
    return next((field.description for field in fields if field and field.description), "")


def _plain(value: Any) -> str:
    if value is None or isinstance(value, bool):
        return {None: "null", True: "true", False: "false"}[value]
    return str(list(value)) if isinstance(value, tuple) else str(value)


def _allowed(field: Any) -> str:
    kinds = [kind for kind in _kinds(field.annotation) if kind]
    bounds = [
        f"{word} {bound:,}" if isinstance(bound, int) else f"{word} {bound:g}"
        for item in field.metadata
        for sign, word in BOUNDS.items()
        if isinstance(bound := getattr(item, sign, None), (int, float))
    ]
    return ", ".join([" or ".join(dict.fromkeys(kinds)), *bounds])


def _kinds(annotation: Any) -> list[str]:
    """Return the values that a field takes, in words."""
    if get_origin(annotation) is Annotated:
        return _kinds(get_args(annotation)[0])
    if get_origin(annotation) is Literal:
        return [str(choice) for choice in get_args(annotation)]
    if get_origin(annotation) is dict:
        return [f"{_kinds(get_args(annotation)[1])[0]} by name"]
    if get_origin(annotation) in (tuple, list):
        inner = [kind for kind in get_args(annotation) if kind is not Ellipsis]
        return [f"list of {_kinds(inner[0])[0]}"]
    if get_args(annotation):
        return [kind for part in get_args(annotation) for kind in _kinds(part)]
    words = {float: "number", int: "whole number", bool: "true or false", str: "text", type(None): "null"}
    return [words.get(annotation, getattr(annotation, "__name__", str(annotation)))]
