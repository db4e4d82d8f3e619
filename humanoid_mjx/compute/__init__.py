"""The machine and the process: XLA's options, start, memory and cores, provenance, random numbers."""

from humanoid_mjx.compute.limits import available_memory, cores
from humanoid_mjx.compute.options import XLA_FLAGS, Arithmetic, Program, compiler_options, jitted
from humanoid_mjx.compute.provenance import commit, machine, made_by, versions
from humanoid_mjx.compute.settings import POOL_THREADS, make_room, start

__all__ = [
    "POOL_THREADS",
    "XLA_FLAGS",
    "Arithmetic",
    "Program",
    "available_memory",
    "commit",
    "compiler_options",
    "cores",
    "jitted",
    "machine",
    "made_by",
    "make_room",
    "start",
    "versions",
]
