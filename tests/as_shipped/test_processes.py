"""Sweeps in processes of their own: on several devices, in several processes, interrupted and resumed to the same
bits."""

import json
import os
import random
import signal
import subprocess
import sys
import time

import pytest
from small_sweep import CONFIG, LONG, assert_same_tables, run_cli, write_config

from humanoid_mjx import InputError, sweep
from humanoid_mjx.compute import processes
from humanoid_mjx.runs.folder import parts as parts_of
from humanoid_mjx.runs.folder import read_arrays
from humanoid_mjx.training.sweep import Run


@pytest.fixture(scope="module")
def reference(tmp_path_factory):
    return sweep(CONFIG, tmp_path_factory.mktemp("reference") / "run")


@pytest.mark.parametrize("devices", ["1", "3"])
def test_number_of_devices_changes_no_bit(reference, tmp_path, devices):
    done = run_cli("sweep", write_config(tmp_path), "--out", "run", cwd=tmp_path, devices=devices)
    assert done.returncode == 0, done.stderr
    assert_same_tables(tmp_path / "run", reference.path)
    assert {path.name for path in (tmp_path / "run/figures").iterdir()} >= {"learning_curves.png"}


KILLABLE = """
import signal, sys
signal.signal(signal.SIGINT, signal.default_int_handler)  # a suite in the background of a shell ignores it
from humanoid_mjx.training import pool, session
session.CHECKPOINT_EVERY_S, pool.CHUNK_S, pool.HARVEST_SHARE, pool.HARVEST_AFTER_S = 0.05, 0.02, 0.1, 0.5
from humanoid_mjx.cli import main
main()
"""


def start(arguments, cwd, program=KILLABLE, **environment):
    command = [sys.executable, "-c", program, *arguments]
    pipes = {"stdout": subprocess.PIPE, "stderr": subprocess.PIPE, "text": True}
    return subprocess.Popen(command, cwd=cwd, env=os.environ | environment, **pipes)


def start_job(arguments, cwd, count=2, slurm=False, programs=None):
    """So many processes that share a sweep, each with one device; `slurm`: told of each other as by its `srun`."""
    port = str(random.randrange(20_000, 32_000))  # below those that the system gives to outgoing connections
    if slurm:
        job = {"SLURM_JOB_ID": "1", "SLURM_STEP_NODELIST": "localhost", "SLURM_STEP_NUM_NODES": str(count)}
        job |= {"SLURM_NTASKS": str(count), "SLURM_LOCALID": "0", "JAX_COORDINATOR_PORT": port}
    else:
        job = {"JAX_COORDINATOR_ADDRESS": f"localhost:{port}", "JAX_NUM_PROCESSES": str(count)}
    number = "SLURM_PROCID" if slurm else "JAX_PROCESS_ID"
    job["JAX_NUM_CPU_DEVICES"] = "1"
    programs = programs or [KILLABLE] * count
    return [start(arguments, cwd, program, **job, **{number: str(i)}) for i, program in enumerate(programs)]


PATIENCE_S = 1200
"""Seconds that a busy machine may take for what takes seconds on one that is not."""


def wait_for(condition, process):
    until = time.monotonic() + PATIENCE_S
    while not condition():
        assert process.poll() is None and time.monotonic() < until, process.communicate()
        time.sleep(0.02)


@pytest.fixture(scope="module")
def whole(tmp_path_factory):
    """The run folder of a sweep that nothing interrupts."""
    folder = tmp_path_factory.mktemp("whole")
    done = run_cli("sweep", write_config(folder, **LONG), "--out", "run", cwd=folder)
    assert done.returncode == 0, done.stderr
    return folder / "run"


HALFWAY = f"""
import pathlib
from humanoid_mjx.training import session
store = session.Session._store_under_way
def store_and_wait(self, index, pool):
    store(self, index, pool)
    if self.finished:
        pathlib.Path(f"halfway-{{self.processes.index}}").touch()
        self.stop.wait()
session.Session._store_under_way = store_and_wait
{KILLABLE}"""
"""A process that stays where some of its runs are finished and others stored half done, however busy the machine is."""


@pytest.mark.parametrize("kill", [signal.SIGKILL, signal.SIGINT])
def test_an_interrupted_sweep_resumes_to_the_same_bits(whole, tmp_path, kill):
    config = write_config(tmp_path, **LONG)
    process = start(["sweep", config, "--out", "run"], tmp_path, HALFWAY)
    run = tmp_path / "run"
    wait_for(lambda: (tmp_path / "halfway-0").exists() and (run / "summary.parquet").exists(), process)
    process.send_signal(kill)
    process.communicate(timeout=PATIENCE_S)
    assert process.returncode == (130 if kill == signal.SIGINT else -9)
    found = len(Run(run).summary["point"])
    assert 0 < found < 90
    resumed = run_cli("sweep", config, "--out", "run", "--resume", cwd=tmp_path)
    assert resumed.returncode == 0, resumed.stderr
    assert_same_tables(run, whole)
    assert not list(run.glob("checkpoint/pool-*.npz")) and not list(run.rglob(".new-*"))


def test_number_of_processes_changes_no_bit(reference, tmp_path):
    job = start_job(["sweep", write_config(tmp_path), "--out", "run"], tmp_path, slurm=True)
    (stdout, stderr), (silence, other) = (process.communicate(timeout=PATIENCE_S) for process in job)
    assert [process.returncode for process in job] == [0, 0], stderr + other
    assert "9 of 9 runs train side by side in process 0 of 2" in stdout and silence == ""
    assert_same_tables(tmp_path / "run", reference.path)
    provenance = json.loads((tmp_path / "run/provenance.json").read_text())
    assert provenance["processes"] == 2 and provenance["runs_finished"] == 18
    parts = [read_arrays(path) for path in parts_of(tmp_path / "run")]
    shares = [set((part["point"] * 3 + part["seed"]) % 2) for part in parts]
    assert {0} in shares and {1} in shares


@pytest.mark.parametrize(
    ("given", "words"),
    [
        ({"JAX_COORDINATOR_ADDRESS": "here:1"}, ["JAX_PROCESS_ID is not set"]),
        ({"JAX_COORDINATOR_ADDRESS": "here:1", "JAX_PROCESS_ID": "one"}, ["whole numbers, got 2 and one"]),
        ({"JAX_COORDINATOR_ADDRESS": "here:1", "JAX_PROCESS_ID": "2"}, ["JAX_PROCESS_ID at least 0 and less than"]),
        ({"JAX_COORDINATOR_ADDRESS": "here", "JAX_PROCESS_ID": "1"}, ["JAX_COORDINATOR_ADDRESS must be HOST:PORT"]),
    ],
)
def test_an_environment_that_contradicts_itself_is_refused(monkeypatch, given, words):
    for name, value in ({"JAX_NUM_PROCESSES": "2"} | given).items():
        monkeypatch.setenv(name, value)
    with pytest.raises(InputError) as error, processes.joined():
        pass
    assert all(word in str(error.value) for word in words) and "\n" not in str(error.value)


def test_what_process_0_refuses_all_refuse(reference, tmp_path):
    (tmp_path / "run").mkdir()
    (tmp_path / "run" / "precious").write_text("data")
    job = start_job(["sweep", write_config(tmp_path), "--out", "run"], tmp_path)
    for process in job:
        _, stderr = process.communicate(timeout=PATIENCE_S)
        assert process.returncode == 2 and "already exists and is no run folder" in stderr, stderr
    assert [path.name for path in (tmp_path / "run").iterdir()] == ["precious"]


@pytest.mark.parametrize("lost", [0, 1])
def test_a_job_that_lost_a_process_resumes_to_the_same_bits(whole, tmp_path, lost):
    arguments = ["sweep", write_config(tmp_path, **LONG), "--out", "run"]
    # Process 0 finishes its runs if it is left, and so does a third process.
    programs = [KILLABLE, HALFWAY, KILLABLE] if lost == 1 else [HALFWAY, HALFWAY]
    programs = ["from humanoid_mjx.compute import processes\nprocesses.HEARTBEAT_S = 10\n" + each for each in programs]
    job, run = start_job(arguments, tmp_path, count=len(programs), programs=programs), tmp_path / "run"
    wait_for((tmp_path / f"halfway-{lost}").exists, job[lost])
    job[lost].kill()
    for process in job[:lost] + job[lost + 1 :]:  # what it has to do it does, and says what is missing
        _, stderr = process.communicate(timeout=PATIENCE_S)
        words = (
            f"error: process {lost} of this job was lost; "
            if lost
            else "error: jax aborts this process, as it does when process 0 is lost; "
        )
        assert process.returncode == (2 if lost else -signal.SIGABRT), stderr
        assert stderr.splitlines()[-1].startswith(words), stderr
    if lost == 1:
        summary = Run(run).summary
        runs = summary["point"] * 15 + summary["seed"]
        assert len(runs) < 90 and {run for run in range(90) if run % 3 != 1} <= set(runs)
    again = start_job([*arguments, "--resume"], tmp_path, count=1 + lost)
    ends = [process.communicate(timeout=PATIENCE_S) for process in again]
    assert not any(process.returncode for process in again), ends
    assert_same_tables(run, whole)
    assert not list(run.glob("checkpoint/pool-*.npz")) and not list(run.rglob(".new-*"))


WAITING = f"""
import pathlib, time
from humanoid_mjx.compute import kept
from humanoid_mjx.training import pool
compile_program, finish = kept.compile_program, pool.Pool.finish
def compile_slowly(name, *given):
    return time.sleep({2 * PATIENCE_S}) if name == "finish" else compile_program(name, *given)
kept.compile_program, kept.find = compile_slowly, lambda name, about: None
def told(self):
    pathlib.Path("waiting").touch()
    return finish(self)
pool.Pool.finish = told
{KILLABLE}"""


def test_an_interrupt_is_answered_while_the_end_of_runs_compiles(reference, tmp_path):
    config = write_config(tmp_path)
    process = start(["sweep", config, "--out", "run"], tmp_path, WAITING)
    wait_for((tmp_path / "waiting").exists, process)
    process.send_signal(signal.SIGINT)
    stdout, stderr = process.communicate(timeout=PATIENCE_S)  # the compiler would take twice as long
    assert process.returncode == 130 and "--resume completes it" in stdout, stderr
    resumed = run_cli("sweep", config, "--out", "run", "--resume", cwd=tmp_path)
    assert resumed.returncode == 0, resumed.stderr
    assert_same_tables(tmp_path / "run", reference.path)
