"""A function of many worlds as one function of a CPU, which computes `WIDTH` worlds at a time in its vectors.

XLA makes some four hundred kernels of a Newton step, and starting them takes as long as what they compute. Here what a
GPU's threads would do is compiled by LLVM, and XLA calls it through its foreign function interface.
"""

import ctypes
import hashlib
import math
import re
import threading
from collections.abc import Callable
from contextlib import suppress
from functools import lru_cache, partial
from pathlib import Path
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array

from humanoid_mjx.compute.kernels.llvm import WIDTH, Code, Value, type_of
from humanoid_mjx.compute.kernels.llvm_lowering import lower
from humanoid_mjx.compute.kernels.llvm_memory import Table, Words
from humanoid_mjx.compute.kernels.memory import THREADS
from humanoid_mjx.compute.kernels.threads import Threads
from humanoid_mjx.files import read_sealed, write_sealed

NAME = re.compile(r"humanoid_mjx_[0-9a-f]{32}")
"""Names of compiled functions, by what they follow from."""


def cpu_kernel(function: Callable[..., Any], *args: Any) -> Any:
    """`function(*args)`, both pytrees of arrays whose last axis is of worlds that do not mix.

    Raises:
      NotImplementedError: the function does something else than arithmetic.
    """
    leaves, structure = jax.tree.flatten(args)
    name, shapes = _named(function, structure, tuple((leaf.shape[:-1], leaf.dtype) for leaf in leaves))
    worlds = leaves[0].shape[-1]
    if (missing := WIDTH - worlds) > 0:  # the last world fills up a vector
        leaves = [jnp.concatenate([leaf, *[leaf[..., -1:]] * missing], axis=-1) for leaf in leaves]
    outputs = jax.tree.leaves(shapes)
    wanted = [jax.ShapeDtypeStruct((*x.shape[:-1], max(worlds, WIDTH)), x.dtype) for x in outputs]
    found = [x[..., :worlds] for x in jax.ffi.ffi_call(name, wanted)(*leaves)]
    return jax.tree.unflatten(jax.tree.structure(shapes), found)


@lru_cache
def _named(function: Callable[..., Any], structure: Any, kinds: tuple[Any, ...]) -> tuple[str, Any]:
    """The name by which XLA calls a function, which is traced and compiled once whatever the number of worlds, and what
    it gives of one world; `kinds`: shape and type of each argument for a world."""
    single = [jax.ShapeDtypeStruct((*shape, 1), dtype) for shape, dtype in kinds]
    traced, shapes = jax.make_jaxpr(function, return_shape=True)(*structure.unflatten(single))
    threads = Threads(1, _own, _own, jnp.any, Words, Table)
    rows = [jax.ShapeDtypeStruct((THREADS,), dtype) for shape, dtype in kinds for _ in range(math.prod(shape))]
    written = jax.make_jaxpr(partial(threads.results, traced))(rows)
    code = _code(written, kinds, [(x.shape[:-1], x.dtype) for x in jax.tree.leaves(shapes)])
    name = f"humanoid_mjx_{hashlib.sha256((code + _machine()).encode()).hexdigest()[:32]}"
    if name not in _fresh:
        register({name: _compiled(name, code)})
        _fresh.add(name)
    return name, shapes


def _own(values: Array, *_: int) -> Array:
    """What a world's only thread holds."""
    return values


_objects: dict[str, bytes] = {}
"""Compiled functions of this process by name."""

_fresh: set[str] = set()
"""Names of those that `forget` asks nobody to compile again."""

_engines: list[Any] = []
"""What holds their code."""

_registering = threading.Lock()


def objects_in(program: str) -> dict[str, bytes]:
    """The compiled functions that a program calls; `program`: its text."""
    return {name: _objects[name] for name in sorted(set(NAME.findall(program)))}


def forget() -> None:
    """Write and compile functions anew when they are asked for, for those who time it."""
    _named.cache_clear()
    _fresh.clear()


def register(objects: dict[str, bytes]) -> None:
    """Let programs of XLA call compiled functions."""
    import llvmlite.binding as llvm

    capsule = ctypes.pythonapi.PyCapsule_New
    capsule.restype, capsule.argtypes = ctypes.py_object, [ctypes.c_void_p, ctypes.c_char_p, ctypes.c_void_p]
    with _registering:
        for name in objects.keys() - _objects.keys():
            engine = llvm.create_mcjit_compiler(llvm.parse_assembly(""), _target())
            engine.add_object_file(llvm.ObjectFileRef.from_data(objects[name]))
            engine.finalize_object()
            _engines.append(engine)
            jax.ffi.register_ffi_target(name, capsule(engine.get_function_address("call"), None, None), platform="cpu")
            _objects[name] = objects[name]


def _compiled(name: str, code: str) -> bytes:
    """An object file of LLVM's code, kept beside jax's compiled programs."""
    place = jax.config.values["jax_compilation_cache_dir"]
    path = Path(place) / f"{name}-object" if place and "://" not in place else None
    if path is not None:
        with suppress(OSError):
            if (kept := read_sealed(path, name.encode())) is not None:
                return kept
    import llvmlite.binding as llvm

    target, module = _target(), llvm.parse_assembly(code)
    # What vectors and loops there are is known; more unrolling would only take time.
    options = llvm.create_pipeline_tuning_options(speed_level=1)
    options.loop_vectorization = options.slp_vectorization = options.loop_unrolling = False
    passes = llvm.create_pass_builder(target, options)
    passes.getModulePassManager().run(module, passes)
    found = target.emit_object(module)
    if path is not None:
        with suppress(OSError, ValueError):
            write_sealed(path, found, name.encode())
    return found


@lru_cache
def _target() -> Any:
    """LLVM's compiler for this processor."""
    import llvmlite.binding as llvm

    llvm.initialize_native_target()
    llvm.initialize_native_asmprinter()
    features = llvm.get_host_cpu_features().flatten()
    target = llvm.Target.from_default_triple()
    return target.create_target_machine(llvm.get_host_cpu_name(), features, opt=2, codemodel="jitdefault", jit=True)


@lru_cache
def _machine() -> str:
    """What compiled code follows from beside LLVM's code."""
    import llvmlite.binding as llvm

    return f"{llvm.llvm_version_info} {llvm.get_host_cpu_name()} {llvm.get_host_cpu_features().flatten()}"


def _code(traced: Any, kinds: Any, results: Any) -> str:
    """LLVM's code of a function of vectors; `kinds`, `results`: shape for a world and type of each array."""
    code = Code()
    given = [_loaded(code, place) for place in _places(code, "given", kinds)]
    found = lower(code, traced, given)
    for value, place in zip(found, _places(code, "found", results), strict=True):
        _stored(code, value, place)
    tables = [
        f"@table{number} = private constant [{len(table)} x i32] [{', '.join(f'i32 {word}' for word in table)}]"
        for table, number in code.tables.items()
    ]
    memory = [
        f"  %region{number} = alloca [{words * WIDTH} x i32], align {4 * WIDTH}"
        for number, words in code.regions.items()
    ]
    call = CALL.replace("MAJOR", str(_version()[0])).replace("MINOR", str(_version()[1]))
    return "\n".join([*tables, *sorted(code.declared), BLOCK, *memory, *code.lines, "  ret void\n}", call])


BLOCK = """
define internal void @block(ptr noalias %given, ptr noalias %found, i64 %worlds, i64 %first) noinline {
entry:"""
"""Begin of what computes worlds from `first` on; `given` and `found`: descriptions of arrays (XLA_FFI_Buffer)."""

CALL = f"""
define ptr @call(ptr %frame) {{
entry:
  %extension_at = getelementptr i8, ptr %frame, i64 8
  %extension = load ptr, ptr %extension_at
  %extended = icmp ne ptr %extension, null
  br i1 %extended, label %ask, label %compute
ask:
  %type_at = getelementptr i8, ptr %extension, i64 8
  %type = load i32, ptr %type_at
  %asked = icmp eq i32 %type, 1
  br i1 %asked, label %version, label %compute
version:
  %metadata_at = getelementptr i8, ptr %extension, i64 24
  %metadata = load ptr, ptr %metadata_at
  %major = getelementptr i8, ptr %metadata, i64 24
  store i32 MAJOR, ptr %major
  %minor = getelementptr i8, ptr %metadata, i64 28
  store i32 MINOR, ptr %minor
  ret ptr null
compute:
  %given_at = getelementptr i8, ptr %frame, i64 72
  %given = load ptr, ptr %given_at
  %found_at = getelementptr i8, ptr %frame, i64 112
  %found = load ptr, ptr %found_at
  %buffer = load ptr, ptr %found
  %rank_at = getelementptr i8, ptr %buffer, i64 32
  %rank = load i64, ptr %rank_at
  %sizes_at = getelementptr i8, ptr %buffer, i64 40
  %sizes = load ptr, ptr %sizes_at
  %axis = sub i64 %rank, 1
  %size_at = getelementptr i64, ptr %sizes, i64 %axis
  %worlds = load i64, ptr %size_at
  %last = sub i64 %worlds, {WIDTH}
  br label %again
again:
  %begin = phi i64 [ 0, %compute ], [ %next, %again ]
  %first = call i64 @llvm.smin.i64(i64 %begin, i64 %last)
  call void @block(ptr %given, ptr %found, i64 %worlds, i64 %first)
  %next = add i64 %begin, {WIDTH}
  %more = icmp slt i64 %next, %worlds
  br i1 %more, label %again, label %end
end:
  ret ptr null
}}
declare i64 @llvm.smin.i64(i64, i64)
"""
"""Function that XLA calls, an `XLA_FFI_Handler`. Offsets are those of the structs in `LAYOUT`. If XLA asks for the
version of the interface that the handler was made for (`XLA_FFI_Metadata_Extension`), the answer is `_version()`. The
worlds of the last block may overlap those of the one before it."""

LAYOUT = {
    "Metadata_Extension": "extension_base metadata",
    "Metadata": "struct_size api_version traits state_type_id",
    "Api_Version": "struct_size extension_start major_version minor_version",
    "Buffer": "struct_size extension_start dtype data rank dims",
    "Args": "struct_size extension_start size types args",
    "Rets": "struct_size extension_start size types rets",
    "CallFrame": "struct_size extension_start api ctx stage args rets attrs future",
}
"""Fields of the structs of `xla/ffi/api/c_api.h` that `CALL` reads, in order: those of jaxlib 0.10 to 0.12."""


@lru_cache
def _version() -> tuple[int, int]:
    """Return the version of XLA's foreign function interface in the header that jaxlib ships, major and minor.

    Raises:
      NotImplementedError: its structs are not those of `LAYOUT`.
    """
    header = (Path(jax.ffi.include_dir()) / "xla/ffi/api/c_api.h").read_text()
    major, minor = (int(number) for number in re.findall(r"#define XLA_FFI_API_M(?:AJ|IN)OR (\d+)", header))
    plain = re.sub(r"//[^\n]*|/\*.*?\*/", "", header, flags=re.DOTALL)
    structs = dict(re.findall(r"struct XLA_FFI_(\w+) \{(.*?)\}", plain, re.DOTALL))
    changed = [name for name, own in LAYOUT.items() if re.findall(r"(\w+);", structs.get(name, "")) != own.split()]
    if major != 0 or changed:
        raise NotImplementedError(f"XLA's foreign function interface {major}.{minor} is not one that was tested")
    return major, minor


def _places(code: Code, arrays: str, kinds: Any) -> list[tuple[str, np.dtype]]:
    """Addresses of the numbers of all rows of arrays, and their types; `arrays`: `given` or `found`."""
    places = []
    for index, (shape, dtype) in enumerate(kinds):
        at = code.value(f"getelementptr ptr, ptr %{arrays}, i64 {index}")
        buffer = code.value(f"load ptr, ptr {at}, align 8")
        at = code.value(f"getelementptr i8, ptr {buffer}, i64 24")
        data = code.value(f"load ptr, ptr {at}, align 8")
        for row in range(math.prod(shape)):
            number = code.value(f"add i64 {code.value(f'mul i64 %worlds, {row}')}, %first")
            size = np.dtype(dtype).itemsize
            place = code.value(f"getelementptr i8, ptr {data}, i64 {code.value(f'mul i64 {number}, {size}')}")
            places.append((place, np.dtype(dtype)))
    return places


def _loaded(code: Code, at: tuple[str, np.dtype]) -> Value:
    place, dtype = at
    if dtype.kind != "b":
        return Value(code.value(f"load {type_of(dtype, False)}, ptr {place}, align 4"), dtype, False)
    flags = code.value(f"load <{WIDTH} x i8>, ptr {place}, align 1")
    return Value(code.value(f"icmp ne <{WIDTH} x i8> {flags}, zeroinitializer"), dtype, False)


def _stored(code: Code, value: Value, at: tuple[str, np.dtype]) -> None:
    name, (place, _) = code.vector(value), at
    if value.dtype.kind != "b":
        code.add(f"store {type_of(value.dtype, False)} {name}, ptr {place}, align 4")
        return
    flags = code.value(f"zext <{WIDTH} x i1> {name} to <{WIDTH} x i8>")
    code.add(f"store <{WIDTH} x i8> {flags}, ptr {place}, align 1")
