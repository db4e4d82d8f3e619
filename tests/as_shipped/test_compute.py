"""Settings of the process: what XLA's pool of threads does to programs, and what keeps it from harm."""

import os
import subprocess
import sys
from collections import deque
from types import SimpleNamespace

import jax
import numpy as np
import pytest

from humanoid_mjx import compute, make_task
from humanoid_mjx.compute import options, settings
from humanoid_mjx.config import load, parse
from humanoid_mjx.kernels import fallback
from humanoid_mjx.tasks.base import Task
from humanoid_mjx.training.plan import make_plan
from humanoid_mjx.training.pool import Pool

SOLVES = """
import faulthandler, threading
from humanoid_mjx import compute
compute.start(mjx=True)
import jax, jax.numpy as jnp
faulthandler.dump_traceback_later(600, exit=True)

def step(x, _):
    matrices = [jnp.eye(16) * (2.0 + number) + 0.0 * x[0] for number in range(3)]
    return sum(jax.scipy.linalg.cho_solve(jax.scipy.linalg.cho_factor(m), x) for m in matrices), None

run = jax.jit(jax.vmap(lambda x: jax.lax.scan(step, x, length=200)[0]))
starts = [jax.device_put(jnp.ones((512, 16)), device) for device in jax.devices()]
work = [threading.Thread(target=lambda x=x: [jax.block_until_ready(run(x)) for _ in range(5)]) for x in starts]
for thread in work: thread.start()
for thread in work: thread.join()
"""


def test_programs_that_solve_many_systems_do_not_wait_for_each_other_forever():
    """They do with `PJRT_NPROC` of 2, which is the default on two cores, also one program, or one system in each."""
    environment = os.environ | {"JAX_NUM_CPU_DEVICES": "2"}
    environment.pop("PJRT_NPROC", None)
    done = subprocess.run([sys.executable, "-c", SOLVES], env=environment, capture_output=True, text=True, timeout=1200)
    assert done.returncode == 0, done.stderr


LATE = """
from humanoid_mjx import compute
from humanoid_mjx.physics import make_physics
compute.start()
import jax
jax.devices()
make_physics("mjx-jax", robot="legs")
"""


def test_mjx_that_comes_too_late_for_its_threads_is_refused_in_a_sentence():
    environment = {name: value for name, value in os.environ.items() if name != "PJRT_NPROC"}
    environment["JAX_NUM_CPU_DEVICES"] = "2"
    command = [sys.executable, "-c", LATE]
    done = subprocess.run(command, env=environment, capture_output=True, text=True, timeout=1200)
    assert "InputError: physics: MJX could wait forever" in done.stderr, done


@pytest.mark.parametrize(
    ("overrides", "threads"),
    [
        ((), None),
        (("name=mjx-jax",), None),
        (("task.physics=mjx-jax",), compute.POOL_THREADS),
        (("sweep.axes.task.physics=[chain, mjx-jax]",), compute.POOL_THREADS),
    ],
)
def test_the_plan_of_a_config_with_mjx_makes_room_for_it_and_no_other_does(monkeypatch, overrides, threads):
    monkeypatch.delenv("PJRT_NPROC")
    monkeypatch.setattr(settings, "_computes", lambda: False)
    config = load("leg_reach", overrides)
    assert "PJRT_NPROC" not in os.environ  # reading a config changes nothing in the process
    make_plan(config)
    assert os.environ.get("PJRT_NPROC") == threads


SUMS = """
from humanoid_mjx import compute
compute.start()
import jax, jax.numpy as jnp
shape = 3, 1, 2, 2, 8, 8, 8
multiplied = jax.jit(lambda a, b: jnp.sum(a * b, axis=3), compiler_options=compute.compiler_options("arrays"))
print(multiplied(jnp.ones(shape), jnp.full(shape, 2.0)).max())
"""


def test_sums_over_arrays_of_seven_axes_do_not_crash():
    """They do where XLA hands them to YNNPACK, which it does in no program of a task on MJX or of a user's own."""
    on_mjx = [make_task("stand", physics="mjx-jax"), make_task("posture_switch", physics="mjx-jax"), Task()]
    assert {task.arithmetic for task in on_mjx} == {
        "arrays"
    } and "xla_cpu_experimental_ynn_fusion_type" in compute.compiler_options("arrays")
    environment = {name: value for name, value in os.environ.items() if name != "XLA_FLAGS"}
    done = subprocess.run([sys.executable, "-c", SUMS], env=environment, capture_output=True, text=True, timeout=1200)
    assert done.returncode == 0 and done.stdout.strip() == "4.0", done


@pytest.mark.parametrize(
    ("platforms", "plugin", "device", "found"),
    [
        ("", "xla_cuda13", "nvidia0", True),
        ("cpu", "xla_cuda13", "nvidia0", False),
        ("", "xla_rocm", "nvidia0", False),
        ("", "xla_cuda13", "nvidiactl", False),
    ],
)
def test_a_gpu_is_told_by_its_plugin_its_device_and_what_is_asked_for(
    monkeypatch, tmp_path, platforms, plugin, device, found
):
    (tmp_path / device).touch()
    monkeypatch.setenv("JAX_PLATFORMS", platforms)
    monkeypatch.setattr(settings, "entry_points", lambda group: [SimpleNamespace(name=plugin)])
    monkeypatch.setattr(settings, "Path", lambda _: tmp_path)
    assert settings._nvidia() == found


@pytest.mark.parametrize(("given", "more"), [("--xla_cpu_enable_fast_math=false", ""), ("", options.NVIDIA_FLAG)])
def test_flags_that_the_environment_sets_are_kept_and_a_gpu_has_one_of_its_own(given, more):
    program = (
        f"import os; from humanoid_mjx.compute import settings; settings._nvidia = lambda: {bool(more)}; "
        "settings.start(); import jax; print(jax.jit(lambda x: x + 1)(1), os.environ['XLA_FLAGS'])"
    )
    environment = os.environ | {"XLA_FLAGS": given, "JAX_PLATFORMS": "cpu"}
    done = subprocess.run([sys.executable, "-c", program], env=environment, capture_output=True, text=True)
    assert done.stdout.split() == f"2 {given} {compute.XLA_FLAGS} {more}".split(), done.stderr


def compiled(task: str) -> str:
    """The program that trains tables on a task, on the first device. Two agents feed each: no kernel can do it."""
    learner = {"name": "tabular_q", "agents": 2}
    config = {"name": "c", "task": {"name": task}, "learner": learner, "seeds": 1024, "episodes": 10}
    group = make_plan(parse(config)).groups[0]
    pool = Pool(group, deque(group.runs.tolist()), 512, jax.local_devices(), seed=0)
    return pool.programs.advance.lower(pool.learners, pool.training, np.int32(1)).compile().as_text()


def test_tables_on_every_core_are_not_split_over_the_pool(monkeypatch):
    assert jax.local_device_count() > 1
    assert "outer_dimension_partitions" not in compiled("joint_reach")
    monkeypatch.setattr(options, "SPLITTING", "dce")
    assert "outer_dimension_partitions" in compiled("navigate")


def test_this_xla_knows_every_option_and_one_that_it_does_not_know_is_left_out_with_a_warning(monkeypatch, caplog):
    assert all(options._accepted({row.name: row.value}) for row in options.TABLE)
    new = options.Option("xla_of_the_future", "1", None, options.TABLE[0].programs)
    monkeypatch.setattr(options, "TABLE", (*options.TABLE, new))
    for _ in range(2):
        assert compute.compiler_options("scalars") == {options.PASSES: "none"}
    assert [record.getMessage() for record in caplog.records] == [
        "This XLA does not know the option xla_of_the_future; programs may be slower."
    ]


@pytest.mark.parametrize(
    ("backend", "capability", "words"),
    [
        ("cpu", None, None),
        ("tpu", None, "not for 'tpu'"),
        ("gpu", "9.0", None),
        ("gpu", "7.5", "Ampere"),
        ("gpu", None, "Ampere"),
    ],
)
def test_kernels_are_for_cpus_and_gpus_that_triton_compiles_for(monkeypatch, backend, capability, words):
    device = SimpleNamespace() if capability is None else SimpleNamespace(compute_capability=capability)
    monkeypatch.setattr(jax, "default_backend", lambda: backend)
    monkeypatch.setattr(jax, "local_devices", lambda: [device])
    reason = fallback.why_none()
    assert reason is None if words is None else words in reason
