"""A function of many worlds as one function of a CPU, which computes a vector of worlds at a time.

XLA makes some four hundred kernels of a Newton step, and starting them takes as long as what they compute. Here what a
GPU's threads would do is compiled by LLVM, and XLA calls it through its foreign function interface.
"""

import hashlib
import re
import threading
from collections.abc import Callable, Sequence
from contextlib import suppress
from dataclasses import replace
from functools import cache, lru_cache
from pathlib import Path
from typing import Any

import jax
import jax.numpy as jnp
from jaxtyping import Array

from humanoid_mjx.files import read_sealed, write_sealed
from humanoid_mjx.kernels.llvm import WIDTH, Code, Value, together
from humanoid_mjx.kernels.llvm_lowering import lower
from humanoid_mjx.kernels.llvm_memory import Words
from humanoid_mjx.kernels.memory import bits
from humanoid_mjx.kernels.signature import Kind, Signature, signature
from humanoid_mjx.kernels.sums import fused
from humanoid_mjx.kernels.threads import Threads

NAME = re.compile(r"humanoid_mjx_[0-9a-f]{32}")
"""Names of compiled functions, by what they follow from."""


def cpu_kernel(function: Callable[..., Any], *args: Any) -> Any:
    """`function(*args)`, both pytrees of arrays whose last axis is of worlds that do not mix.

    Raises:
      NotImplementedError: the function does something else than arithmetic.
    """
    leaves, structure = jax.tree.flatten(args)
    known = signature(function, structure, tuple(Kind(leaf.shape[:-1], leaf.dtype) for leaf in leaves), False)
    worlds = leaves[0].shape[-1]
    # The last world fills up a vector, also of a world alone: jax traces that, too, where it maps over many, and the
    # function would be compiled twice.
    if (missing := WIDTH - worlds) > 0:
        leaves = [jnp.concatenate([leaf, *[leaf[..., -1:]] * missing], axis=-1) for leaf in leaves]
    found, _ = call(known, leaves, max(worlds, WIDTH))
    return jax.tree.unflatten(jax.tree.structure(known.shapes), [x[..., :worlds] for x in found])


def call(known: Signature, leaves: Sequence[Array], worlds: int) -> tuple[list[Array], list[Kind]]:
    """Call a function; `leaves`: its arguments in the form of their kinds. Return its results, and their kinds."""
    code, found, in_place = written(known, together(worlds))
    wanted = [jax.ShapeDtypeStruct(kind.of_all(worlds), kind.dtype) for kind in found]
    function = jax.ffi.ffi_call(_compiled_of(code), wanted, input_output_aliases=in_place)
    return [*function(*leaves, jnp.int32(worlds))], found


@cache
def _compiled_of(code: str) -> str:
    """The name by which XLA calls LLVM's code, once it is compiled."""
    code = code.replace("MAJOR", str(_version()[0])).replace("MINOR", str(_version()[1]))
    name = f"humanoid_mjx_{hashlib.sha256((code + _machine()).encode()).hexdigest()[:32]}"
    register({name: _compiled(name, code)})
    return name


_objects: dict[str, bytes] = {}
"""Compiled functions of this process by name."""

_engines: list[Any] = []
"""Engines of LLVM, which own the code."""

_registering = threading.Lock()


def objects_in(program: str) -> dict[str, bytes]:
    """The compiled functions that a program calls; `program`: its text."""
    return {name: _objects[name] for name in sorted(set(NAME.findall(program)))}


def forget() -> None:
    """Write and compile functions anew when they are asked for, for those who time it."""
    for cached in signature, written, _compiled_of:
        cached.cache_clear()


def register(objects: dict[str, bytes]) -> None:
    """Let programs of XLA call compiled functions."""
    import llvmlite.binding as llvm

    with _registering:
        for name in objects.keys() - _objects.keys():
            engine = llvm.create_mcjit_compiler(llvm.parse_assembly(""), _target())
            engine.add_object_file(llvm.ObjectFileRef.from_data(objects[name]))
            engine.finalize_object()
            _engines.append(engine)
            call = jax.ffi.pycapsule(engine.get_function_address("call"))
            jax.ffi.register_ffi_target(name, call, platform="cpu")
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
    """Return the versions and features that compiled code depends on."""
    import llvmlite.binding as llvm

    return f"{llvm.llvm_version_info} {llvm.get_host_cpu_name()} {llvm.get_host_cpu_features().flatten()}"


@lru_cache
def written(known: Signature, width: int) -> tuple[str, list[Kind], dict[int, int]]:
    """LLVM's code of a function, of so many worlds at a time; the kinds of its results; and arguments in whose place
    results are, see `evaluate`."""
    code, found, in_place = Code(width), [], {}

    def results(numbers: Sequence[Array]) -> list[Array]:
        threads = Threads(known.single, Words, lambda _, table: Words(tuple(map(bits, table)), 0))
        rows, kinds, places = known.evaluate(threads, numbers, lambda place, kind: Words(f"given{place}", kind.size))
        found.extend(kinds)
        in_place.update(places)
        return rows

    traced = jax.make_jaxpr(results)(known.numbers)
    traced = traced if known.single else fused(traced)
    values = lower(code, traced, [_loaded(code, place) for place in _places(code, "given", known.given)])
    for value, place in zip(values, _places(code, "found", found), strict=True):
        _stored(code, value, place)
    tables = [
        f"@table{number} = private constant [{len(table)} x i32] [{', '.join(f'i32 {word}' for word in table)}]"
        for table, number in code.tables.items()
    ]
    memory = [
        f"  %region{number} = alloca [{words * width} x i32], align {4 * width}"
        for number, words in code.regions.items()
    ]
    lines = [*tables, *sorted(code.declared), BLOCK, *memory, *code.lines, "  ret void\n}"]
    lines.append(CALL.replace("COUNT", str(len(known.given))).replace("WIDTH", str(width)))
    return "\n".join(lines), found, in_place


BLOCK = """
define internal void @block(ptr noalias %given, ptr noalias %found, i64 %worlds, i64 %first) noinline {
entry:"""
"""Begin of what computes worlds from `first` on; `given` and `found`: descriptions of arrays (XLA_FFI_Buffer)."""

CALL = """
define ptr @call(ptr %frame) {
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
  %count_at = getelementptr ptr, ptr %given, i64 COUNT
  %count = load ptr, ptr %count_at
  %number_at = getelementptr i8, ptr %count, i64 24
  %number = load ptr, ptr %number_at
  %worlds32 = load i32, ptr %number
  %worlds = sext i32 %worlds32 to i64
  %last = sub i64 %worlds, WIDTH
  br label %again
again:
  %begin = phi i64 [ 0, %compute ], [ %next, %again ]
  %first = call i64 @llvm.smin.i64(i64 %begin, i64 %last)
  call void @block(ptr %given, ptr %found, i64 %worlds, i64 %first)
  %next = add i64 %begin, WIDTH
  %more = icmp slt i64 %next, %worlds
  br i1 %more, label %again, label %end
end:
  ret ptr null
}
declare i64 @llvm.smin.i64(i64, i64)
"""
"""Function that XLA calls, an `XLA_FFI_Handler`. Offsets are those of the structs in `LAYOUT`. If XLA asks for the
version of the interface that the handler was made for (`XLA_FFI_Metadata_Extension`), the answer is `_version()`. The
number of worlds is the last argument; those of the last block may overlap those of the one before it."""

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


def _places(code: Code, arrays: str, kinds: Sequence[Kind]) -> list[Value]:
    """The addresses of the numbers of arrays, `given` or `found`, that are not in memory. Memory gets a name."""
    places = []
    for index, kind in enumerate(kinds):
        if kind.in_memory and arrays == "found":
            continue
        at = code.value(f"getelementptr ptr, ptr %{arrays}, i64 {index}")
        buffer = code.value(f"load ptr, ptr {at}, align 8")
        at = code.value(f"getelementptr i8, ptr {buffer}, i64 24")
        data, size = code.value(f"load ptr, ptr {at}, align 8"), kind.dtype.itemsize
        if kind.in_memory:
            if size != 4:
                raise NotImplementedError("kernels look up entries of 32 bits")
            first = code.value(f"mul i64 %first, {4 * kind.size}")
            code.add(f"%given{index} = getelementptr i8, ptr {data}, i64 {first}")
            continue
        for row in range(kind.size):
            number = str(row)
            if kind.role == "rows":
                number = code.value(f"add i64 {code.value(f'mul i64 %worlds, {row}')}, %first")
            place = code.value(f"getelementptr i8, ptr {data}, i64 {code.value(f'mul i64 {number}, {size}')}")
            places.append(Value(place, kind.dtype, kind.role == "uniform"))
    return places


def _loaded(code: Code, at: Value) -> Value:
    flags = at.dtype.kind == "b"
    kind = code.type_of(at.dtype, at.uniform).replace("i1", "i8")  # flags are bytes there
    name = code.value(f"load {kind}, ptr {at.name}, align {1 if flags else 4}")
    return replace(at, name=code.value(f"trunc {kind} {name} to {code.type_of(bool, at.uniform)}") if flags else name)


def _stored(code: Code, value: Value, at: Value) -> None:
    name, kind = code.vector(value), code.type_of(value.dtype)
    if flags := value.dtype.kind == "b":
        stored = kind.replace("i1", "i8")
        kind, name = stored, code.value(f"zext {kind} {name} to {stored}")
    code.add(f"store {kind} {name}, ptr {at.name}, align {1 if flags else 4}")
