"""Sweeps in the hands of Slurm, by submitit's local mode: the same code, with processes of this machine as tasks."""

import os
import signal
import sys
import time
from pathlib import Path

import pytest
from small_sweep import CONFIG, LONG, assert_same_tables, write_config

from humanoid_mjx import InputError, sweep
from humanoid_mjx.cli import main
from humanoid_mjx.commands.slurm import submit_sweep
from humanoid_mjx.runs.folder import parts
from humanoid_mjx.runs.listing import look_at

try:
    # Before any test: it closes all handlers of logs, and that of absl then closes what pytest captures them with.
    import submitit
except ImportError:
    submitit = None

LOCAL = ["--slurm", "cluster=local", "--slurm", "tasks_per_node=2"]


def children(pid):
    return [int(child) for child in Path(f"/proc/{pid}/task/{pid}/children").read_text().split()]


@pytest.mark.skipif(submitit is None, reason="needs submitit")
def test_a_job_that_slurm_interrupts_begins_anew_and_completes_its_run_folder(tmp_path, monkeypatch, capfd):
    config = CONFIG | LONG | {"seeds": 6}
    whole = sweep(config, tmp_path / "whole")
    monkeypatch.chdir(tmp_path)
    monkeypatch.setenv("JAX_NUM_CPU_DEVICES", "1")
    monkeypatch.setattr(sys, "argv", ["humanoid-mjx", "sweep", write_config(tmp_path, **config), *LOCAL])
    with pytest.raises(SystemExit) as ended:
        main()
    run, said = Path("runs/small"), capfd.readouterr().out
    assert ended.value.code == 0 and f"completes {run} and prints into {run / 'slurm'}" in said
    job = int(said.split()[1])
    until = time.monotonic() + 1200
    while not parts(run):
        assert time.monotonic() < until, [path.read_text() for path in run.glob("slurm/*log*")]
        time.sleep(0.02)
    os.kill(children(job)[0], signal.SIGUSR2)  # as Slurm does some time before its limit
    os.waitpid(job, 0)
    logs = "".join(path.read_text() for path in run.glob("slurm/*.out"))
    assert "Calling checkpoint method" in logs and logs.count("Job completed successfully") == 2, logs
    assert_same_tables(run, whole.path)
    assert look_at(run).state == "finished"


@pytest.mark.skipif(submitit is None, reason="needs submitit")
def test_what_cannot_be_submitted_leaves_no_folder(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    config = write_config(tmp_path)
    for given, words in {
        "nodes": "KEY=VALUE",
        "nodes=3": "only one node",
        "nodes=1 nodes=2": "given twice",
        "nodes=two": "expected type",
    }.items():
        with pytest.raises(InputError, match=f"^--slurm.*{words}"):
            submit_sweep(config, None, [], False, False, ["cluster=local", *given.split()])
    assert not list(tmp_path.rglob("runs/*"))


def test_a_missing_submitit_is_named(tmp_path, monkeypatch):
    monkeypatch.setitem(sys.modules, "submitit", None)
    with pytest.raises(InputError, match=r"needs the package submitit; pip install 'humanoid-mjx\[slurm\]'"):
        submit_sweep(write_config(tmp_path, **CONFIG), tmp_path / "run", [], False, False, ["nodes=2"])
    assert not (tmp_path / "run").exists()
