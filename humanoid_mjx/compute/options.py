"""XLA's options: one table for compiled programs, and the flags of the process.

Physics and tasks name the kind of their arithmetic, learners the kind of their program; `compiler_options` looks up the
rest. An option that this version of XLA does not know is left out with a warning.
"""

import logging
from collections.abc import Callable, Mapping
from functools import lru_cache
from typing import Any, Literal, NamedTuple, TypeAlias

import jax
import numpy as np

from humanoid_mjx.kernels.fallback import why_none, with_fallback

Arithmetic = Literal["scalars", "tree", "arrays"]
"""Arithmetic of a task: scalars of many worlds (finite tasks, the chain), the tree's scalars, or arrays (MJX)."""

Program = Literal["simulation", "tabular", "approximate", "tiles", "other", "single"]
"""Kind of a compiled program: physics alone, Q-learning by tables, networks (`approximate`) or tiles, any other
learner, or a single world: that program should compile quickly, and need not run fast."""

Options: TypeAlias = dict[str, str | bool]
"""`compiler_options` of a `jax.jit`."""

XLA_FLAGS = (
    "--xla_backend_extra_options=xla_cpu_use_multi_output_fusion,-vectorize-memory-check-threshold=1000"
    " --xla_disable_hlo_passes=cpu_multi_output_fusion"
)
"""Flags of the process for XLA on a CPU.

By default XLA:CPU recomputes shared subexpressions for every output of a fusion. The first option stops that, which
makes MJX 15 times faster. The second is LLVM's: kernels that read more than some 100 arrays are vectors with it, where
LLVM would give up for fear that what they write is what they read. The last flag disables the pass that then fuses
several outputs into one kernel, since this pass aborts on some programs, among them MJX's. The table enables the pass
again for programs that are known to compile. jaxlib 0.10.2 aborts where the pass joins two reductions with two results
each, such as `jnp.argmax`, or two scatters; both arise from operations on arrays of one shape that share an operand.
"""

NVIDIA_FLAG = "--xla_backend_extra_options=-vectorize-slp=false,-nvptx-fma-level=2"
"""Flag of the process where there is an NVIDIA GPU, with two options of LLVM.

The first stops LLVM from combining scalars into vectors, which a GPU lacks. It saves 2 s of compiling the tree's
kernel; of 526 kernels of other programs it changes 16. It slows a CPU down. The second lets a product and a sum be one
instruction, which XLA does not allow by itself: the tree's kernel has a sixth fewer instructions with it.
"""

SPLITTING = "cpu-parallel-task-assigner"
"""XLA's pass that splits kernels into parts for the pool of CPU threads."""

PASSES = "xla_disable_hlo_passes"


class Option(NamedTuple):
    """One row of the table: an option and the programs that get it."""

    name: str
    value: str | bool
    backend: Literal["cpu", "gpu"] | None
    """None for every backend."""
    programs: frozenset[tuple[Arithmetic, Program]]


def _for(arithmetics: str, programs: str) -> frozenset[tuple[Arithmetic, Program]]:
    pairs: Any = ((arithmetic, program) for arithmetic in arithmetics.split() for program in programs.split())
    return frozenset(pairs)


TABLE = (
    # Multi-output fusion, see `XLA_FLAGS`: chain dynamics are 5 times faster on a CPU, tabular learning 1.2 to 1.7
    # times, tile coding on the chain 2 times, what XLA computes beside the tree's kernel 1.1 to 1.4 times. No effect on
    # others, some of which abort, as does the tree's time step without a kernel.
    Option(PASSES, "none", None, _for("scalars tree", "simulation tabular approximate tiles")),
    # No sums and products by the library YNNPACK. That of jaxlib 0.10.2 writes beyond its stack where a sum has seven
    # axes, as evaluation on MJX has with runs, snapshots and episodes side by side, and the process crashes (jax issues
    # 39257 and 40412). MJX, `deep_q` and tile coding are 1.3 to 1.7 times faster without it; Brax's PPO is 1.2 times
    # faster with it.
    Option(
        "xla_cpu_experimental_ynn_fusion_type",
        "",
        "cpu",
        _for("arrays tree", "simulation tabular approximate tiles other")
        | _for("scalars", "tabular approximate tiles"),
    ),
    # Vectors of the whole width of AVX-512; LLVM's default is half. With thousands of agents tables train up to 1.2
    # times as fast, on an AMD EPYC and on an Intel Xeon, to the same bits. MJX is slower with it, and on the Xeon the
    # tree.
    Option("xla_cpu_prefer_vector_width", "512", "cpu", _for("scalars tree", "tabular")),
    # CUDA graphs even of a single kernel. An update of approximate Q-learning launches thousands of short kernels; in
    # graphs `leg_reach` trains 2 times, `leg_reach_linear` 1.9 times as fast on one H200. Graphs of whole loops
    # (`xla_gpu_enable_command_buffer` with `WHILE`) are faster still, but one of ten runs of `stand` that had them fell
    # in greedy episodes at the end of a training in which it stood, for an unknown reason.
    Option("xla_gpu_graph_min_graph_size", "1", "gpu", _for("scalars tree", "approximate tiles")),
    # Matrix products by cuBLAS. Triton's are up to 1.1 times as fast where several runs train side by side, but
    # choosing them took 10 s until `stand` began to train. Choosing other kernels of Triton gained nothing.
    Option("xla_gpu_enable_triton_gemm", False, "gpu", _for("scalars tree", "approximate tiles")),
    # cuBLAS by its own rules, without a trial of its algorithms. Trials run on the GPU while another thread trains, and
    # jaxlib 0.11.2 then sometimes corrupts its allocator of GPU memory: 5 of some 35 processes on one H200 ended in
    # `BFCAllocator::InsertFreeChunk` or a segmentation fault. What it does to the speed of MJX was not measured.
    Option("xla_gpu_autotune_level", "0", "gpu", _for("scalars tree arrays", "simulation tabular approximate tiles")),
    Option("xla_gpu_experimental_enable_fusion_autotuner", False, "gpu", _for("scalars tree", "approximate tiles")),
    # The same bits twice: without it samples that share a weight are added up in any order. `leg_reach_linear` trains
    # at .77 of its speed with it on one H100 (`docs/bench/h100_same_bits.json`).
    Option("xla_gpu_enable_scatter_determinism_expander", True, "gpu", _for("scalars tree arrays", "tiles")),
    # Plain kernels. A decision of one robot that walks compiles in a fifth of the time and takes 2 ms longer.
    Option("xla_backend_optimization_level", "0", "cpu", _for("scalars tree arrays", "single")),
    Option("xla_cpu_use_fusion_emitters", False, "cpu", _for("scalars tree arrays", "single")),
    Option("xla_cpu_parallel_codegen_split_count", "1", "cpu", _for("scalars tree arrays", "single")),
)


def compiler_options(arithmetic: Arithmetic, program: Program = "simulation", every_device: bool = False) -> Options:
    """Return the `compiler_options` of a `jax.jit`, as far as this XLA knows them.

    `every_device`: the program runs on all devices at once. Several CPU devices keep all cores busy, so kernels with
    multi-output fusion are not split over the pool of threads: with MJX's pool (`POOL_THREADS`) tables train 3 times as
    fast so, with others as fast or faster.
    """
    backend = jax.default_backend()
    options = {
        row.name: row.value for row in TABLE if row.backend in (None, backend) and (arithmetic, program) in row.programs
    }
    if arithmetic == "tree" and (jax.config.read("jax_enable_x64") or why_none()):
        options.pop(PASSES, None)
    if every_device and backend == "cpu" and jax.local_device_count() > 1 and PASSES in options:
        options[PASSES] = f"{options[PASSES]},{SPLITTING}"
    return dict(_known(tuple(options.items()), backend))


def jitted(function: Callable[..., Any], arithmetic: Arithmetic, program: Program = "simulation") -> Callable[..., Any]:
    """`jax.jit` with these `compiler_options`; compiled again, with others, where a kernel cannot be made.

    The options are looked up at each call, and jax compiles once for each.
    """
    return with_fallback(lambda *args: jax.jit(function, compiler_options=compiler_options(arithmetic, program))(*args))


@lru_cache
def _known(options: tuple[tuple[str, str | bool], ...], backend: str) -> Mapping[str, str | bool]:
    """Return those of the options that XLA accepts, and warn once of each of the others."""
    if _accepted(dict(options)):
        return dict(options)
    known = {name: value for name, value in options if _accepted({name: value})}
    for name in dict(options).keys() - known:
        logging.getLogger(__name__).warning("This XLA does not know the option %s; programs may be slower.", name)
    return known


def _accepted(options: Options) -> bool:
    try:
        jax.jit(lambda x: x).lower(np.float32(0)).compile(options)
    except jax.errors.JaxRuntimeError as error:
        if "compile option" in str(error) or "setting option" in str(error):
            return False
        raise
    return True
