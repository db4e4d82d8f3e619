"""Faults of what is read: damaged, foreign and malformed files of run folders, policies and configs, and YAML bombs."""

import io
import json
import random
import re
import shutil
import traceback
from collections.abc import Callable, Iterable
from copy import deepcopy
from pathlib import Path
from typing import Any

import numpy as np
import yaml
from fault_running import killed
from fault_trying import CONFIGS, SAME, Done, Matrix, bits, command, isolated

from humanoid_mjx.data import folder as shipped_folder
from humanoid_mjx.runs.archive import read_archive
from humanoid_mjx.spec import InputError
from humanoid_mjx.training.sweep import sweep

VALUES: tuple[Any, ...] = (
    *(None, True, 0, -1, 1, 2**31, 2**63, 10**400, 0.5, -1e308, 1e-320, float("inf"), float("nan"), "", "x", "[/b]"),
    *("\x00\x1b[31m\n", "a" * 5000, "os:path", ":", "..", "/", [], [[]], [1, 2, 3], {}, {"name": "servo"}, {"": {}}),
)
"""What a value of a config is changed into."""


def flipped(data: bytes, draw: random.Random) -> bytes:
    """One bit changed."""
    changed = bytearray(data)
    place = draw.randrange(8 * len(data))
    changed[place // 8] ^= 1 << place % 8
    return bytes(changed)


def garbled(data: bytes, draw: random.Random) -> bytes:
    """One byte changed."""
    changed = bytearray(data)
    changed[draw.randrange(len(data))] = draw.randrange(256)
    return bytes(changed)


def truncated(data: bytes, draw: random.Random) -> bytes:
    """Cut off somewhere."""
    return data[: draw.randrange(len(data))]


def foreign(run: Path, draw: random.Random) -> bytes:
    """The content of something else: noise, text, another archive, or another file of the run."""
    files = [file for file in sorted(run.rglob("*.*")) if file.is_file() and file.stat().st_size]
    others = (draw.randbytes(300), b"", b"some words\n", b"[1, 2]", b'{"a": {"b": 1}}', b"null", b"[" * 100_000)
    return draw.choice((draw.choice(others), draw.choice(files).read_bytes()))


WAYS: dict[str, Callable[[bytes, random.Random], bytes]] = {
    "truncated": truncated,
    "one bit flipped": flipped,
    "one byte changed": garbled,
}


CONFIG = CONFIGS["tabular_q"]


def _look(run: Path) -> dict[str, Any]:
    """What the commands say of a run folder, without what depends on the time and on the place."""
    page, policy, picture = run.parent / "page.html", run.parent / "policy.npz", run.parent / "plot.png"
    calls = {
        "runs": ("runs", run),
        "report": ("report", run, "--no-motion", "--out", page),
        "plot": ("plot", run, "--out", picture),
        "evaluate": ("evaluate", run, "--episodes", 8),
        "export": ("export", run, policy),
    }
    found: dict[str, Any] = {}
    for name, call in calls.items():
        page.unlink(missing_ok=True)
        policy.unlink(missing_ok=True)
        done = command(*call)
        said = done.said
        if done.how == "worked" and name == "export":
            said = str({key: array.tobytes() for key, array in read_archive(policy, ("policy",)).items()})
        if done.how == "worked" and name == "report":
            said = page.read_text()
        if done.how == "worked" and name == "plot":
            said = str(hash(picture.read_bytes()))
        found[name] = (done.how, said)
    return found


BEFORE: dict[Path, dict[str, Any]] = {}
"""What is said of run folders before anything is damaged."""


def _resume(run: Path) -> Done:
    """Resume a run folder without drawing its figures."""
    try:
        sweep(CONFIG, run, resume=True)
    except InputError as error:
        return Done("one sentence", str(error))
    except Exception:
        return Done("traceback", traceback.format_exc())
    return Done("worked", "")


def _damage(case: tuple[str, bytes | None, str]) -> tuple[str, str]:
    """Damage a copy of a run folder, read it by every command, resume it: an outcome, and what is wrong."""
    file, data, source = case
    run = Path.cwd() / "work" / "run"
    shutil.rmtree(run, ignore_errors=True)
    shutil.copytree(Path.cwd() / source, run)
    before = BEFORE.setdefault(Path(source), _look(run))
    if data is None:
        (run / file).unlink()
    else:
        (run / file).write_bytes(data)
    after = _look(run)
    if odd := [said for how, said in after.values() if how not in ("worked", "one sentence")]:
        return "wrong", f"{file}: {odd[0]}"
    resumed = _resume(run)
    if resumed.how == "one sentence" and "remove it" in resumed.said:
        Path(resumed.said.partition(": ")[0]).unlink()
        resumed = _resume(run)
    if resumed.how == "traceback":
        return "wrong", f"{file}: --resume: {resumed.said}"
    if resumed.how == "worked" and bits(run) != bits(Path.cwd() / "whole"):
        return "wrong", f"{file}: resumed to other bits"
    silent = [name for name in after if after[name][0] == "worked" and after[name] != before[name]]
    told = any(how == "one sentence" and before[name][0] == "worked" for name, (how, _) in after.items())
    if silent and not told and file.endswith((".npz", ".parquet")) and data is not None:
        return "wrong", f"{file}: read by {silent} as something else"
    how = "named" if told else "shown as it stands there" if silent else "no difference"
    return f"{how}; {SAME if resumed.how == 'worked' else 'refused to resume'}", ""


def _prepare(folder: Path) -> None:
    """A finished run in `whole`; in `cut` one that a kill has left with runs under way and others over."""
    sweep(CONFIG, folder / "whole")


def damaged_runs(matrix: Matrix, folder: Path, tries: int, seed: int) -> None:
    """Every kind of file of a run folder: truncated, a bit flipped, a byte changed, foreign, missing."""
    shutil.rmtree(folder, ignore_errors=True)
    (folder / "work").mkdir(parents=True)
    isolated(_prepare, [folder], folder, 300)
    draw, wait = random.Random(seed), 0.3
    while not any((folder / "cut").glob("checkpoint/pool-*.npz")) or not any((folder / "cut").glob("*.parquet")):
        shutil.rmtree(folder / "cut", ignore_errors=True)
        killed(CONFIG, folder / "cut", wait)
        wait = draw.uniform(0.2, 4.0)
    run = folder / "whole"
    files = [file.relative_to(run).as_posix() for file in sorted(run.rglob("*.*")) if file.is_file()]
    of_a_kind = {re.sub(r"-\d+", "", name): name for name in files if name[0] != "." and "figures" not in name}
    places = [(name, "whole") for name in of_a_kind.values()]
    for name, source in [*places, ("checkpoint/pool-0.npz", "cut")]:
        data = (folder / source / name).read_bytes()
        cases: list[tuple[str, bytes | None, str]] = [(name, None, source)]
        for _ in range(tries):
            cases += [(name, way(data, draw), source) for way in WAYS.values()]
            cases.append((name, foreign(run, draw), source))

        def tried(cases: list[tuple[str, bytes | None, str]] = cases) -> tuple[list[str], list[str]]:
            found = [x if isinstance(x, tuple) else (x, x) for x in isolated(_damage, cases, folder)]
            return [how for how, _ in found], [why for _, why in found if why]

        matrix.row("truncated, flipped, changed, foreign or missing file", re.sub(r"-\d+", "", name), tried)


def _evaluate(case: tuple[str, bytes]) -> tuple[str, str]:
    """What `evaluate` says of a policy file of these bytes."""
    name, data = case
    path = Path.cwd() / "policy.npz"
    path.write_bytes(data)
    done = command("evaluate", path, "--episodes", 8)
    return done.how, f"{name}: {done.said}"


def policies(matrix: Matrix, folder: Path, tries: int, seed: int) -> None:
    """Policy files: truncated, a bit flipped, a byte changed; and with a header or arrays that are malformed."""
    shutil.rmtree(folder, ignore_errors=True)
    folder.mkdir(parents=True)
    original = (shipped_folder("policies") / "posture_switch.npz").read_bytes()
    draw = random.Random(seed)
    ((_, expected),) = isolated(_evaluate, [("", original)], folder, 300)
    with np.load(io.BytesIO(original)) as file:
        arrays = dict(file)

    def judged(cases: list[tuple[str, bytes]], exact: bool) -> tuple[list[str], list[str]]:
        outcomes, wrong = [], []
        for found in isolated(_evaluate, cases, folder, 300):
            how, said = found if isinstance(found, tuple) else (found, found)
            other = exact and how == "worked" and said.partition(": ")[2] != expected.partition(": ")[2]
            good = how in ("worked", "one sentence") and not other
            outcomes.append(("no difference" if exact else "evaluated") if good and how == "worked" else how)
            wrong += [] if good else [f"{'silently another policy: ' if other else ''}{said}"]
        return outcomes, wrong

    def malformed(_: int) -> bytes:
        header, others = json.loads(str(arrays["header"])), dict(arrays)
        if draw.random() < 0.3:
            name = draw.choice([name for name in others if name != "header"])
            others[name] = draw.choice((others[name][:1], others[name].astype(float), np.array("x"), np.zeros(0)))
        else:
            header = mutated(header, draw)
        others["header"] = np.array(draw.choice((json.dumps(header), json.dumps(header), json.dumps([header]))))
        written = io.BytesIO()
        np.savez(written, **others)
        return written.getvalue()

    for name, way in WAYS.items():
        cases = [(name, way(original, draw)) for _ in range(tries)]
        matrix.row(name, "policy file", lambda cases=cases: judged(cases, True))
    cases = [(f"malformed {number}", malformed(number)) for number in range(tries)]
    matrix.row("malformed header or arrays", "policy file", lambda: judged(cases, False))


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


def _info(text: str) -> tuple[str, str]:
    """What `info` says of a config of this text."""
    path = Path.cwd() / "config.yaml"
    path.write_text(text, encoding="utf-8", errors="replace")
    done = command("info", path)
    return done.how, f"{text[:1500]}\n--> {done.said}"


def _read(matrix: Matrix, fault: str, texts: list[str], folder: Path) -> None:
    folder.mkdir(parents=True, exist_ok=True)

    def tried() -> tuple[list[str], list[str]]:
        found = [x if isinstance(x, tuple) else (x, x) for x in isolated(_info, texts, folder, 60)]
        named = ["accepted" if how == "worked" else how for how, _ in found]
        return named, [said for how, said in found if how not in ("worked", "one sentence")]

    matrix.row(fault, "config", tried)


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
    """Texts that are small and mean much: aliases of aliases, deep nesting, numbers without end, large sweeps."""
    base = "name: b\ntask: {name: joint_reach, joint: 1}\nlearner: {name: tabular_q}\nepisodes: 10\n"
    laughs = "a0: &a0 [x]\n" + "".join(f"a{n}: &a{n} [{', '.join([f'*a{n - 1}'] * 10)}]\n" for n in range(1, 10))
    maps = "a0: &a0 {x: 1}\n" + "".join(
        f"a{n}: &a{n} {{{', '.join(f'k{k}: *a{n - 1}' for k in range(10))}}}\n" for n in range(1, 10)
    )
    axis = "sweep: {{axes: {{learner.epsilon: {}}}}}\n"
    texts = [
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
    _read(matrix, "YAML bomb", texts, folder)
