"""Faults of configs: values, keys and letters that make no sense, and YAML bombs."""

import random
from collections.abc import Iterable
from copy import deepcopy
from pathlib import Path
from typing import Any

import yaml
from fault_trying import FINE, Matrix, Try, command, isolated

from humanoid_mjx.files import folder as shipped_folder

VALUES: tuple[Any, ...] = (
    *(None, True, 0, -1, 1, 2**31, 2**63, 10**400, 0.5, -1e308, 1e-320, float("inf"), float("nan"), "", "x", "[/b]"),
    *("\x00\x1b[31m\n", "a" * 5000, "os:path", ":", "..", "/", [], [[]], [1, 2, 3], {}, {"name": "servo"}, {"": {}}),
)
"""Replacements for a value of a config."""


def places_in(data: Any) -> Iterable[tuple[Any, Any]]:
    """Every container within plain values, with each of its keys."""
    for key in data if isinstance(data, dict) else range(len(data)) if isinstance(data, list) else ():
        yield data, key
        yield from places_in(data[key])


def mutated(data: Any, draw: random.Random) -> Any:
    """Plain values with one to three changes: a value replaced, removed, moved or wrapped, a key renamed or added."""
    data = deepcopy(data)
    for _ in range(draw.randint(1, 3)):
        place: Any
        place, key = draw.choice(list(places_in(data)) or [([0], 0)])
        match draw.randrange(6):
            case 0 | 1 | 2:
                place[key] = deepcopy(draw.choice(VALUES))
            case 3:
                del place[key]
            case 4 if isinstance(place, dict):
                place[f"{key}{draw.choice('xs. ')}"] = place.pop(key)
            case _:
                place[key] = draw.choice(([place[key]], {"name": place[key]}, {"linspace": [0, 1, place[key]]}))
    return data


def _info(text: str) -> Try:
    """Output of `info` for a config of this text."""
    path = Path.cwd() / "config.yaml"
    path.write_text(text, encoding="utf-8", errors="replace")
    done = command("info", path)
    how = "accepted" if done.how == "worked" else done.how
    return how, "" if done.how in FINE else f"{text[:1500]}\n--> {done.said}"


def _read(matrix: Matrix, fault: str, texts: list[str], folder: Path) -> None:
    folder.mkdir(parents=True, exist_ok=True)
    matrix.row(fault, "config", lambda: isolated(_info, texts, folder, 60))


def configs(matrix: Matrix, folder: Path, tries: int, seed: int) -> None:
    """Malformed configs: the shipped ones with values, keys and letters changed."""
    draw = random.Random(seed)
    originals = [path.read_text() for path in sorted(shipped_folder("configs").glob("*.yaml"))]
    trees = [yaml.dump(mutated(yaml.safe_load(draw.choice(originals)), draw)) for _ in range(tries)]
    _read(matrix, "malformed values and keys", trees, folder)
    letters = []
    for _ in range(tries):
        text = draw.choice(originals)
        for _ in range(draw.randint(1, 3)):
            place = draw.randrange(len(text))
            text = (
                text[:place]
                + draw.choice("{}[]:,-&*!?|>%@`'\"#\t\n 0e.~\x00\u2028")
                + text[place + draw.randrange(3) :]
            )
        letters.append(text)
    _read(matrix, "malformed text", letters, folder)


def bombs(matrix: Matrix, folder: Path) -> None:
    """Configs of `bomb_texts`."""
    _read(matrix, "YAML bomb", bomb_texts(), folder)


def bomb_texts() -> list[str]:
    """Return texts that are small and mean much: aliases of aliases, deep nesting, long numbers, large sweeps."""
    base = "name: b\ntask: {name: joint_reach, joint: 1}\nlearner: {name: tabular_q}\nepisodes: 10\n"
    laughs = "a0: &a0 [x]\n" + "".join(f"a{n}: &a{n} [{', '.join([f'*a{n - 1}'] * 10)}]\n" for n in range(1, 10))
    maps = "a0: &a0 {x: 1}\n" + "".join(
        f"a{n}: &a{n} {{{', '.join(f'k{k}: *a{n - 1}' for k in range(10))}}}\n" for n in range(1, 10)
    )
    axis = "sweep: {{axes: {{learner.epsilon: {}}}}}\n"
    return [
        *(laughs, base + laughs, base.replace("joint: 1", "joint: *a9").join((laughs, "")), maps, base + maps),
        *(base + "x: &x [*x]\n", base + "x: &x {y: *x}\n", "&x {name: *x}\n", base + "<<: &x {<<: *x}\n"),
        *(base + "x: " + "[" * n for n in (100, 3000, 100_000)), base + "x: " + "{a: " * 3000 + "1" + "}" * 3000,
        *(base + "x: " + "- " * 3000 + "1\n", base + "".join(" " * n + f"k{n}:\n" for n in range(1200))),
        *(base.replace("10", "9" * n) for n in (12, 400, 4000, 5000)), base.replace("10", "0x" + "f" * 5000),
        *(base.replace("10", "1" + ":59" * 3000), base.replace("10", "1e" + "9" * 100), base.replace("10", "-.inf")),
        *(base + axis.format(x) for x in (
            *("{linspace: [0, 1, 1000000]}", "{linspace: [0, 1, 99999999999]}", "{linspace: [0, 1e400, 3]}"),
            *(f"{{linspace: [0, {10**400}, 3]}}", f"{{logspace: [1, {10**400}, 3]}}", "{linspace: [0, 1, 1e9]}"),
        )),
        base + "seeds: 1000000\n" + axis.format("{linspace: [0, 1, 1000000]}"),
        base + "sweep: {mode: random, points: 1000000, axes: {learner.epsilon: {uniform: [0, 1]}}}\n",
        base + f"sweep: {{mode: random, points: 9, axes: {{task.states: {{integers: [2, {10**30}]}}}}}}\n",
        *(base + f"x: !!{tag}\n" for tag in ("int ''", "bool x", "timestamp x", "set {a}", "omap [1]", "binary x")),
        *(base + x for x in ('x: "\\ud800"\n', "x: 2001-99-99\n", "? [a]\n: 1\n", "x: =\n", "--- 1\n--- 2\n")),
        base + "%YAML 9.9\n---\n",
    ]  # fmt: skip
