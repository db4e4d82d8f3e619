"""A function of many worlds as one function of a CPU, which computes `WIDTH` worlds at a time in its vectors.

XLA makes some four hundred kernels of a Newton step, and starting them takes as long as what they compute. Here what a
GPU's threads would do is compiled by LLVM, and XLA calls it through its foreign function interface.
"""

import ctypes
import hashlib
import math
import re
import threading
from collections.abc import Callable, Sequence
from contextlib import suppress
from functools import lru_cache
from pathlib import Path
from typing import Any, Literal, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array

from humanoid_mjx.files import read_sealed, write_sealed
from humanoid_mjx.kernels.arrangements import arranged
from humanoid_mjx.kernels.llvm import WIDTH, Code, Value, type_of
from humanoid_mjx.kernels.llvm_lowering import lower
from humanoid_mjx.kernels.llvm_memory import Given, Table, Words
from humanoid_mjx.kernels.memory import THREADS
from humanoid_mjx.kernels.threads import Kept, Threads, looked_up

NAME = re.compile(r"humanoid_mjx_[0-9a-f]{32}")
"""Names of compiled functions, by what they follow from."""


class Kind(NamedTuple):
    """Kind of an array that a kernel takes or gives."""

    shape: tuple[int, ...]
    """That of a world."""
    dtype: Any
    role: Literal["rows", "uniform", "memory"] = "rows"
    """`rows`: (*shape, worlds). `uniform`: one array for all worlds. `memory`: (worlds, *shape), whose entries are
    looked up, and changed in their place."""

    @property
    def size(self) -> int:
        return math.prod(self.shape)


class Program(NamedTuple):
    """A function as LLVM's code."""

    code: str
    given: list[Kind]
    found: list[Kind]
    shapes: Any
    """Shapes and types of the results of a world, in their pytree."""
    in_place: dict[int, int]
    """Numbers of arguments that change in their place, and of the results that they become."""

    def call(self, leaves: Sequence[Array], worlds: int) -> list[Array]:
        """Call the function; `leaves`: its arguments in the form of their kinds."""
        name = _compiled_of(self.code)
        shapes = [(worlds, *x.shape) if x.role == "memory" else (*x.shape, worlds) for x in self.found]
        wanted = [jax.ShapeDtypeStruct(shape, x.dtype) for shape, x in zip(shapes, self.found, strict=True)]
        return jax.ffi.ffi_call(name, wanted, input_output_aliases=self.in_place)(*leaves)


def cpu_kernel(function: Callable[..., Any], *args: Any) -> Any:
    """`function(*args)`, both pytrees of arrays whose last axis is of worlds that do not mix.

    Raises:
      NotImplementedError: the function does something else than arithmetic.
    """
    leaves, structure = jax.tree.flatten(args)
    program = _program(function, structure, tuple(Kind(leaf.shape[:-1], leaf.dtype) for leaf in leaves))
    worlds = leaves[0].shape[-1]
    if (missing := WIDTH - worlds) > 0:  # the last world fills up a vector
        leaves = [jnp.concatenate([leaf, *[leaf[..., -1:]] * missing], axis=-1) for leaf in leaves]
    found = [x[..., :worlds] for x in program.call(leaves, max(worlds, WIDTH))]
    return jax.tree.unflatten(jax.tree.structure(program.shapes), found)


def cpu_kernel_of_one(function: Callable[..., Any], args: tuple[Any, ...], many: tuple[bool, ...]) -> Any:
    """`jax.vmap` of a function of one world. `many`: for each leaf of `args`, whether its first axis is of worlds.

    Raises:
      NotImplementedError: the function does something else than arithmetic.
    """
    leaves, program = jax.tree.leaves(args), _program_of_one(function, args, many)
    worlds = next(len(leaf) for leaf, own in zip(leaves, many, strict=True) if own)
    missing = -worlds % WIDTH  # the last world fills up a vector

    def passed(leaf: Array, kind: Kind) -> Array:
        leaf = jax.random.key_data(leaf) if _is_key(leaf.dtype) else leaf
        if kind.role != "uniform" and missing:
            leaf = jnp.concatenate([leaf, *[leaf[-1:]] * missing])
        return jnp.moveaxis(leaf, 0, -1) if kind.role == "rows" else leaf

    def result(array: Array, kind: Kind, shape: Any) -> Array:
        array = (jnp.moveaxis(array, -1, 0) if kind.role == "rows" else array)[:worlds]
        return jax.random.wrap_key_data(array, impl=shape.dtype._impl) if _is_key(shape.dtype) else array

    found = program.call([*map(passed, leaves, program.given)], worlds + missing)
    shapes, structure = jax.tree.flatten(program.shapes)
    return structure.unflatten(map(result, found, program.found, shapes))


def why_not(function: Callable[..., Any], args: tuple[Any, ...], many: tuple[bool, ...]) -> str | None:
    """Return the reason why `cpu_kernel_of_one` cannot do what a function does; None if it can."""
    try:
        _program_of_one(function, args, many)
    except NotImplementedError as reason:
        return str(reason)
    return None


def _program_of_one(function: Callable[..., Any], args: tuple[Any, ...], many: tuple[bool, ...]) -> Program:
    leaves, structure = jax.tree.flatten(args)
    kinds = [
        Kind(leaf.shape[1:], leaf.dtype) if own else Kind(leaf.shape, leaf.dtype, "uniform")
        for leaf, own in zip(leaves, many, strict=True)
    ]
    return _program(function, structure, tuple(kinds), True)


@lru_cache
def _program(function: Callable[..., Any], structure: Any, kinds: tuple[Kind, ...], single: bool = False) -> Program:
    """A function as LLVM's code, written once whatever the number of worlds.

    `single`: the function is of one world, and its arrays have no axis of worlds.
    """
    axis = () if single else (1,)
    like = [jax.ShapeDtypeStruct((*kind.shape, *axis), kind.dtype) for kind in kinds]
    traced, shapes = jax.make_jaxpr(function, return_shape=True)(*structure.unflatten(like))
    given, found, in_place = [_of_words(kind) for kind in kinds], [], {}
    for place in looked_up(traced.jaxpr) if single else ():
        if given[place].role == "rows":
            given[place] = given[place]._replace(role="memory")

    def results(numbers: Sequence[Array]) -> list[Array]:
        """The numbers of all results that are not in memory."""
        threads, rest = Threads(1, _own, _own, jnp.any, Words, Table, single), iter(numbers)
        args = [
            threads.given(Given(place, kind.size), kind.shape, kind.dtype)
            if kind.role == "memory"
            else arranged([next(rest) for _ in range(kind.size)], (*kind.shape, *axis))
            for place, kind in enumerate(given)
        ]
        arrays = threads.evaluate(traced, args)
        for place, (array, shape) in enumerate(zip(arrays, jax.tree.leaves(shapes), strict=True)):
            kind = _of_words(Kind(shape.shape[: len(shape.shape) - len(axis)], shape.dtype))
            if isinstance(array, Kept) and array.region.given:
                array.check()
                in_place[array.region.number], kind = place, kind._replace(role="memory")
            else:
                rows.extend(threads.alike(array))
            found.append(kind)
        return rows

    rows: list[Array] = []
    numbers = [
        jax.ShapeDtypeStruct(() if kind.role == "uniform" else (THREADS,), kind.dtype)
        for kind in given
        for _ in range(0 if kind.role == "memory" else kind.size)
    ]
    return Program(_code(jax.make_jaxpr(results)(numbers), given, found), given, found, shapes, in_place)


def _is_key(dtype: Any) -> bool:
    return jnp.issubdtype(dtype, jax.dtypes.prng_key)


def _of_words(kind: Kind) -> Kind:
    """The kind of an array; of random keys that of their words."""
    if _is_key(kind.dtype):
        return kind._replace(shape=(*kind.shape, *kind.dtype._impl.key_shape), dtype=np.dtype(np.uint32))
    return kind._replace(dtype=np.dtype(kind.dtype))


@lru_cache
def _compiled_of(code: str) -> str:
    """The name by which XLA calls LLVM's code, once it is compiled."""
    code += CALL.replace("MAJOR", str(_version()[0])).replace("MINOR", str(_version()[1]))
    name = f"humanoid_mjx_{hashlib.sha256((code + _machine()).encode()).hexdigest()[:32]}"
    if name not in _fresh:
        register({name: _compiled(name, code)})
        _fresh.add(name)
    return name


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
    _program.cache_clear()
    _compiled_of.cache_clear()
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


def _code(traced: Any, given: Sequence[Kind], found: Sequence[Kind]) -> str:
    """LLVM's code of a function of vectors, from the arrays that it is given to those that are found."""
    code = Code()
    values = lower(code, traced, [_loaded(code, place) for place in _places(code, "given", given)])
    for value, place in zip(values, _places(code, "found", found), strict=True):
        _stored(code, value, place)
    tables = [
        f"@table{number} = private constant [{len(table)} x i32] [{', '.join(f'i32 {word}' for word in table)}]"
        for table, number in code.tables.items()
    ]
    memory = [
        f"  %region{number} = alloca [{words * WIDTH} x i32], align {4 * WIDTH}"
        for number, words in code.regions.items()
    ]
    axis = AXIS.replace("FIRST", "true" if found[0].role == "memory" else "false")
    return "\n".join([axis, *tables, *sorted(code.declared), BLOCK, *memory, *code.lines, "  ret void\n}"])


AXIS = """
define internal i64 @axis(i64 %rank) {
  %last = sub i64 %rank, 1
  %axis = select i1 FIRST, i64 0, i64 %last
  ret i64 %axis
}"""
"""Number of the axis of worlds in the first result."""

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
  %axis = call i64 @axis(i64 %rank)
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


class Place(NamedTuple):
    """Address of a number of each world, or of one for all."""

    address: str
    dtype: np.dtype
    uniform: bool


def _places(code: Code, arrays: str, kinds: Sequence[Kind]) -> list[Place]:
    """The places of the numbers of arrays, `given` or `found`, that are not in memory. Memory gets a name."""
    places = []
    for index, kind in enumerate(kinds):
        if kind.role == "memory" and arrays == "found":
            continue
        at = code.value(f"getelementptr ptr, ptr %{arrays}, i64 {index}")
        buffer = code.value(f"load ptr, ptr {at}, align 8")
        at = code.value(f"getelementptr i8, ptr {buffer}, i64 24")
        data, size = code.value(f"load ptr, ptr {at}, align 8"), kind.dtype.itemsize
        if kind.role == "memory":
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
            places.append(Place(place, kind.dtype, kind.role == "uniform"))
    return places


def _loaded(code: Code, at: Place) -> Value:
    flags = at.dtype.kind == "b"
    kind = type_of(np.int8 if flags else at.dtype, at.uniform)
    name = code.value(f"load {kind}, ptr {at.address}, align {1 if flags else 4}")
    name = code.value(f"trunc {kind} {name} to {type_of(bool, at.uniform)}") if flags else name
    return Value(name, at.dtype, at.uniform)


def _stored(code: Code, value: Value, at: Place) -> None:
    name, place = code.vector(value), at.address
    if value.dtype.kind != "b":
        code.add(f"store {type_of(value.dtype, False)} {name}, ptr {place}, align 4")
        return
    flags = code.value(f"zext <{WIDTH} x i1> {name} to <{WIDTH} x i8>")
    code.add(f"store <{WIDTH} x i8> {flags}, ptr {place}, align 1")
