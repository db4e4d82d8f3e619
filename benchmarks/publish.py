"""Measure the speeds that docs/benchmarks.md shows, on this machine and at one commit.

    python benchmarks/publish.py                            # writes docs/bench/speed_cpu.json or speed_gpu.json
    python benchmarks/publish.py --limit 380 --within 90    # no row starts after 380 s, none takes longer than 90 s
    python benchmarks/publish.py physics --out FILE         # some benchmarks

A row is one subject at one batch. Rows run one after another, those of most worth first, in a process that is ended
when a row exceeds its time and replaced when it dies; the record names each row that failed, and why. It is written
after every row. Compile time is apart, nothing comes from the disk, every call is waited for, and a figure is the
median of its repeats. Stop everything else first: shared cores give no timing.
"""

import argparse
import json
import os
import time
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from functools import partial
from importlib.util import find_spec
from multiprocessing import get_context
from multiprocessing.connection import Connection
from pathlib import Path
from typing import Any

import ground_physics as ground
import jax
import leg_physics as leg
import opponents
import other_tables
import startup
import tabular
import trainings
from timing import CONTROLLED, PLAIN, Record, Subject, time_rates

from humanoid_mjx import compute
from humanoid_mjx.commands.bench import BENCHES
from humanoid_mjx.files import write_text
from humanoid_mjx.training.programs import why_no_kernel

BENCH = Path(__file__).parents[1] / "docs" / "bench"

REPEATS = 5

AGAIN = 10
"""Times that a call on a GPU runs a fast program: a launch takes longer than some of them."""

ROBOTS = "lower_body", "dog"

NATIVE = 1024
"""Robots that native MuJoCo simulates at once: more do not change its rate, only the memory of their states."""

START_S = 120.0
"""Seconds that a process may take to start."""


@dataclass(frozen=True)
class Row:
    """One subject at one batch."""

    bench: str
    subject: str
    batch: int
    measure: Callable[..., Any]
    """Called in another process with `arguments`; returns a list of `Record`."""
    arguments: tuple[Any, ...] = ()
    needs: str = ""
    """A package without which there is no such row."""
    process: str = "own"
    """Settings of its process: `own`, the package's; `mjx`, with room for MJX's threads; `plain`, XLA's defaults."""

    def __str__(self) -> str:
        return f"{self.bench} {self.subject}" + f" ({self.batch:,})" * bool(self.batch)


def rows(backend: str) -> list[Row]:
    """Return all rows of a machine, those of most worth first."""
    gpu = backend == "gpu"
    mjx = "own" if gpu else "mjx"  # on a CPU, MJX needs more of XLA's threads than all else is fastest with

    def tables(batch: int, *subjects: str) -> list[Row]:
        needs = {"numba": "numba"}
        return [Row("tabular", name, batch, tables_row, (name, batch), needs.get(name, "")) for name in subjects]

    def bodies(robot: str, batch: int, *subjects: str) -> list[Row]:
        found = []
        for name in subjects:
            size = min(batch, NATIVE) if name == "mujoco" else batch
            needs, process = "warp" * (name == "mjx-warp"), mjx if name == "mjx-jax" else "own"
            found.append(Row("physics", f"{robot} {name}", size, bodies_row, (robot, name, size), needs, process))
        return found

    def legs(batch: int, *subjects: str) -> list[Row]:
        found = []
        for name in subjects:
            process = {"mjx-jax": mjx, "mjx-jax plain": "plain"}.get(name, "own")
            size = min(batch, opponents.LEGS) if name == "mujoco" else batch
            found.append(Row("physics", f"legs {name}", size, legs_row, (name, size), "", process))
        return found

    def training(config: str) -> Row:
        return Row("training", config, 0, training_row, (config,), "brax" * config.endswith("ppo"))

    def postures(physics: str) -> Row:
        process = mjx if physics == "mjx-jax" else "own"
        return Row("physics", f"posture_switch {physics}", 0, opponents.postures_row, (physics,), "", process)

    def start_up(*configs: str) -> list[Row]:
        return [Row("startup", config, 0, startup_row, (config, 1 if gpu else 2)) for config in configs]

    others = ("mjx-jax", "mjx-warp", "mujoco") if gpu else ("mjx-jax", "mujoco")
    learners = [training(config) for config in trainings.LEG]
    if gpu:
        return [
            *bodies("lower_body", 32_768, "tree", *others),
            *tables(1_048_576, "fused", "scan", "naive_scan", "numba"),
            training("walk"),
            *bodies("dog", 32_768, "tree", *others),
            *legs(262_144, "chain", "mjx-jax", "mujoco"),
            *learners,
            postures("chain"),
            postures("mjx-jax"),
            *bodies("lower_body", 4096, "tree", "mjx-jax"),
            *bodies("lower_body", 256, "tree", "mjx-jax", "mujoco"),
            *bodies("lower_body", 131_072, "tree"),
            *(row for batch in (65_536, 4096, 256, 1) for row in tables(batch, "fused", "scan", "naive_scan")),
            *legs(4096, "chain", "mjx-jax"),
            *legs(256, "chain", "mjx-jax", "mujoco"),
            *legs(1_048_576, "chain"),
            *start_up("walk"),
        ]
    return [
        *bodies("lower_body", 4096, "tree", *others),
        *tables(65_536, "fused", "scan", "naive_scan", "numba"),
        training("walk_cpu"),
        *bodies("dog", 4096, "tree", *others),
        *legs(1024, "chain", "mjx-jax", "mjx-jax plain", "mujoco"),
        *learners,
        postures("chain"),
        postures("mjx-jax"),
        *start_up("joint1", "leg_reach", "walk_cpu"),
        *bodies("lower_body", 256, "tree", *others),
        *bodies("lower_body", 16, "tree", *others),
        *(row for batch in (4096, 1024) for row in tables(batch, "fused", "scan", "naive_scan", "numba")),
        *tables(1, "fused", "scan", "naive_scan", "numba", "python"),
        *legs(256, "chain", "mjx-jax", "mujoco"),
        *legs(16, "chain", "mjx-jax", "mujoco"),
        *legs(8192, "chain", "mjx-jax", "mujoco"),
    ]


def tables_row(name: str, batch: int) -> list[Record]:
    """Time tabular Q-learning of joint 1 as one of `tabular.SUBJECTS` or of `other_tables`."""
    if name == "fused" and (why := why_no_kernel(tabular.own_learner())):
        raise RuntimeError(why)
    make = tabular.SUBJECTS.get(name) or getattr(other_tables, name)
    return tabular.time_trainings(_say, batch, {name: make})


def bodies_row(robot: str, name: str, batch: int, steps: int | None = None) -> list[Record]:
    """Time a physics of robots that are thrown about, with the scene's contacts and iterations of MuJoCo's solver."""
    states, again = ground.states_of(batch, True, robot), 1
    slow = name == "mjx-jax" and jax.default_backend() == "cpu"
    steps = steps or (10 if slow else ground.MOVE_STEPS)
    if name == "mujoco":
        subject = opponents.native(states, steps, robot)
    else:
        again = AGAIN if name == "tree" and jax.default_backend() == "gpu" else 1
        subject = ground.compiled(name, states, steps, robot, again)
    device = "cpu" if name == "mujoco" else ""
    timed = Subject(subject, batch * steps * again, batch, REPEATS, device)
    return time_rates("physics", {f"{robot} {name}": timed}, _say, "robots")


def legs_row(name: str, batch: int) -> list[Record]:
    """Time legs in the air under computed torque with a wrong model, and in native MuJoCo without a controller."""
    gpu = jax.default_backend() == "gpu"
    steps, again, device, unit = 100 if gpu else 10, 1, "", CONTROLLED
    if name == "mujoco":
        steps, device, unit = 100, "cpu", PLAIN
        call = opponents.mujoco(batch, steps)
    elif name == "chain":
        steps, again = 500, AGAIN if gpu else 1
        call = leg.chain(batch, steps, again=again)
    else:
        call = opponents.mjx_jax(batch, steps, True)
    timed = Subject(call, batch * steps * again, batch, REPEATS, device, unit)
    return time_rates("physics", {f"legs {name}": timed}, _say, "legs")


def training_row(config: str, overrides: Sequence[str] = ()) -> list[Record]:
    """Train a config to its end, or for a while (`trainings.BRIEF`)."""
    found = trainings.run(_say, [config], overrides)
    if not any(record.unit == "steps/s" for record in found):
        raise RuntimeError("training was over at the first look")
    return found


def startup_row(config: str, repeats: int) -> list[Record]:
    """Start a sweep of a config, cold and warm."""
    return startup.run(_say, [config], repeats=repeats)


_say = partial(print, flush=True)


class Worker:
    """A process that measures rows, one at a time."""

    def __init__(self, kind: str) -> None:
        self._here, there = get_context("spawn").Pipe()
        self._process = get_context("spawn").Process(target=_serve, args=(there, kind))
        self._process.start()
        there.close()  # of this process, so that the other's death ends the pipe
        self.made_by = self.ask(START_S, compute.made_by)

    def ask(self, within: float, function: Callable[..., Any], *arguments: Any) -> Any:
        """Return what a function returns there.

        Raises:
          RuntimeError: it raised, took longer than `within` seconds, or the process died; in one sentence.
        """
        self._here.send((function, arguments))
        if not self._here.poll(within):
            self.end()
            raise RuntimeError(f"took longer than {within:.0f} s")
        try:
            failed, found = self._here.recv()
        except EOFError:
            self.end()
            raise RuntimeError(f"its process died with code {self._process.exitcode}") from None
        if failed:
            raise RuntimeError(found)
        return found

    @property
    def alive(self) -> bool:
        return self._process.is_alive()

    def end(self) -> None:
        self._process.kill()
        self._process.join()


def _serve(pipe: Connection, kind: str) -> None:
    compute.start(mjx=kind != "own")
    if kind == "plain":
        os.environ["XLA_FLAGS"] = os.environ["XLA_FLAGS"].replace(compute.XLA_FLAGS, "")
    while True:
        try:
            function, arguments = pipe.recv()
        except EOFError:
            return
        try:
            with trainings.nothing_compiled():
                answer = False, function(*arguments)
        except Exception as error:  # a row that cannot is a result
            answer = True, f"{type(error).__name__}: {error}".partition("\n")[0][:300]
        pipe.send(answer)


def publish(
    chosen: Sequence[str] = (),
    out: Path | None = None,
    command: str = "",
    commit: str = "",
    limit: float | None = None,
    within: float = 240.0,
) -> dict[str, Any]:
    """Measure the rows of some benchmarks, by default of all, and return the record.

    Args:
      out: the file, or a folder for `speed_cpu.json` or `speed_gpu.json`, where the record is written after every row;
        by default nowhere.
      command: the command that makes the record.
      commit: that of the record; by default what git says.
      limit: seconds after which no row starts.
      within: seconds that a row may take.
    """
    begun = time.perf_counter()
    workers = {"own": Worker("own")}
    try:
        made_by = workers["own"].made_by
        backend = made_by["machine"]["backend"]
        if out is not None and out.is_dir():
            out /= f"speed_{backend}.json"
        made_by |= {"commit": commit or made_by["commit"], "command": command}
        found: dict[str, Any] = {"scenes": {}, "records": [], "failed": []}
        for row in rows(backend):
            if chosen and row.bench not in chosen:
                continue
            start, why = time.perf_counter(), "measured"
            try:
                if limit is not None and start - begun > limit:
                    raise RuntimeError(f"not begun within {limit:.0f} s")
                if row.needs and find_spec(row.needs) is None:
                    raise RuntimeError(f"{row.needs} is not installed")
                if row.process not in workers or not workers[row.process].alive:
                    workers[row.process] = Worker(row.process)
                records = workers[row.process].ask(within, row.measure, *row.arguments)
                found["records"] += [record.as_json() for record in records]
                robot = row.subject.split()[0]
                if robot in ROBOTS and robot not in found["scenes"]:
                    found["scenes"][robot] = workers[row.process].ask(within, ground.contacts, robot)
            except RuntimeError as error:
                why = str(error)
                found["failed"].append({"bench": row.bench, "subject": row.subject, "batch": row.batch, "why": why})
            took, since = time.perf_counter() - start, time.perf_counter() - begun
            _say(f"{row!s:40} {why}, {took:.1f} s; {since:.0f} s in all")
            if out is not None:
                text = json.dumps(made_by | {"wall_s": round(since, 1)} | found, indent=1)
                write_text(out, text + "\n")
    finally:
        for worker in workers.values():
            worker.end()
    return made_by | found


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("names", nargs="*", metavar="NAME", help=f"some of {', '.join(BENCHES)}; by default all")
    parser.add_argument("--out", type=Path, default=BENCH, help="the record, or its folder")
    parser.add_argument("--commit", default="", help="the commit; by default what git says")
    parser.add_argument("--limit", type=float, help="s, after which no row starts")
    parser.add_argument("--within", type=float, default=240.0, help="s, the most that a row may take")
    asked = parser.parse_args()
    if odd := set(asked.names) - set(BENCHES):
        parser.error(f"unknown benchmark {odd.pop()!r}; choose from {', '.join(BENCHES)}")
    limits = {"--limit": asked.limit, "--within": asked.within}
    given = (f"{name} {value:g}" for name, value in limits.items() if value is not None)
    command = " ".join(["python benchmarks/publish.py", *asked.names, *given])
    publish(asked.names, asked.out, command, asked.commit, asked.limit, asked.within)


if __name__ == "__main__":
    main()
