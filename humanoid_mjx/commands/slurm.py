"""The command `sweep --slurm`, which hands the sweep over to Slurm through submitit."""

import importlib
import os
import shutil
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from humanoid_mjx.commands import console
from humanoid_mjx.commands.sweep import run_sweep
from humanoid_mjx.config import load, parse_yaml
from humanoid_mjx.runs.folder import RunFolder, fresh_path, latest_path
from humanoid_mjx.spec import InputError
from humanoid_mjx.training.plan import make_plan, resolved

GENERIC = {"name", "timeout_min", "mem_gb", "nodes", "cpus_per_task", "gpus_per_node", "tasks_per_node"}
"""Parameters that submitit has for every kind of cluster; all others are Slurm's own, such as `partition`."""

LOGS = "slurm"
"""The folder in a run folder with the job's script and what its processes print."""


@dataclass(frozen=True)
class Job:
    """A sweep as each task of a job runs it: it completes a run folder that was made when the job was submitted."""

    run: Path
    tensorboard: bool

    def __call__(self) -> None:
        job = _submitit().JobEnvironment()
        if job.cluster == "local":  # in a step of Slurm the environment says as much
            os.environ["JAX_COORDINATOR_ADDRESS"] = f"localhost:{49152 + int(job.job_id) % 16384}"
            os.environ["JAX_NUM_PROCESSES"] = str(job.num_tasks)
            os.environ["JAX_PROCESS_ID"] = str(job.global_rank)
        run_sweep(str(self.run / "config.yaml"), self.run, [], resume=True, tensorboard=self.tensorboard)

    def checkpoint(self) -> Any:
        """The job that Slurm begins anew after a time limit or preemption: the same, which goes on."""
        return _submitit().helpers.DelayedSubmission(self)


def submit_sweep(
    config: str, out: Path | None, overrides: Sequence[str], resume: bool, tensorboard: bool, given: Sequence[str]
) -> None:
    """`humanoid-mjx sweep --slurm`: make the run folder, or take one up, and submit the job that completes it.

    `given` are submitit's parameters as KEY=VALUE; `cluster=local` runs the job on this machine.

    Raises:
      InputError: submitit is missing or refuses, or the config or the place cannot be used. No new folder is left.
    """
    submitit, parameters = _submitit(), _parameters(given)
    plan = make_plan(load(config, overrides))
    place = Path(out or (latest_path if resume else fresh_path)(plan.config.name))
    (RunFolder.resume if resume else RunFolder.create)(place, resolved(plan.config)).close()
    try:
        executor = submitit.AutoExecutor(folder=place / LOGS, cluster=parameters.pop("cluster", "slurm"))
        executor.update_parameters(**{"name": plan.config.name} | parameters)
        job = executor.submit(Job(place.absolute(), tensorboard))
    except Exception as error:  # submitit raises half a dozen kinds
        if not resume:
            shutil.rmtree(place)
        raise InputError(f"--slurm: {' '.join(str(error).split())}") from error
    console.print(f"job {job.job_id} completes {place} and prints into {place / LOGS}", soft_wrap=True)


def _parameters(given: Sequence[str]) -> dict[str, Any]:
    """Parameters as submitit names them: those of Slurm alone begin with `slurm_`."""
    found: dict[str, Any] = {}
    for text in given:
        key, equals, value = text.partition("=")
        if not equals or not key.isidentifier():
            raise InputError(f"--slurm {text}: write KEY=VALUE, such as partition=gpu.")
        name = key if key in GENERIC or key == "cluster" else f"slurm_{key}"
        if name in found:
            raise InputError(f"--slurm {text}: {key} is given twice; leave one of them out.")
        found[name] = parse_yaml(value, f"--slurm {text}")
    return found


def _submitit() -> Any:
    try:
        return importlib.import_module("submitit")
    except ImportError as error:
        raise InputError("--slurm needs the package submitit; pip install 'humanoid-mjx[slurm]' brings it.") from error
