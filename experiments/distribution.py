"""Train the same sweeps in this process, on Ray and as an array of local jobs, with kills, and compare the tables.

python experiments/distribution.py [--kills 10] [--stop 60] [FILE.json]

Each sweep is a whole command; Ray's machines are nodes of `ray.cluster_utils.Cluster` on this one. A case says whether
its tables are those of the sweep in one process with one device, byte by byte, its exit code and its seconds. The last
case counts the seconds in which two workers share uneven runs.
"""

import argparse
import json
import os
import re
import signal
import subprocess
import sys
import tempfile
import threading
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager, suppress
from pathlib import Path
from typing import Any

import numpy as np

from humanoid_mjx import compute
from humanoid_mjx.runs.folder import parts
from humanoid_mjx.training.on_ray import SETTINGS

TABLES = ("results.parquet", "summary.parquet")
SWEEPS = {
    "joint1": ["seeds=4", "episodes=4000", "chunk=40"],
    "leg_reach": ["seeds=4", "total_steps=100000", "learner.evaluation_envs=64", "learner.evaluations=2", "record=10"],
}
UNEVEN = ["sweep.axes.learner.discount=[0.5,0.97]", "sweep.axes.learner.learning_rate=[0.5]", "seeds=4", "chunk=5"]
UNEVEN += ["sweep.axes.learner.epsilon={linspace: [0.1, 1.0, 10]}", "sweep.axes.learner.epsilon_decay=[0.99]"]
ARRAY = ["--slurm", "cluster=local", "--slurm", "jobs=3"]


class Sweep:
    """A command that trains, and what it prints."""

    def __init__(self, config: str, settings: list[str], out: Path, *options: str):
        words = [word for setting in settings for word in ("--set", setting)]
        command = [sys.executable, "-m", "humanoid_mjx", "sweep", config, *words, "--out", str(out), *options]
        self.out, self.began, self.lines = out, time.monotonic(), list[str]()
        streams: dict[str, Any] = {"stdout": subprocess.PIPE, "stderr": subprocess.STDOUT, "text": True}
        self.process = subprocess.Popen(command, env=os.environ | {"JAX_NUM_CPU_DEVICES": "1"}, **streams)
        self.reader = threading.Thread(target=lambda: self.lines.extend(self.process.stdout or ()), daemon=True)
        self.reader.start()

    @property
    def workers(self) -> list[int]:
        """The processes of Ray that have begun and are not lost."""
        found = [re.match(r"worker \S+:(\d+) (trains|was lost)", line) for line in self.lines]
        lost = {each[1] for each in found if each and each[2] == "was lost"}
        return [int(each[1]) for each in found if each and each[1] not in lost]

    def end(self, whole: Path) -> dict[str, Any]:
        """Wait for the end, for an array also for that of its last job; what came of it."""
        code = self.process.wait()
        self.reader.join()
        if pickles := list(self.out.glob("slurm/*_submitted.pkl")):
            results = [Path(str(each).replace("_submitted", "_0_result")) for each in pickles]
            while not all(each.exists() for each in results):
                time.sleep(0.2)
        same = all((self.out / name).read_bytes() == (whole / name).read_bytes() for name in TABLES)
        lost = sum("was lost" in line for line in self.lines)
        return {"same": same, "code": code, "seconds": round(time.monotonic() - self.began, 1), "lost": lost}


@contextmanager
def cluster(*cpus: int) -> Iterator[Any]:
    """A cluster of nodes on this machine, bound to loopback, each with so many workers."""
    from ray.cluster_utils import Cluster

    node = {"include_dashboard": False, "object_store_memory": 200 << 20}
    found = Cluster(initialize_head=True, head_node_args=node | {"num_cpus": 0})
    for count in cpus:
        found.add_node(num_cpus=count, object_store_memory=200 << 20)
    try:
        yield found
    finally:
        found.shutdown()


def disturb(sweep: Sweep, count: int, act: Callable[[int], None]) -> int:
    """Act on a worker by chance, so often as long as the sweep lasts, each time after more is stored; how often."""
    rng, done, stored = np.random.default_rng(0), 0, 0
    while done < count and sweep.process.poll() is None:
        time.sleep(rng.uniform(0.2, 2.0))
        if (workers := sweep.workers) and len(parts(sweep.out)) > stored:
            stored = len(parts(sweep.out))
            with suppress(ProcessLookupError):
                act(int(rng.choice(workers)))
                done += 1
    return done


def killed(config: str, settings: list[str], out: Path, options: tuple[str, ...], begun: int) -> None:
    """Kill the driver of a sweep with SIGKILL as soon as so many parts are stored."""
    sweep = Sweep(config, settings, out, *options)
    while len(parts(out)) < begun and sweep.process.poll() is None:
        time.sleep(0.05)
    sweep.process.kill()
    sweep.process.wait()


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("file", type=Path, nargs="?")
    parser.add_argument("--kills", type=int, default=10)
    parser.add_argument("--stop", type=float, default=60.0)
    given = parser.parse_args()
    os.environ.update(SETTINGS)
    cases: list[dict[str, Any]] = []

    def case(name: str, found: dict[str, Any]) -> None:
        cases.append({"case": name} | found)
        print(cases[-1], flush=True)

    with tempfile.TemporaryDirectory() as folder:
        place = Path(folder)
        for config, settings in SWEEPS.items():
            whole = place / config
            Sweep(config, settings, whole).end(whole)
            for count in (1, 2, 3):
                with cluster(count) as ray:
                    sweep = Sweep(config, settings, place / f"{config}-{count}", "--ray", ray.address)
                    case(f"{config}, Ray, {count} workers", sweep.end(whole))
            case(f"{config}, array of 3 jobs", Sweep(config, settings, place / f"{config}-array", *ARRAY).end(whole))
        config, settings = "joint1", SWEEPS["joint1"]
        whole = place / config
        with cluster(2) as ray:
            on_ray = ("--ray", ray.address)
            sweep = Sweep(config, settings, place / "kills", *on_ray)
            times = disturb(sweep, given.kills, lambda pid: os.kill(pid, signal.SIGKILL))
            case(f"SIGKILL of a worker, {times} times", sweep.end(whole))
            sweep = Sweep(config, settings, place / "stopped", *on_ray)

            def stop(pid: int) -> None:
                os.kill(pid, signal.SIGSTOP)
                time.sleep(given.stop)
                os.kill(pid, signal.SIGCONT)

            disturb(sweep, 1, stop)
            case(f"a worker stopped for {given.stop:.0f} s", sweep.end(whole))
            for name, options in {"here": (), "Ray": on_ray, "array": tuple(ARRAY)}.items():
                killed(config, settings, place / f"driver-{name}", on_ray, 2)
                again = Sweep(config, settings, place / f"driver-{name}", "--resume", *options)
                case(f"SIGKILL of the driver, --resume: {name}", again.end(whole))
        with cluster(1, 1) as ray:
            sweep = Sweep(config, settings, place / "nodes", "--ray", ray.address)
            while len(sweep.workers) < 2:
                time.sleep(0.1)
            time.sleep(2.0)
            ray.remove_node(next(iter(ray.worker_nodes)), allow_graceful=False)
            ray.add_node(num_cpus=1, object_store_memory=200 << 20)
            case("a node leaves, another joins", sweep.end(whole) | {"workers": len(sweep.workers)})
        with cluster(2) as ray:
            whole = place / "uneven"
            here = Sweep(config, [*UNEVEN, "episodes=20000"], whole).end(whole)
            shared = Sweep(config, [*UNEVEN, "episodes=20000"], place / "uneven-ray", "--ray", ray.address)
            case("80 uneven runs, 2 workers", shared.end(whole) | {"one_process_s": here["seconds"]})
    if given.file:
        given.file.write_text(json.dumps(compute.made_by() | {"cases": cases}, indent=1) + "\n")
    sys.exit(not all(each["same"] and each["code"] == 0 for each in cases))


if __name__ == "__main__":
    main()
