"""The command `sweep --slurm`, which hands the sweep over to Slurm through submitit: an array of jobs, each with some
chunks of runs, for each rung of a sweep in mode halving, and a job that writes the tables when all have ended."""

import os
import shutil
import time
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from humanoid_mjx import compute
from humanoid_mjx.commands import console
from humanoid_mjx.commands.sweep import run_sweep
from humanoid_mjx.compute import kept
from humanoid_mjx.config import load, parse_yaml
from humanoid_mjx.runs.tables import all_runs, run_numbers
from humanoid_mjx.spec import InputError, package
from humanoid_mjx.training.chunks import Engine, chunks
from humanoid_mjx.training.plan import Plan, make_plan
from humanoid_mjx.training.progress import counted
from humanoid_mjx.training.sweep import open_folder, train_chunks
from humanoid_mjx.training.trackers import Tracking

GENERIC = {"name", "timeout_min", "mem_gb", "nodes", "cpus_per_task", "gpus_per_node", "tasks_per_node"}
"""Parameters that submitit has for every kind of cluster; all others are Slurm's own, such as `partition`."""

JOBS = 64
"""Jobs of an array by default."""

ANEW = 1000
"""Largest number of new beginnings of a job after time limits: in effect none, since it goes on from its state."""

LOGS = "slurm"
"""The folder in a run folder with the jobs' scripts and what they print."""


@dataclass(frozen=True)
class Job:
    """A job: it trains some chunks of a run folder, once the rung before is finished; the last one has none, and writes
    the tables of what the others have trained."""

    run: Path
    numbers: tuple[int, ...]
    after: tuple[int, ...] = ()
    """Processes to wait for, where no Slurm does."""
    trackers: tuple[str, ...] = ()

    def __call__(self) -> None:
        while any(map(_runs, self.after)):
            time.sleep(0.1)
        config = self.run / "config.yaml"
        if not self.numbers:
            run_sweep(str(config), self.run, [], True, self.trackers, engine=Engine)
            return
        compute.start(mjx="mjx-jax" in load(config).physics)
        with kept.keeping():
            train_chunks(self.run, self.numbers)

    def checkpoint(self) -> Any:
        """The job that Slurm begins anew after a time limit or preemption: the same, which goes on."""
        return package("submitit", "slurm", "--slurm").helpers.DelayedSubmission(self)


def submit_sweep(
    config: str, out: Path | None, overrides: Sequence[str], resume: bool, trackers: Sequence[str], given: Sequence[str]
) -> None:
    """`humanoid-mjx sweep --slurm`: make the run folder, or take one up, and submit the jobs that complete it.

    `given` are submitit's parameters as KEY=VALUE, and `jobs`, the number of jobs of the array; `cluster=local` runs
    them on this machine.

    Raises:
      InputError: submitit is missing or refuses, or the config or the place cannot be used. No new folder is left.
    """
    submitit, parameters = package("submitit", "slurm", "--slurm"), _parameters(given)
    Tracking(trackers, console.print)  # now rather than in the last job says what is missing
    loaded = load(config, overrides)
    if loaded.then:
        raise InputError(f"{config}: then: --slurm trains one part; train a config without it, and then start_from.")
    plan = make_plan(loaded)
    folder = open_folder(out, plan, resume, Engine(plan).at_once)
    place = folder.path
    try:
        jobs, last = _submit(submitit, parameters, plan, place, trackers)
    except Exception as error:  # submitit raises half a dozen kinds
        if not resume:
            shutil.rmtree(place)
        raise InputError(f"--slurm: {' '.join(str(error).split())}") from error
    finally:
        folder.close()
    first = f"{counted(len(jobs), 'job')} ({jobs[0].job_id}, ...) train {place}, and then " if jobs else ""
    console.print(
        f"{first}job {last.job_id} writes the tables of {place}; what they print is in {place / LOGS}", soft_wrap=True
    )


def _submit(
    submitit: Any, parameters: dict[str, Any], plan: Plan, place: Path, trackers: Sequence[str]
) -> tuple[list[Any], Any]:
    """Submit an array for each rung, and the job that follows them."""
    cluster, count = parameters.pop("cluster", "slurm"), parameters.pop("jobs", JOBS)
    if not isinstance(count, int) or count < 1:
        raise InputError(f"jobs must be a whole number of at least 1, got {count}.")
    limits = {f"{cluster}_max_num_timeout": ANEW} if cluster in ("slurm", "local") else {}
    executor = submitit.AutoExecutor(folder=place / LOGS, cluster=cluster, **limits)
    defaults = {"name": plan.config.name} | ({"timeout_min": 60 * 24 * 7} if cluster == "local" else {})
    executor.update_parameters(**defaults | parameters)
    more, run = parameters.get("slurm_additional_parameters", {}), place.absolute()
    jobs: list[Any] = []
    after: tuple[int, ...] = ()
    for left in _numbers(plan, place):
        with executor.batch():
            parts = np.array_split(np.array(left), min(count, len(left)))
            array = [executor.submit(Job(run, tuple(part.tolist()), after)) for part in parts]
        jobs += array
        if cluster == "local":
            after = tuple(int(job.job_id) for job in array)
        else:
            dependency = {"dependency": f"afterany:{array[0].job_id.partition('_')[0]}"}
            executor.update_parameters(slurm_additional_parameters=more | dependency)
    return jobs, executor.submit(Job(run, (), after, tuple(trackers)))


def _numbers(plan: Plan, place: Path) -> Iterator[list[int]]:
    """For each rung that is not finished, the numbers of chunks that may be left. Which points train at a later rung is
    not known yet; its chunks are no more than those of its runs in a row, and one for each further group."""
    done = run_numbers(all_runs(place, ("point", "seed")), len(plan.points), plan.config.seeds)
    left = [chunk.number for chunk in chunks(plan) if not np.isin(chunk.runs, done).all()]
    if left:
        yield left
    for index, rung in enumerate(plan.rungs[1:], 1):
        runs = rung.points * plan.config.seeds
        stored = np.count_nonzero(done // plan.config.seeds // len(plan.points) == index)
        if stored < runs:
            first, most = index * plan.num_runs, -(-runs // plan.chunk) + len(plan.groups) - 1
            yield list(range(first, first + most))


def _runs(process: int) -> bool:
    """True if a process of this machine runs."""
    try:
        os.kill(process, 0)
        return Path(f"/proc/{process}/stat").read_text().rpartition(")")[2].split()[0] != "Z"
    except FileNotFoundError:  # no Linux
        return True
    except OSError:
        return False


def _parameters(given: Sequence[str]) -> dict[str, Any]:
    """Parameters as submitit names them: those of Slurm alone begin with `slurm_`."""
    found: dict[str, Any] = {}
    for text in given:
        key, equals, value = text.partition("=")
        if not equals or not key.isidentifier():
            raise InputError(f"--slurm {text}: write KEY=VALUE, such as partition=gpu.")
        name = key if key in GENERIC or key in ("cluster", "jobs") else f"slurm_{key}"
        if name in found:
            raise InputError(f"--slurm {text}: {key} is given twice; leave one of them out.")
        found[name] = parse_yaml(value, f"--slurm {text}")
    return found
