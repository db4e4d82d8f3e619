"""Faults of what is read: damaged, foreign and malformed files of run folders, policies and configs, and YAML bombs."""

import io
import json
import random
import re
import shutil
import traceback
from collections.abc import Callable
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np
from fault_configs import mutated
from fault_running import killed
from fault_trying import CONFIGS, FINE, SAME, Done, Matrix, Try, bits, command, isolated

from humanoid_mjx.files import folder as shipped_folder
from humanoid_mjx.runs.archive import read_archive
from humanoid_mjx.spec import InputError
from humanoid_mjx.training.sweep import sweep


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


def _look(run: Path) -> dict[str, Any]:
    """Output of the commands about a run folder, without times and paths."""
    page, policy, picture, film = (run.parent / name for name in ("page.html", "policy.npz", "plot.png", "film.png"))
    calls = {
        "runs": ("runs", run),
        "report": ("report", run, "--no-motion", "--out", page),
        "plot": ("plot", run, "--out", picture),
        "evaluate": ("evaluate", run, "--episodes", 8),
        "export": ("export", run, policy),
        "play": ("play", run, "--out", film, "--size", "64x64"),
    }
    found: dict[str, Any] = {}
    for name, call in calls.items():
        page.unlink(missing_ok=True)
        policy.unlink(missing_ok=True)
        done = command(*call)
        said = re.sub(r"[\d.,]+ [KMG]?i?B\b", "", done.said)  # the bytes on disk
        if done.how == "worked" and name == "export":
            said = str({key: array.tobytes() for key, array in read_archive(policy, ("policy",)).items()})
        if done.how == "worked" and name == "report":
            said = page.read_text()
        if done.how == "worked" and name in ("plot", "play"):
            said = str(hash((picture if name == "plot" else film).read_bytes()))
        found[name] = (done.how, said)
    return found


BEFORE: dict[Path, dict[str, Any]] = {}
"""Output of the commands about undamaged run folders."""


def _resume(learner: str, run: Path) -> Done:
    """Resume a run folder without drawing its figures."""
    try:
        sweep(CONFIGS[learner], run, resume=True)
    except InputError as error:
        return Done("one sentence", str(error))
    except Exception:
        return Done("traceback", traceback.format_exc())
    return Done("worked", "")


def _damage(learner: str, case: tuple[str, bytes | None, str]) -> Try:
    """Damage a copy of a run folder, read it by every command, and resume it."""
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
    if odd := [said for how, said in after.values() if how not in FINE]:
        return "wrong", f"{file}: {odd[0]}"
    resumed = _resume(learner, run)
    if resumed.how == "one sentence" and "remove it" in resumed.said:
        Path(resumed.said.partition(": ")[0]).unlink()
        resumed = _resume(learner, run)
    if resumed.how == "traceback":
        return "wrong", f"{file}: --resume: {resumed.said}"
    if resumed.how == "worked" and bits(run) != bits(Path.cwd() / "whole"):
        return "wrong", f"{file}: resumed to other bits"
    silent = [name for name in after if after[name][0] == "worked" and after[name] != before[name]]
    told = any(how == "one sentence" and before[name][0] == "worked" for name, (how, _) in after.items())
    told |= f"/{file}: " in after["runs"][1]  # which goes on with the other folders
    if silent and not told and file.endswith((".npz", ".parquet")) and data is not None:
        return "wrong", f"{file}: read by {silent} as something else"
    how = "named" if told else "shown as it stands there" if silent else "no difference"
    return f"{how}; {SAME if resumed.how == 'worked' else 'refused to resume'}", ""


def _prepare(learner: str, folder: Path) -> None:
    """A finished run in `whole`, and in `other` one of the same shape that differs in a value."""
    sweep(CONFIGS[learner], folder / "whole")
    sweep(CONFIGS[learner] | {"seed": 1}, folder / "other")


def damaged_runs(matrix: Matrix, learner: str, folder: Path, tries: int, seed: int) -> None:
    """Every kind of file of a run folder: truncated, a bit flipped, a byte changed, foreign, of another run, missing.

    Those under way are of a run in `cut`, which a kill has left with others over.
    """
    shutil.rmtree(folder, ignore_errors=True)
    (folder / "work").mkdir(parents=True)
    isolated(partial(_prepare, learner), [folder], folder, 300)
    draw, wait, longest = random.Random(seed), 0.3, 4.0
    over = "*.parquet" if learner == "tabular_q" else "*.yaml"  # all networks are over at the same moment
    while not any((folder / "cut").glob("checkpoint/pool-*.npz")) or not any((folder / "cut").glob(over)):
        shutil.rmtree(folder / "cut", ignore_errors=True)
        killed(CONFIGS[learner], folder / "cut", wait)
        wait, longest = draw.uniform(0.2, longest), longest + 0.5  # a busy machine takes longer
    run = folder / "whole"
    files = [file.relative_to(run).as_posix() for file in sorted(run.rglob("*.*")) if file.is_file()]
    of_a_kind = {re.sub(r"-\d+", "", name): name for name in files if name[0] != "." and "figures" not in name}
    places = [(name, "whole") for name in of_a_kind.values()]
    for name, source in [("checkpoint/pool-0.npz", "cut"), *places]:
        data = (folder / source / name).read_bytes()
        cases: list[tuple[str, bytes | None, str]] = [(name, None, source)]
        for _ in range(tries):
            cases += [(name, way(data, draw), source) for way in WAYS.values()]
            cases.append((name, foreign(run, draw), source))
        if (other := folder / "other" / name).exists():
            cases.append((name, other.read_bytes(), source))
        tried = partial(isolated, partial(_damage, learner), cases, folder)
        subject = re.sub(r"-\d+", "", name) + (", networks" if learner == "deep_q" else "")
        matrix.row("truncated, flipped, changed, foreign or missing file", subject, tried)


def _evaluate(case: tuple[str, bytes]) -> tuple[str, str]:
    """Output of `evaluate` for a policy file of these bytes."""
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

    def judged(cases: list[tuple[str, bytes]], exact: bool) -> list[Try]:
        found: list[Try] = []
        for how, said in isolated(_evaluate, cases, folder, 300):
            if exact and how == "worked" and said.partition(": ")[2] != expected.partition(": ")[2]:
                found.append((how, f"silently another policy: {said}"))
            elif how in FINE:
                found.append((("no difference" if exact else "evaluated") if how == "worked" else how, ""))
            else:
                found.append((how, said))
        return found

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
