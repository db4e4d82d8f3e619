"""Settings of jax and Python for the whole process. Commands call `start` first; importing the package sets nothing."""

import gc
import os
from importlib.metadata import entry_points
from pathlib import Path

import jax

from humanoid_mjx.compute.limits import cores
from humanoid_mjx.compute.options import NVIDIA_FLAG, XLA_FLAGS
from humanoid_mjx.spec import InputError

POOL_THREADS = str(max(16, 4 * cores()))
"""`PJRT_NPROC` for MJX: the threads that all CPU devices share, by default one a core.

jaxlib 0.10.2 can deadlock with the default. Its kernels for batches of linear systems split their work over the pool
and wait for it in one of the pool's threads; as many such kernels at once as there are threads wait forever. MJX solves
such systems for contacts. All other programs are faster with one thread a core, so only MJX gets more (`make_room`).
"""


def start(*, mjx: bool = False) -> None:
    """Prepare this process for computing: all cores, compiled programs on disk, float32 products, rare garbage search.

    Call it before jax first computes. It sets XLA's flags (`XLA_FLAGS`), gives every CPU core a device of its own,
    keeps compiled programs in `~/.cache/humanoid_mjx/xla`, computes products in full float32 and calls
    `look_for_garbage_seldom`. Settings of the environment (`JAX_COMPILATION_CACHE_DIR`, ...) win.

    Args:
      mjx: call `make_room` too, for a program that computes anything else before it first uses MJX.

    Raises:
      InputError: jax has computed already.
    """
    cache = os.environ.get("XDG_CACHE_HOME") or os.path.expanduser("~/.cache")
    defaults = {
        "jax_compilation_cache_dir": _made(Path(cache) / "humanoid_mjx" / "xla"),
        "jax_persistent_cache_min_compile_time_secs": 0.1,
        "jax_num_cpu_devices": cores(),
        "jax_default_matmul_precision": "highest",
    }
    flags = os.environ.get("XLA_FLAGS", "")
    if not any(flag.split("=")[0] in flags for flag in XLA_FLAGS.split()):
        os.environ["XLA_FLAGS"] = f"{flags} {XLA_FLAGS} {NVIDIA_FLAG if _nvidia() else ''}".strip()
    for name, value in defaults.items():
        if name.upper() not in os.environ:
            try:
                jax.config.update(name, value)
            except RuntimeError as error:
                raise InputError("start: jax has computed already; call start before any jax operation.") from error
    look_for_garbage_seldom()
    if mjx:
        make_room()


LEARNING = {
    "jax_enable_x64": ((False,), "compute in float32"),
    "jax_disable_jit": ((False,), "are compiled"),
    "jax_debug_nans": ((False,), "mark what is not known yet by NaN"),
    "jax_debug_infs": ((False,), "mark what is not known yet by infinity"),
    "jax_numpy_dtype_promotion": (("standard",), "mix types of numbers"),
    "jax_transfer_guard_host_to_device": ((None, "allow", "log", "disallow_explicit"), "take arrays of numpy"),
}
"""Settings of jax: the values with which learners train, and why."""


def check_settings() -> None:
    """Raise an InputError unless jax is set so that learners can train."""
    for name, (fit, why) in LEARNING.items():
        if (value := getattr(jax.config, name)) not in fit:
            variables = [v for v in (name.upper(), "JAX_TRANSFER_GUARD") if v in os.environ]
            here = f"{variables[0]}={os.environ[variables[0]]}" if variables else f"{name} is {value}"
            raise InputError(f"{here}: learners {why}; unset it (physics and mechanics can use it).")


def _made(folder: Path) -> str | None:
    """Make a folder and return its path; None where no file can be written, or the user has no home folder."""
    try:
        folder.expanduser().mkdir(parents=True, exist_ok=True)
    except (OSError, RuntimeError):
        return None
    return str(folder) if os.access(folder, os.W_OK) else None


def look_for_garbage_seldom() -> None:
    """Let Python search for garbage after 50,000 new objects (its default is 700), and not among imported objects.

    Tracing makes hundreds of thousands of objects that stay. Searching them took an eighth of the time until `stand`
    began to train on a CPU, its programs compiled before.
    """
    gc.freeze()
    gc.set_threshold(50_000, *gc.get_threshold()[1:])


def make_room() -> bool:
    """Give XLA's CPU pool `POOL_THREADS` threads, unless the environment sets `PJRT_NPROC`.

    Returns:
      False where MJX could deadlock: jax already computes with fewer threads, on several CPU devices.
    """
    if "PJRT_NPROC" in os.environ:
        return True
    if _computes() and jax.default_backend() == "cpu" and jax.local_device_count() > 1:
        return False
    os.environ["PJRT_NPROC"] = POOL_THREADS
    return True


def _computes() -> bool:
    """Return whether jax has begun to compute: from then on it refuses another number of devices."""
    devices = jax.config.jax_num_cpu_devices  # pyright: ignore[reportAttributeAccessIssue]
    try:
        jax.config.update("jax_num_cpu_devices", devices + 1)
    except RuntimeError:
        return True
    jax.config.update("jax_num_cpu_devices", devices)
    return False


def _nvidia() -> bool:
    """Return whether jax will compute on an NVIDIA GPU, without asking jax, which would begin to compute."""
    asked = os.environ.get("JAX_PLATFORMS") or "cuda"
    plugin = any("cuda" in plugin.name for plugin in entry_points(group="jax_plugins"))
    return plugin and ("cuda" in asked or "gpu" in asked) and any(Path("/dev").glob("nvidia[0-9]*"))
