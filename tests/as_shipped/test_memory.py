"""The estimate of what training takes, against what XLA says of the compiled programs."""

import os
import subprocess
import sys
from pathlib import Path

import jax
import jax.numpy as jnp
import pytest
from command_line import told

from humanoid_mjx import InputError, compute
from humanoid_mjx.compute import limits
from humanoid_mjx.config import load
from humanoid_mjx.training.cost import runs_at_once, training_bytes
from humanoid_mjx.training.plan import make_plan
from humanoid_mjx.training.programs import placement, programs_of

SMALL = ["learner.evaluation_envs=32"]


@pytest.mark.parametrize(
    "config", [("leg_reach", "learner.envs=1024", *SMALL), ("leg_reach_linear", "learner.envs=1024", *SMALL)]
)
def test_the_estimate_is_what_xla_takes_within_a_factor_of_two(config):
    name, *overrides = config
    (group,) = make_plan(load(name, overrides)).groups
    runs = 2
    learners = jax.tree.map(lambda x: jax.ShapeDtypeStruct((runs, *x.shape[1:]), x.dtype), group.learners)
    training = jax.tree.map(lambda x: jax.ShapeDtypeStruct((runs, *x.shape), x.dtype), group.one_run)
    train = programs_of(group.learners, jax.local_devices()[:1]).advance
    memory = train.lower(learners, training, jax.ShapeDtypeStruct((), jnp.int32)).compile().memory_analysis()
    peak = memory.argument_size_in_bytes + memory.output_size_in_bytes - memory.alias_size_in_bytes
    ratio = runs * training_bytes(group) / (peak + memory.temp_size_in_bytes)
    assert 0.5 < ratio < 2.0, ratio


TOO_LARGE = ["learner.envs=65536", "learner.rollout=128", "learner.width=1024", "learner.minibatches=1"]


def test_what_is_too_large_for_memory_is_refused_with_what_the_system_says(monkeypatch):
    (group,) = make_plan(load("leg_reach", TOO_LARGE)).groups
    free = 7 << 30
    monkeypatch.setattr(compute, "available_memory", lambda: free)
    said = r"one run needs about ([\d,]+) MiB, more than 80% of the 7,168 MiB that are free; make the task"
    with pytest.raises(InputError, match=said):
        runs_at_once(group)
    shown = told("info", "leg_reach", *(word for each in TOO_LARGE for word in ("--set", each)))
    assert "80% of the 7,168 MiB that are free" in " ".join(shown.split())
    free = int(training_bytes(group) / 0.8) + 2
    assert runs_at_once(group) == 1
    size, devices = placement(group.learners, 5, 1)
    assert size == 1 and devices == jax.local_devices()[:1]


MANY_CORES = """
import jax
from humanoid_mjx import compute
from humanoid_mjx.config import load
from humanoid_mjx.training.cost import runs_at_once, training_bytes
from humanoid_mjx.training.plan import make_plan
from humanoid_mjx.training.programs import placement

compute.start()
assert jax.local_device_count() == 16
for name in ("stand", "walk"):
    (group,) = make_plan(load(name)).groups
    compute.available_memory = lambda: 2 << 30
    assert runs_at_once(group) == int(0.8 * 2**31) // training_bytes(group) < 16
    size, devices = placement(group.learners, 100, runs_at_once(group))
    assert size == 1 and len(devices) == runs_at_once(group)
    compute.available_memory = lambda: 1 << 36
    assert runs_at_once(group) == 16
"""


def test_sixteen_cores_train_what_one_does():
    environment = os.environ | {"JAX_NUM_CPU_DEVICES": "16"}
    done = subprocess.run([sys.executable, "-c", MANY_CORES], env=environment, capture_output=True, text=True)
    assert done.returncode == 0, done.stderr


@pytest.mark.skipif(not Path("/proc/meminfo").is_file(), reason="Linux alone says what is available")
def test_available_memory_is_what_linux_says():
    meminfo = dict(line.split(":") for line in Path("/proc/meminfo").read_text().splitlines())
    said = int(meminfo["MemAvailable"].split()[0]) << 10
    limited = any(limits._control_groups("memory"))
    assert compute.available_memory() > 0 and (limited or abs(compute.available_memory() / said - 1) < 0.2)


@pytest.mark.skipif(not hasattr(os, "sched_setaffinity"), reason="no affinity here")
def test_cores_are_those_that_the_process_may_use():
    words = "import os; os.sched_setaffinity(0, {min(os.sched_getaffinity(0))}); from humanoid_mjx import compute; "
    done = subprocess.run([sys.executable, "-c", words + "print(compute.cores())"], capture_output=True, text=True)
    assert done.stdout == "1\n", done.stderr


@pytest.mark.parametrize("unified", [True, False])
def test_limits_of_control_groups_hold(unified, tmp_path, monkeypatch):
    groups = limits._control_groups
    monkeypatch.setattr(limits, "_control_groups", lambda kind: groups(kind, tmp_path))
    (tmp_path / "proc/self").mkdir(parents=True)
    line = "0::/job/step\n" if unified else "4:memory:/job/step\n2:cpu,cpuacct:/job/step\n"
    (tmp_path / "proc/self/cgroup").write_text(line)
    mounts = {kind: tmp_path / "sys/fs/cgroup" / ("" if unified else kind) for kind in ("cpu", "memory")}
    for mount in mounts.values():
        (mount / "job/step").mkdir(parents=True, exist_ok=True)
    limit, usage = ("max", "current") if unified else ("limit_in_bytes", "usage_in_bytes")
    (mounts["memory"] / f"job/memory.{limit}").write_text("1000000\n")
    (mounts["memory"] / f"job/memory.{usage}").write_text("700000\n")
    prefix = "" if unified else "total_"
    (mounts["memory"] / "job/memory.stat").write_text(f"anon 5\n{prefix}inactive_file 200000\n")
    assert compute.available_memory() == 500_000
    files = (
        {"cpu.max": "50000 100000\n"} if unified else {"cpu.cfs_quota_us": "50000\n", "cpu.cfs_period_us": "100000\n"}
    )
    for name, text in files.items():
        (mounts["cpu"] / f"job/{name}").write_text(text)
    assert compute.cores() == 1
