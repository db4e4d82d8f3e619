"""Exported programs, kept on disk beside jax's compiled ones, so that the next process need not trace.

jax keeps compiled programs, but finds them only by what it has traced: seconds of Python for a robot. Here a caller
says what a program follows from. Everything else that could change it is in one digest, so that a file of another
version of this package, of jax, of a setting or of a machine is never used. Only commands keep anything (`keeping`): in
a notebook or a test, functions may have been replaced.
"""

import hashlib
import os
import pickle
import sys
import threading
import zlib
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager, suppress
from functools import lru_cache, partial
from pathlib import Path
from typing import Any

import jax
import jax.monitoring

from humanoid_mjx.compute.provenance import machine
from humanoid_mjx.files import folder, read_sealed, write_sealed
from humanoid_mjx.kernels import cpu_kernel, fallback
from humanoid_mjx.spec import Spec, kinds, ships

SETTINGS = ("JAX_", "XLA_", "PJRT_", "TF_", "NVIDIA_", "CUDA_")
"""Prefixes of the environment variables that programs may depend on."""

_on = False


@contextmanager
def keeping() -> Iterator[None]:
    """Keep and find within the block."""
    global _on
    _on = True
    try:
        yield
    finally:
        _on = False


def about(spec: Spec, arrays: Any = None, also: str = "") -> str | None:
    """Return the cache key of a program: structure, shapes, types and shardings of a Spec and of `arrays`, and `also`.
    None if the Spec has a class from outside this package, whose code may change."""
    if not all(map(ships, kinds(spec))):
        return None
    leaves, structure = jax.tree.flatten((spec, arrays))
    kinds_of_leaves = (f"{jax.typeof(leaf)} {getattr(leaf, 'sharding', None)}" for leaf in leaves)
    return "\n".join([also, str(structure), *kinds_of_leaves])


def remembered(name: str, about: str | None, make: Callable[[], Any]) -> Any:
    """Return the stored result for `name` and `about`; if there is none, call `make` and store its result.

    `name`: first part of the file's name. `about`: the cache key; None stores nothing.
    """
    if (found := find(name, about)) is None:
        put(name, about, found := make())
    return found


def find(name: str, about: str | None) -> Any:
    """Return what `put` stored, or None."""
    with suppress(Exception):  # what is damaged is made anew
        if (path := _path(name, about)) is not None:
            data = read_sealed(path, _surroundings() + path.name.encode())
            return None if data is None else pickle.loads(zlib.decompress(data))
    return None


def put(name: str, about: str | None, value: Any) -> None:
    """Store a value, over that of another version; one that cannot be pickled or a full disk is passed over."""
    if (path := _path(name, about)) is None:
        return
    with suppress(OSError, ValueError, TypeError, AttributeError, pickle.PickleError):
        write_sealed(path, zlib.compress(pickle.dumps(value), 1), _surroundings() + path.name.encode())


def compile_program(name: str, about: str | None, lowered: jax.stages.Lowered) -> tuple[jax.stages.Compiled, Callable]:
    """Return a compiled program, and a function that stores it, which does nothing if jax had the program on disk: a
    CPU program that was loaded lacks functions when it is stored again."""
    read, thread = [], threading.get_ident()

    def listen(event: str, **_: Any) -> None:
        if event == "/jax/compilation_cache/cache_hits" and threading.get_ident() == thread:
            read.append(event)

    jax.monitoring.register_event_listener(listen)
    try:
        program = lowered.compile()
    finally:
        jax.monitoring.unregister_event_listener(listen)
    return program, (lambda: None) if read else partial(_put_program, name, about, program)


def _put_program(name: str, about: str | None, program: jax.stages.Compiled) -> None:
    """Store a compiled program, unless it calls Python or holds arrays."""
    if _path(name, about) is not None:
        from jax.experimental.serialize_executable import serialize

        with suppress(ValueError, TypeError, NotImplementedError, AttributeError, jax.errors.JaxRuntimeError):
            data, _, out = serialize(program)
            objects = cpu_kernel.objects_in(program.as_text() or "")
            put(name, about, (data, jax.tree.unflatten(out, range(out.num_leaves)), objects))


def load_program(stored: Any, args: tuple[Any, ...], devices: Sequence[Any]) -> jax.stages.Compiled:
    """Return the program that `find` found, for such arguments on these devices."""
    from jax.experimental.serialize_executable import deserialize_and_load

    data, out, objects = stored
    cpu_kernel.register(objects)
    given, out = jax.tree.structure((args, {})), jax.tree.structure(out)
    return deserialize_and_load(data, given, out, devices[0].client, devices)


def _path(name: str, about: str | None) -> Path | None:
    place = jax.config.values["jax_compilation_cache_dir"]
    if not _on or about is None or not place or "://" in place or " at 0x" in about or fallback.reasons:
        return None
    if jax.default_backend() != "cpu" or not jax.config.values["jax_enable_compilation_cache"]:
        return None  # on a GPU this was never tried
    return Path(place) / f"{name}-{hashlib.sha256(about.encode()).hexdigest()[:40]}-traced"


@lru_cache
def _surroundings() -> bytes:
    """A digest of all that programs follow from and callers do not name: code, versions, machine, settings."""
    found = hashlib.sha256()
    robots = (path for path in folder("robots").rglob("*") if path.is_file())
    for path in sorted([*Path(__file__).parents[1].rglob("*.py"), *robots]):
        found.update(path.name.encode() + path.read_bytes())
    installed = sorted(path.name for place in sys.path for path in Path(place).glob("*.dist-info"))
    values = {name: x for name, x in jax.config.values.items() if "cache" not in name}
    environment = {name: x for name, x in os.environ.items() if name.startswith(SETTINGS) and "CACHE" not in name}
    with suppress(OSError), open("/proc/cpuinfo", "rb") as file:  # a processor of the same name may lack a feature
        found.update(next((line for line in file.read(8192).splitlines() if line.startswith(b"flags")), b""))
    client = jax.devices()[0].client
    for part in (installed, sorted(values.items()), sorted(environment.items()), machine(), client.platform_version):
        found.update(repr(part).encode())
    return found.digest()
