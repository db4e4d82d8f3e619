"""Settings for all tests: two CPU devices, plain kernels, programs kept between runs, types checked at every call."""

import gc
import os
import sys
from pathlib import Path

os.environ.setdefault("JAX_NUM_CPU_DEVICES", "2")
os.environ.setdefault("JAX_PLATFORMS", "cpu")
os.environ.setdefault("JAX_COMPILATION_CACHE_DIR", str(Path(__file__).parent.parent / ".pytest_cache" / "xla"))
os.environ.setdefault("JAX_PERSISTENT_CACHE_MIN_COMPILE_TIME_SECS", "0")
# As `compute.start` sets it: else the first command of a process has all that follows traced and compiled again.
os.environ.setdefault("JAX_DEFAULT_MATMUL_PRECISION", "highest")

import hypothesis
import jax
import pytest
import typecheck
from jaxtyping import install_import_hook

# Before the hook: a program's hundred thousand sums and products of numbers would take ten times as long to trace.
import humanoid_mjx.kernels.cpu_kernel
import humanoid_mjx.kernels.numbers  # noqa: F401

# The hook rewrites every module: once for all processes, and none of them looks for garbage in what it imports.
sys.dont_write_bytecode = False
os.environ.pop("PYTHONDONTWRITEBYTECODE", None)  # nor does each process that tests start compile the package
gc.set_threshold(50_000)
install_import_hook("humanoid_mjx", f"{typecheck.__name__}.check")

from humanoid_mjx import cli, compute  # noqa: E402
from humanoid_mjx.kernels import fallback  # noqa: E402

PLAIN_KERNELS = "--xla_backend_optimization_level=0 --xla_cpu_parallel_codegen_split_count=1"
if jax.__version_info__ < (0, 11):  # later XLA knows no other emitters, and aborts at the flag
    PLAIN_KERNELS += " --xla_cpu_use_fusion_emitters=false"
"""Kernels that run slower and that XLA compiles in a third of the time, in which most of the time of tests goes. What
is tested with them is what programs compute, not how XLA rounds it. In one piece, a program costs less in all, and both
cores are busy anyway."""

os.environ.setdefault("XLA_FLAGS", f"{compute.XLA_FLAGS} {PLAIN_KERNELS}")
os.environ.setdefault("PJRT_NPROC", compute.POOL_THREADS)

# A machine with other work may take a second for what takes a millisecond.
hypothesis.settings.register_profile("suite", deadline=None, suppress_health_check=[hypothesis.HealthCheck.too_slow])
hypothesis.settings.load_profile("suite")

MAPPINGS = 15_000
"""Parts of memory after which compiled programs are let go. Each has a few; Linux allows a process 65,530, and XLA
crashes when it gets no more."""


@pytest.fixture(scope="module", autouse=True)
def few_compiled_programs():
    """A worker does not keep the programs of all modules that it has run."""
    yield
    maps = Path("/proc/self/maps")
    if maps.exists() and len(maps.read_bytes().splitlines()) > MAPPINGS:
        from humanoid_mjx.training.programs import programs

        programs.cache_clear()
        jax.clear_caches()
        gc.collect()


@pytest.fixture(autouse=True)
def kernels_are_made():
    """No test passes because XLA computed what a kernel should have."""
    yield
    assert not fallback.reasons


@pytest.fixture
def said(monkeypatch, capfd):
    """Runs the command line in this process: its exit code, what it prints, and what it says of a failure."""

    def call(*arguments):
        monkeypatch.setattr(compute, "start", lambda **_: None)
        monkeypatch.setattr(sys, "argv", ["humanoid-mjx", *map(str, arguments)])
        capfd.readouterr()
        try:
            cli.main()
        except SystemExit as ended:
            return ended.code, *capfd.readouterr()
        return 0, *capfd.readouterr()

    return call


LONGEST = (
    *(
        "kernel",
        "docs",
        "gait_evaluation",
        "live",
        "approximate",
        "physics",
        "shipped_policies",
        "bench",
        "play",
        "api",
    ),
    *("control_experiments", "evaluate", "ground_experiments", "replay", "halving", "processes", "live_push"),
    *(
        "sweep",
        "tree",
        "legged",
        "config",
        "verdicts",
        "several_gpus",
        "leg_experiments",
        "kept",
        "slurm",
    ),
    *("on_ray", "tabular", "wheel", "ppo", "own_tasks", "fallback", "table_kernels", "physics_worlds", "memory"),
)
"""Files that begin first, the longest before all, so that no worker ends with one while the other has nothing to do."""


def pytest_collection_modifyitems(items):
    order = {f"test_{name}.py": place for place, name in enumerate(LONGEST)}
    items.sort(key=lambda item: order.get(item.path.name, len(LONGEST)))


def pytest_collection_finish():
    compute.settings.look_for_garbage_seldom()
