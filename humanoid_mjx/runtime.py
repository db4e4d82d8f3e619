"""Settings of jax for a whole process. The command line calls `start` first; importing the package sets nothing."""

import gc
import math
import os
import platform
import re
import subprocess
import threading
import time
from collections import Counter
from collections.abc import Iterator, Mapping
from contextlib import contextmanager, suppress
from importlib.metadata import PackageNotFoundError, entry_points, version
from pathlib import Path
from typing import Any

import jax
import jax.monitoring

XLA_FLAGS = (
    "--xla_backend_extra_options=xla_cpu_use_multi_output_fusion --xla_disable_hlo_passes=cpu_multi_output_fusion"
)
"""For XLA on a CPU. By itself it computes what several results share again for each of them; these stop that, which
makes MJX 15 times faster. The pass that then computes several results in one kernel aborts on some programs, MJX's
among them, so that it is off by default; `SHARED_KERNELS` is for programs that are known to pass. jaxlib 0.10.2 aborts
where it joins two sums with two results each, as `jnp.argmax` is, or two scatters; both arise from operations on arrays
of one shape that have an operand in common."""

NO_VECTORS = "--xla_backend_extra_options=-vectorize-slp=false"
"""For XLA where there is an NVIDIA GPU: LLVM does not look for scalars that could be a vector, of which a GPU has none.
That takes 2 s of compiling the tree's kernel; of 526 kernels of other programs it changes 16. A CPU is slower
without."""


def cores() -> int:
    """CPU cores that this process may use: its affinity, or the quota of its control group where that is less."""
    found = len(os.sched_getaffinity(0)) if hasattr(os, "sched_getaffinity") else os.cpu_count() or 1
    for group in _control_groups("cpu"):
        if (group / "cpu.max").is_file():
            quota, period = (group / "cpu.max").read_text().split()
        elif (group / "cpu.cfs_quota_us").is_file():
            quota, period = ((group / f"cpu.cfs_{name}_us").read_text().strip() for name in ("quota", "period"))
        else:
            continue
        if quota.isdigit():  # without a quota it is "max" or -1
            found = min(found, max(1, -(-int(quota) // int(period))))
    return found


def available_memory() -> int:
    """Bytes that this process may still take without swapping; half of the machine's memory where no system says it."""
    meminfo = Path("/proc/meminfo")
    known = re.search(r"^MemAvailable: *(\d+) kB$", meminfo.read_text(), re.M) if meminfo.is_file() else None
    found = int(known[1]) << 10 if known else os.sysconf("SC_PAGE_SIZE") * os.sysconf("SC_PHYS_PAGES") // 2
    for group in _control_groups("memory"):
        for limit, usage in (("memory.max", "memory.current"), ("memory.limit_in_bytes", "memory.usage_in_bytes")):
            if (group / limit).is_file() and (most := (group / limit).read_text().strip()).isdigit():
                cached = re.search(r"^(?:total_)?inactive_file (\d+)$", (group / "memory.stat").read_text(), re.M)
                used = int((group / usage).read_text()) - (int(cached[1]) if cached else 0)
                found = min(found, max(0, int(most) - used))
    return found


def _control_groups(kind: str, root: Path = Path("/")) -> Iterator[Path]:
    """The folders of this process's control groups, of either version, that limit its `kind`: cpu or memory."""
    file = root / "proc/self/cgroup"
    for line in file.read_text().splitlines() if file.is_file() else ():
        _, kinds, path = line.split(":", 2)
        if kinds == "" or kind in kinds.split(","):
            mount = root / "sys/fs/cgroup" / (kinds and kind)
            inside = mount / path.lstrip("/")
            yield from (folder for folder in (inside, *inside.parents) if folder.is_relative_to(mount))


POOL_THREADS = str(max(16, 4 * cores()))
"""`PJRT_NPROC` for MJX: threads that all CPU devices share. By default there are as many as cores, and jaxlib 0.10.2
can use them up: its kernels for many linear systems share these out over the pool and wait for them in one of its
threads. As many such kernels at once as threads, of programs on two devices, wait forever, and MJX solves so for
contacts. All else is faster with as many as cores: among more, a program moves from thread to thread where it could
go on. `make_room` is for programs that need it."""

SHARED_KERNELS: dict[str, str | bool] = {"xla_disable_hlo_passes": "none"}
"""`compiler_options` of a `jax.jit` around chain dynamics or tabular learning: after `start` the first is 5 times, the
second 1.2 to 1.7 times faster on a CPU; tile coding on chain dynamics is so 2 times; else no effect."""


def shares_kernels(options: Mapping[str, str | bool]) -> bool:
    """Whether these options have `SHARED_KERNELS`, as those of tasks on physics of scalars have and on none."""
    return SHARED_KERNELS.items() <= options.items()


def no_library() -> dict[str, str | bool]:
    """`compiler_options` of a `jax.jit` around MJX or approximate Q-learning: on a CPU no sums and products by YNNPACK.

    That of jaxlib 0.10.2 writes beyond its stack where a sum has seven axes, as evaluating on MJX has with runs,
    snapshots and episodes side by side, and the process crashes (jax issues 39257 and 40412). Large enough arrays only
    are given to it. MJX, `deep_q` and tile coding are 1.3 to 1.7 times faster without it; Brax's PPO is 1.2 times so
    with it.
    """
    return {"xla_cpu_experimental_ynn_fusion_type": ""} if jax.default_backend() == "cpu" else {}


def wide_vectors() -> dict[str, str | bool]:
    """`compiler_options` of a `jax.jit` around tabular learning: on a CPU with AVX-512 vectors of the whole width.

    By itself LLVM makes them half as wide. With thousands of agents tables train so up to 1.2 times as fast, on an AMD
    EPYC and on an Intel Xeon, to the same bits. MJX is slower with it, and on the Xeon the tree.
    """
    return {"xla_cpu_prefer_vector_width": "512"} if jax.default_backend() == "cpu" else {}


def short_kernels() -> dict[str, str | bool]:
    """`compiler_options` of a `jax.jit` around approximate Q-learning on physics of scalars: on a GPU a single kernel
    is a CUDA graph, too, and products of matrices are cuBLAS's.

    An update makes thousands of short kernels, each of which costs its launch: in graphs `leg_reach` trains 2 times,
    `leg_reach_linear` 1.9 times as fast on one H200. XLA's own kernels for products are up to 1.1 times as fast where
    several runs train side by side, but to try them out took 10 s of the time until `stand` began to train; so XLA does
    not try out Triton for other kernels either, which gained nothing. Graphs of whole loops
    (`xla_gpu_enable_command_buffer` with `WHILE`) are faster still, but one of ten runs of `stand` that had them fell
    in greedy episodes at the end of a training in which it stood; nobody knows why yet.
    """
    if jax.default_backend() != "gpu":
        return {}
    return {
        "xla_gpu_graph_min_graph_size": "1",
        "xla_gpu_enable_triton_gemm": False,
        "xla_gpu_experimental_enable_fusion_autotuner": False,
    }


def on_every_device(options: Mapping[str, str | bool]) -> dict[str, str | bool]:
    """`compiler_options` of a program that runs on all devices at once, made from those of one that runs alone.

    Where several CPU devices keep the cores busy, kernels of programs with `SHARED_KERNELS` are not split over the pool
    of threads: in one that has MJX's (`POOL_THREADS`) tables train 3 times as fast so, in others as fast or faster.
    """
    alone = jax.default_backend() != "cpu" or jax.local_device_count() == 1
    passes = options.get("xla_disable_hlo_passes")
    return dict(options) if alone or passes is None else {**options, "xla_disable_hlo_passes": f"{passes},{SPLITTING}"}


SPLITTING = "cpu-parallel-task-assigner"
"""XLA's pass that splits kernels into parts for the pool of threads."""


def start(*asked: str | None) -> None:
    """Keep compiled programs on disk, give every CPU core a device of its own, compute products in full float32, have
    Python look for garbage seldom.

    Must come before jax first computes. Settings that the environment makes (`JAX_COMPILATION_CACHE_DIR`,
    `JAX_NUM_CPU_DEVICES`, ...) are kept.

    Args:
      asked: what a user asks for that no config says, such as "mjx-jax": for MJX it makes room.
    """
    defaults = {
        "jax_compilation_cache_dir": str(_cache_folder()),
        "jax_persistent_cache_min_compile_time_secs": 0.1,
        "jax_num_cpu_devices": cores(),
        "jax_default_matmul_precision": "highest",
    }
    flags = os.environ.get("XLA_FLAGS", "")
    if not any(flag.split("=")[0] in flags for flag in XLA_FLAGS.split()):
        os.environ["XLA_FLAGS"] = f"{flags} {XLA_FLAGS} {NO_VECTORS if _nvidia() else ''}".strip()
    for name, value in defaults.items():
        if name.upper() not in os.environ:
            jax.config.update(name, value)
    look_for_garbage_seldom()
    if any("mjx-" in word for word in asked if word):
        make_room()


def _nvidia() -> bool:
    """Whether jax will compute on an NVIDIA GPU, told before it looks for one."""
    asked = os.environ.get("JAX_PLATFORMS") or "cuda"
    plugin = any("cuda" in plugin.name for plugin in entry_points(group="jax_plugins"))
    return plugin and ("cuda" in asked or "gpu" in asked) and any(Path("/dev").glob("nvidia[0-9]*"))


def look_for_garbage_seldom() -> None:
    """Have Python look for garbage after 50,000 new objects, by default 700, and not among what is imported.

    Tracing a program makes hundreds of thousands of objects that stay, through which Python looks again and again: an
    eighth of the time until `stand` begins to train on a CPU, its programs compiled before.
    """
    gc.freeze()
    gc.set_threshold(50_000, *gc.get_threshold()[1:])


def reserve_memory() -> None:
    """Have GPUs reserve their memory in threads of their own, which takes 1.5 s on one H200, while the caller goes on:
    at the first number that is put on one it would wait for that."""
    if jax.default_backend() == "gpu":
        for device in jax.local_devices():
            threading.Thread(target=jax.device_put, args=(0.0, device), daemon=True).start()


def make_room() -> bool:
    """Have XLA's pool on a CPU so many threads that programs which solve many linear systems do not wait for each other
    forever (`POOL_THREADS`), unless the environment says how many.

    Returns whether they will not: false where jax has already begun to compute with fewer, on several CPU devices.
    """
    if "PJRT_NPROC" in os.environ:
        return True
    if _computes() and jax.default_backend() == "cpu" and jax.local_device_count() > 1:
        return False
    os.environ["PJRT_NPROC"] = POOL_THREADS
    return True


def _computes() -> bool:
    """Whether jax has begun to compute: after that it takes no other number of devices."""
    devices = jax.config.jax_num_cpu_devices  # pyright: ignore[reportAttributeAccessIssue]
    try:
        jax.config.update("jax_num_cpu_devices", devices + 1)
    except RuntimeError:
        return True
    jax.config.update("jax_num_cpu_devices", devices)
    return False


def out_of_memory(error: BaseException) -> bool:
    """Whether an error says that the memory of a device or of the machine does not suffice."""
    exhausted = isinstance(error, jax.errors.JaxRuntimeError) and "RESOURCE_EXHAUSTED" in str(error)
    return exhausted or isinstance(error, MemoryError)


def made_by() -> dict[str, Any]:
    """What made a record: machine, versions, commit."""
    return {"machine": machine(), "versions": versions(), "commit": commit()}


def why_no_kernel() -> str | None:
    """Why kernels that Pallas makes through Triton do not run here; None where they do."""
    if jax.default_backend() != "gpu":
        return "there is no GPU"
    major = str(getattr(jax.local_devices()[0], "compute_capability", "")).partition(".")[0]
    return None if major.isdigit() and int(major) >= 8 else "the GPU is not of NVIDIA's Ampere or later ones"


def _cache_folder() -> Path:
    base = os.environ.get("XDG_CACHE_HOME") or Path.home() / ".cache"
    return Path(base) / "humanoid_mjx" / "xla"


def machine() -> dict[str, Any]:
    """What computes here."""
    devices = jax.devices()
    return {
        "device": devices[0].device_kind,
        "backend": jax.default_backend(),
        "device_count": len(devices),
        "cpu": _cpu_name(),
        "cpu_count": cores(),
        "system": f"{platform.system()} {platform.machine()}",
    }


def versions() -> dict[str, str]:
    """The versions that a result depends on, as far as they are installed."""
    packages = ("humanoid-mjx", "jax", "jaxlib", "mujoco", "mujoco-mjx", "warp-lang", "brax", "numpy")
    found = {"python": platform.python_version()}
    for name in packages:
        with suppress(PackageNotFoundError):
            found[name] = version(name)
    return found


def commit() -> str | None:
    """The git commit of this package, with "-dirty" behind it where files differ; None outside a checkout."""
    root = Path(__file__).parent.parent
    if not (root / ".git").exists():
        return None
    described = ("git", "-C", str(root), "describe", "--always", "--dirty", "--abbrev=40", "--exclude=*")
    try:
        return subprocess.run(described, capture_output=True, text=True, check=True).stdout.strip()
    except (OSError, subprocess.CalledProcessError):
        return None


def _cpu_name() -> str:
    cpuinfo = Path("/proc/cpuinfo")
    lines = cpuinfo.read_text().splitlines() if cpuinfo.is_file() else []
    names = [line.partition(":")[2].strip() for line in lines if line.startswith("model name")]
    return names[0] if names else platform.processor()


class CompileCount:
    """Programs compiled and the seconds in which any was traced or compiled, while `counting_compiles` runs."""

    def __init__(self) -> None:
        self.events: Counter[str] = Counter()
        self.times: list[tuple[float, float]] = []
        """Beginning and end of each event, by the monotonic clock. They overlap: programs compile side by side, and
        tracing a function takes in tracing those that it calls."""

    def __call__(self, event: str, duration_secs: float, **kwargs: str | int) -> None:
        if event.startswith("/jax/core/compile/"):
            self.events[event] += 1
            now = time.monotonic()
            self.times.append((now - duration_secs, now))

    @property
    def seconds(self) -> float:
        """Seconds in which something was traced or compiled, those of threads side by side once."""
        total, last = 0.0, -math.inf
        for begin, end in sorted(self.times):
            total += max(0.0, end - max(begin, last))
            last = max(last, end)
        return total

    @property
    def programs(self) -> int:
        """How many programs were compiled."""
        return self.events["/jax/core/compile/backend_compile_duration"]


@contextmanager
def counting_compiles() -> Iterator[CompileCount]:
    """Count what jax compiles in the block (programs found in the cache on disk count too, their seconds being few)."""
    count = CompileCount()
    jax.monitoring.register_event_duration_secs_listener(count)
    try:
        yield count
    finally:
        jax.monitoring.unregister_event_duration_listener(count)
