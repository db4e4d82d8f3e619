"""Sweeps in processes of their own: on several devices, interrupted and resumed to the same bits."""

import os
import signal
import subprocess
import sys
import time

import pytest
from small_sweep import CONFIG, LONG, assert_same_tables, run_cli, write_config

from humanoid_mjx import sweep
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
from humanoid_mjx.training import chunks, pool, session
session.TABLES_AFTER_S, session.TABLES_SHARE = 0.0, 1.0
chunks.CHECKPOINT_EVERY_S, pool.CHUNK_S, pool.HARVEST_SHARE, pool.HARVEST_AFTER_S = 0.05, 0.02, 0.1, 0.5
from humanoid_mjx.cli import main
main()
"""


def start(arguments, cwd, program=KILLABLE, **environment):
    command = [sys.executable, "-c", program, *arguments]
    pipes = {"stdout": subprocess.PIPE, "stderr": subprocess.PIPE, "text": True}
    return subprocess.Popen(command, cwd=cwd, env=os.environ | environment, **pipes)


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
from humanoid_mjx.training import chunks
keep = chunks.Work._keep
def keep_and_wait(self, pool):
    keep(self, pool)
    if len(self.left) < self.together:
        pathlib.Path("halfway").touch()
        self.stopped.wait()
chunks.Work._keep = keep_and_wait
{KILLABLE}"""
"""A process that stays where some of its runs are finished and others stored half done, however busy the machine is."""


@pytest.mark.parametrize("kill", [signal.SIGKILL, signal.SIGINT])
def test_an_interrupted_sweep_resumes_to_the_same_bits(whole, tmp_path, kill):
    config = write_config(tmp_path, **LONG)
    process = start(["sweep", config, "--out", "run"], tmp_path, HALFWAY)
    run = tmp_path / "run"
    wait_for(lambda: (tmp_path / "halfway").exists() and (run / "summary.parquet").exists(), process)
    process.send_signal(kill)
    process.communicate(timeout=PATIENCE_S)
    assert process.returncode == (130 if kill == signal.SIGINT else -9)
    found = len(Run(run).summary["point"])
    assert 0 < found < 90
    resumed = run_cli("sweep", config, "--out", "run", "--resume", cwd=tmp_path)
    assert resumed.returncode == 0, resumed.stderr
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
