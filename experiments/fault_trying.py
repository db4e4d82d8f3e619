"""Tools of all faults: small trainings, commands in this process, batches in processes of their own."""

import contextlib
import hashlib
import io
import multiprocessing
import os
import shutil
import sys
import time
import traceback
from collections import Counter
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Any, NamedTuple

from humanoid_mjx import cli, compute
from humanoid_mjx.config import dump_yaml
from humanoid_mjx.runs.tables import finished_runs

LEG = {"name": "leg_reach", "duration": 0.4, "bins": 3}
STEPS = {"envs": 4, "rollout": 8, "evaluation_envs": 4, "evaluations": 2}
CONFIGS: dict[str, dict[str, Any]] = {
    "tabular_q": {
        "name": "tables",
        "task": {"name": "joint_reach", "joint": 1, "states": 24, "max_episode_steps": 400},
        "learner": {"name": "tabular_q", "epsilon_decay": 0.99},
        "sweep": {"axes": {"learner.discount": [0.5, 0.97], "learner.epsilon": [0.3, 1.0]}},
        "seeds": 12,
        "episodes": 600,
        "record": 20,
    },
    "linear_q": {
        "name": "linear",
        "task": LEG,
        "learner": {"name": "linear_q", **STEPS, "learning_rate": 0.1, "resolution": 4, "tilings": 2, "order": 1},
        "sweep": {"axes": {"learner.epsilon": [0.1, 0.5]}},
        "seeds": 3,
        "total_steps": 2_560,
        "record": 20,
    },
    "deep_q": {
        "name": "deep",
        "task": LEG,
        "learner": {"name": "deep_q", **STEPS, "width": 16, "layers": 1},
        "sweep": {"axes": {"learner.epsilon": [0.1, 0.5]}},
        "seeds": 3,
        "total_steps": 5_120,
        "record": 20,
    },
    "brax_ppo": {
        "name": "ppo",
        "task": LEG,
        "learner": {
            "name": "brax_ppo",
            "num_envs": 8,
            "batch_size": 4,
            "num_minibatches": 2,
            "unroll_length": 4,
            "policy_hidden_layer_sizes": [8],
            "value_hidden_layer_sizes": [8],
            "evaluation_envs": 4,
        },
        "seeds": 3,
        "total_steps": 512,
        "record": 4,
    },
}
"""A training of a few seconds for each learner. The tables' runs differ in length by a factor of 20, so that some are
over while others are half done."""

TINY = CONFIGS["tabular_q"] | {"seeds": 2, "episodes": 100, "record": 10}
"""A training of a fraction of a second."""


SAME = "resumed to the same bits"
FINE = "worked", "one sentence"
"""Ends of a command that no fault may miss."""

Try = tuple[str, str]
"""The outcome of a try, and what should not have happened, in words; nothing where all is well."""


class Done(NamedTuple):
    """Outcome of a command."""

    how: str
    """`worked`, `one sentence`, `usage`, or `traceback`, which is a fault of the program."""
    said: str


class Fault(NamedTuple):
    """One row of the matrix."""

    fault: str
    subject: str
    """The learner that trained, or what was damaged."""
    tries: int
    outcomes: dict[str, int]
    seconds: float
    wrong: list[str]
    """Unexpected events, in words."""


def command(*arguments: object) -> Done:
    """Run the command line in this process, and judge how it ended."""
    out, err = io.StringIO(), io.StringIO()
    before, sys.argv = sys.argv, ["humanoid-mjx", *map(str, arguments)]
    try:
        with contextlib.redirect_stdout(out), contextlib.redirect_stderr(err):
            cli.main()
        code: Any = 0
    except SystemExit as ended:
        code = ended.code or 0
    except BaseException:
        return Done("traceback", traceback.format_exc())
    finally:
        sys.argv = before
    said = err.getvalue()
    if code == 0:
        return Done("worked", out.getvalue())
    if code == 2 and said.startswith("error: ") and said.count("\n") == 1 and len(said.strip()) > len("error:"):
        return Done("one sentence", said)
    return Done("usage" if code == 2 and "Usage:" in said else "traceback", said or f"exit code {code}")


def write_config(folder: Path, config: dict[str, Any]) -> Path:
    """The config as a file in `folder`."""
    path = folder / f"{config['name']}.yaml"
    path.write_text(dump_yaml(config))
    return path


def bits(run: Path) -> str:
    """A sum over all that a finished run promises to be the same: the tables, and the policies."""
    digest = hashlib.sha256()
    for name in ("results", "summary"):
        digest.update((run / f"{name}.parquet").read_bytes())
    for name, array in sorted(finished_runs(run, ("point", "seed", "policy")).items()):
        digest.update(name.encode() + array.tobytes())
    return digest.hexdigest()


def _serve(pipe: Any, function: Callable[[Any], Any], cases: Sequence[Any], folder: Path) -> None:
    os.chdir(folder)
    compute.start()
    for case in cases:
        pipe.send(function(case))
    pipe.close()


def processes() -> Any:
    """Processes that begin with the heavy modules imported and with no device in use."""
    context = multiprocessing.get_context("forkserver")
    context.set_forkserver_preload(["humanoid_mjx.training.sweep", "humanoid_mjx.report.page", "fault_trying"])
    return context


def isolated(function: Callable[[Any], Any], cases: Sequence[Any], folder: Path, limit_s: float = 120.0) -> list[Any]:
    """The results of a function for some cases, computed in a process of their own within `folder`.

    Where that process dies, or is silent for longer than `limit_s`, the case gets the `Try` of it in the place of a
    result, and another process takes the others.
    """
    results: list[Any] = []
    while len(results) < len(cases):
        ours, theirs = multiprocessing.Pipe(duplex=False)
        process = processes().Process(target=_serve, args=(theirs, function, cases[len(results) :], folder))
        process.start()
        theirs.close()
        try:
            while len(results) < len(cases):
                if not ours.poll(limit_s):
                    results.append(("hung", f"hung: {cases[len(results)]!r}"))
                    break
                results.append(ours.recv())
        except EOFError:
            results.append(("crashed", f"crashed: {cases[len(results)]!r}"))
        process.kill()
        process.join()
    return results


def whole(run: Path) -> Done:
    """The sweep that nothing hits."""
    return command("sweep", write_config(run.parent, TINY), "--out", run)


def begin(folder: Path) -> None:
    """Empty a folder but for `whole`, the run folder of the sweep that nothing hits."""
    shutil.rmtree(folder, ignore_errors=True)
    folder.mkdir(parents=True)
    isolated(whole, [folder / "whole"], folder)


def completed(done: Done, config: Path, run: Path, words: str) -> Try:
    """Complete a sweep of `TINY` that a fault, named in words, has ended so, and compare it with `whole`."""
    resume = ["--resume"] if (run / "checkpoint").is_dir() else []
    again = command("sweep", config, "--out", run, *resume)
    if done.how in FINE and again.how == "worked" and bits(run) == bits(Path.cwd() / "whole"):
        return f"{done.how}, {SAME}", ""
    return "wrong", f"{words}: {done.how}: {done.said} / {again.how}: {again.said}"


class Matrix:
    """The rows found so far; `row` times and adds one, and calls `found`."""

    def __init__(self, say: Callable[[str], None], found: Callable[["Matrix"], None]):
        self.rows: list[Fault] = []
        self.say, self.found = say, found

    def row(self, fault: str, subject: str, tried: Callable[[], Sequence[Try]]) -> None:
        """Add what `tried` returns."""
        began = time.monotonic()
        found = tried()
        counts, wrong = dict(Counter(outcome for outcome, _ in found).most_common()), [odd for _, odd in found if odd]
        self.rows.append(Fault(fault, subject, len(found), counts, round(time.monotonic() - began, 1), wrong))
        words = ", ".join(f"{count} {name}" for name, count in counts.items())
        self.say(f"{fault}, {subject}: {len(found)} tries: {words}; {self.rows[-1].seconds:.0f} s")
        for sentence in wrong[:10]:
            self.say(f"  WRONG {sentence[-1500:]}")
        self.found(self)
