"""Settings for all tests: two CPU devices, compiled programs kept between runs, types checked at every call."""

import gc
import os
from pathlib import Path

os.environ.setdefault("JAX_NUM_CPU_DEVICES", "2")
os.environ.setdefault("JAX_PLATFORMS", "cpu")
os.environ.setdefault("JAX_COMPILATION_CACHE_DIR", str(Path(__file__).parent.parent / ".pytest_cache" / "xla"))
os.environ.setdefault("JAX_PERSISTENT_CACHE_MIN_COMPILE_TIME_SECS", "0.3")

import jax
import pytest
from jaxtyping import install_import_hook

install_import_hook("humanoid_mjx", "typecheck.check")

from humanoid_mjx import runtime  # noqa: E402

DOUBLE = bool(os.environ.get("JAX_ENABLE_X64"))
"""Whether jax computes in double precision, which the package never does by itself."""

PLAIN_KERNELS = "--xla_cpu_use_fusion_emitters=false --xla_backend_optimization_level=0"
"""Kernels that run slower and that XLA compiles in a third of the time where programs are of chains, in two thirds
where they are MJX's. Only for double precision: what is tested there is mathematics, and most of the time goes into
compiling it."""

os.environ.setdefault("XLA_FLAGS", runtime.XLA_FLAGS)
if DOUBLE:
    os.environ["XLA_FLAGS"] += f" {PLAIN_KERNELS}"
os.environ.setdefault("PJRT_NPROC", runtime.POOL_THREADS)

collect_ignore = [] if DOUBLE else ["float64"]
"""Those need a process of their own: test_float64.py starts it."""


MAPPINGS = 15_000
"""Parts of memory after which compiled programs are let go. Each has a few; Linux allows a process 65,530, and XLA
crashes when it gets no more."""


@pytest.fixture(scope="module", autouse=True)
def few_compiled_programs():
    """A worker does not keep the programs of all modules that it has run."""
    yield
    maps = Path("/proc/self/maps")
    if maps.exists() and len(maps.read_bytes().splitlines()) > MAPPINGS:
        jax.clear_caches()
        gc.collect()


def pytest_collection_modifyitems(items):
    """The longest test first, so that it does not run alone at the end."""
    items.sort(key=lambda item: "test_float64.py" not in item.nodeid)
