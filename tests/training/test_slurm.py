"""Sweeps in the hands of Slurm, by submitit's local mode: the same code, with processes of this machine as jobs."""

import os
import sys
from pathlib import Path

import numpy as np
import pytest
from small_sweep import CONFIG, LONG, assert_same_tables, write_config

from humanoid_mjx import InputError, compute, sweep
from humanoid_mjx.commands.slurm import Job, submit_sweep
from humanoid_mjx.config import parse
from humanoid_mjx.runs.folder import RunFolder, parts, pools, read_arrays
from humanoid_mjx.runs.listing import look_at
from humanoid_mjx.training import chunks, pool
from humanoid_mjx.training.plan import make_plan
from humanoid_mjx.training.session import Session
from humanoid_mjx.training.sweep import Run, train_chunks

try:
    # Before any test: it closes all handlers of logs, and that of absl then closes what pytest captures them with.
    import submitit
except ImportError:
    submitit = None

ARRAY = CONFIG | LONG | {"seeds": 6, "chunk": 6}
HALVING = ARRAY | {"sweep": CONFIG["sweep"] | {"mode": "halving", "eta": 2, "rungs": 2}}


@pytest.fixture(scope="module")
def whole(tmp_path_factory):
    return sweep(ARRAY, tmp_path_factory.mktemp("whole") / "run").path


@pytest.mark.skipif(submitit is None, reason="needs submitit")
def test_an_array_for_each_rung_trains_the_bits_of_this_process(tmp_path, monkeypatch, said):
    monkeypatch.setenv("JAX_NUM_CPU_DEVICES", "1")
    monkeypatch.chdir(tmp_path)
    whole = sweep(HALVING, tmp_path / "whole").path
    run = submitted(write_config(tmp_path, **HALVING), 2, said)
    assert_same_tables(run, whole)
    assert look_at(run).state == "finished" and (run / "figures").is_dir()


def test_a_rung_waits_for_the_runs_that_decide_which_points_train(tmp_path):
    run, plan = tmp_path / "run", make_plan(parse(HALVING))
    RunFolder.create(run, plan.resolved()).close()
    for trained in ([], [0]):
        train_chunks(run, trained)
        with pytest.raises(InputError, match=r"run: \d+ of 36 runs of rung 1 are not finished, and their results"):
            train_chunks(run, [plan.num_runs])


def submitted(config, jobs, said):
    """Submit a sweep of two rungs as arrays of so many local jobs, wait for them, and return its run folder."""
    code, out, err = said("sweep", config, "--slurm", "cluster=local", "--slurm", f"jobs={jobs}")
    run = Path("runs/small")
    assert code == 0 and out.startswith(f"{2 * jobs} jobs (") and f"what they print is in {run / 'slurm'}" in out, err
    pickles = [*run.glob("slurm/*_submitted.pkl")]
    for pickle in pickles:
        os.waitpid(int(pickle.name.partition("_")[0]), 0)
    logs = "".join(path.read_text() for path in run.glob("slurm/*log*"))
    assert logs.count("Job completed successfully") == len(pickles) == 2 * jobs + 1, logs
    return run


@pytest.mark.skipif(submitit is None, reason="needs submitit")
def test_a_job_that_slurm_interrupts_stores_its_state_and_goes_on_from_it(whole, tmp_path, monkeypatch):
    """Slurm's signal comes as a SystemExit, here with the first state that is stored."""
    run, plan = tmp_path / "run", make_plan(parse(ARRAY))
    RunFolder.create(run, plan.resolved()).close()
    take = Session.take

    def interrupted(self, event):
        take(self, event)
        if isinstance(event, chunks.State) and event.arrays["progress"].any():
            raise SystemExit

    with monkeypatch.context() as patch:
        patch.setattr(Session, "take", interrupted)
        patch.setattr(chunks, "CHECKPOINT_EVERY_S", 0.0)
        patch.setattr(pool, "MAX_STEPS", 8)
        with pytest.raises(SystemExit):
            train_chunks(run, range(3))
    (stored,) = pools(run)
    assert 0 < np.mean(read_arrays(stored)["progress"]) < 1 and not parts(run)
    again = Job(run, (0, 1, 2)).checkpoint()
    assert again.function == Job(run, (0, 1, 2))
    monkeypatch.setattr(compute, "start", lambda **_: None)
    restore, restored = pool.Pool.restore, []
    monkeypatch.setattr(
        pool.Pool, "restore", lambda self, *given: (restore(self, *given), restored.append(self.progress))
    )
    again.function()
    assert restored[0].any()
    train_chunks(run, [3, 4, 5])
    assert_same_tables(sweep(ARRAY, run, resume=True, engine=chunks.Engine).path, whole)


def test_jobs_share_a_run_folder_and_the_last_one_says_what_is_missing(whole, tmp_path):
    run, plan = tmp_path / "run", make_plan(parse(ARRAY))
    RunFolder.create(run, plan.resolved()).close()
    other = RunFolder.resume(run, plan.resolved(), shared=True)
    train_chunks(run, [0, 2])
    with pytest.raises(InputError, match="run: is in use by another process"):
        sweep(ARRAY, run, resume=True)
    other.close()
    with pytest.raises(InputError, match=r"24 of 36 runs are not finished; the same command with resume=True"):
        sweep(ARRAY, run, resume=True, engine=chunks.Engine)
    assert len(Run(run).summary["point"]) == 12
    train_chunks(run, [1, 3, 4, 5])
    assert_same_tables(sweep(ARRAY, run, resume=True, engine=chunks.Engine).path, whole)


@pytest.mark.skipif(submitit is None, reason="needs submitit")
def test_what_cannot_be_submitted_leaves_no_folder(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    config = write_config(tmp_path)
    for given, words in {
        "nodes": "KEY=VALUE",
        "nodes=3": "only one node",
        "nodes=1 nodes=2": "given twice",
        "nodes=two": "expected type",
        "jobs=0": "jobs must be a whole number of at least 1, got 0",
    }.items():
        with pytest.raises(InputError, match=f"^--slurm.*{words}"):
            submit_sweep(config, None, [], False, [], ["cluster=local", *given.split()])
    with pytest.raises(InputError, match="unknown tracker 'wand'"):
        submit_sweep(config, None, [], False, ["wand"], ["cluster=local"])
    assert not list(tmp_path.rglob("runs/*"))


def test_a_missing_submitit_is_named(tmp_path, monkeypatch):
    monkeypatch.setitem(sys.modules, "submitit", None)
    with pytest.raises(InputError, match=r"needs the package submitit; pip install 'humanoid-mjx\[slurm\]'"):
        submit_sweep(write_config(tmp_path, **CONFIG), tmp_path / "run", [], False, [], ["nodes=2"])
    assert not (tmp_path / "run").exists()
