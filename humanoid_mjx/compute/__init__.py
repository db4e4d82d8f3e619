"""The machine and the process: XLA's options, start, memory and cores, provenance, random numbers."""

from humanoid_mjx.compute.compiles import timing_compiles
from humanoid_mjx.compute.limits import available_memory, cores, out_of_memory, reserve_memory
from humanoid_mjx.compute.options import XLA_FLAGS, Arithmetic, Program, compiler_options, jitted
from humanoid_mjx.compute.provenance import commit, machine, made_by, versions
from humanoid_mjx.compute.settings import POOL_THREADS, check_settings, look_for_garbage_seldom, make_room, start

__all__ = [
    "POOL_THREADS",
    "XLA_FLAGS",
    "Arithmetic",
    "Program",
    "available_memory",
    "check_settings",
    "commit",
    "compiler_options",
    "cores",
    "jitted",
    "look_for_garbage_seldom",
    "machine",
    "made_by",
    "make_room",
    "out_of_memory",
    "reserve_memory",
    "start",
    "timing_compiles",
    "versions",
]
