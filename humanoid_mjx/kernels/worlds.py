"""`jax.vmap` with the axis of worlds last, for functions that are written for many worlds.

The worlds of one scalar are then contiguous in memory, whatever axes of lanes or contacts precede them; by default
`jax.vmap` puts the axis of worlds first. Nested maps (runs of worlds) become one axis, so no loop is mapped over loops.
"""

import math
from collections.abc import Callable, Sequence
from functools import lru_cache, partial
from typing import Any

import jax
import jax.numpy as jnp
from jax.core import Tracer
from jax.custom_batching import custom_vmap
from jax.experimental.layout import Layout, with_layout_constraint
from jax.extend.core import ClosedJaxpr, jaxpr_as_fun

from humanoid_mjx.kernels import cpu_kernel as cpu
from humanoid_mjx.kernels import fallback
from humanoid_mjx.kernels import gpu_kernel as gpu
from humanoid_mjx.kernels.cpu_kernel import cpu_kernel
from humanoid_mjx.kernels.gpu_kernel import gpu_kernel
from humanoid_mjx.kernels.llvm import together
from humanoid_mjx.kernels.memory import THREADS
from humanoid_mjx.kernels.signature import called, signature_of_one


def kernel(function: Callable[..., Any]) -> Callable[..., Any]:
    """`function`, which is written for one world, such that `jax.vmap` of it, once or nested, is a kernel.

    The function takes and returns pytrees of arrays; `docs/kernels.md` says what it may do. Of any other function, of
    derivatives and outside `jax.vmap` XLA makes the program.
    """

    @jax.custom_jvp
    def call(*args: Any) -> Any:
        leaves, structure = jax.tree.flatten(args)
        return _mapped(function, structure, (False,) * len(leaves))(*leaves)

    call.defjvp(lambda args, tangents: jax.jvp(function, args, tangents))
    return lambda *args: call(*jax.tree.map(jnp.asarray, args))


def _mapped(function: Callable[..., Any], structure: Any, many: tuple[bool, ...]) -> Callable[..., Any]:
    """`kernel` of a function's leaves, of which those of `many` have a first axis of worlds; `jax.vmap` adds to it."""

    @custom_vmap
    def call(*leaves: Any) -> Any:
        if not any(many):
            return function(*structure.unflatten(leaves))
        if not fallback.why_none():
            args, (_, call, _) = structure.unflatten(leaves), BACK_ENDS[jax.default_backend()]
            try:
                if not why_not(function, args, many):
                    return called(signature_of_one(function, args, many), args, _block(leaves, many), call)
            except Exception as error:  # whatever it is, XLA does not need it
                fallback.warn(error)
        axes = [0 if own else None for own in many]
        return jax.vmap(lambda *each: function(*structure.unflatten(each)), axes)(*leaves)

    @call.def_vmap
    def _(runs: int, batched: list[bool], *leaves: Any) -> tuple[Any, Any]:
        """Runs of worlds are so many worlds."""
        pairs = list(zip(batched, many, strict=True))
        shape = runs, *[leaf.shape[flag] for leaf, (flag, own) in zip(leaves, pairs, strict=True) if own][:1]

        def merged(leaf: Any, flag: bool, own: bool) -> Any:
            if not (flag or own):
                return leaf
            leaf = leaf if flag else leaf[None]
            leaf = leaf if own or not any(many) else leaf[:, None]
            one = leaf.shape[len(shape) :]
            return jnp.broadcast_to(leaf, (*shape, *one)).reshape(math.prod(shape), *one)

        worlds = [merged(leaf, *pair) for leaf, pair in zip(leaves, pairs, strict=True)]
        found = _mapped(function, structure, tuple(map(any, pairs)))(*worlds)
        found = jax.tree.map(lambda x: x.reshape(*shape, *x.shape[1:]), found)
        return found, jax.tree.map(lambda _: True, found)

    return call


def kernel_here(function: Callable[..., Any], *args: Any) -> Any:
    """`kernel(function)(*args)` of a function that uses traced arrays of its surroundings."""
    closed, shapes = jax.make_jaxpr(function, return_shape=True)(*args)
    traced = [isinstance(value, Tracer) for value in closed.consts]
    known = [None if flag else value for flag, value in zip(traced, closed.consts, strict=True)]
    structure = jax.tree.structure(shapes)

    def whole(own: list[Any], *args: Any) -> Any:
        rest = iter(own)
        consts = [next(rest) if flag else value for flag, value in zip(traced, known, strict=True)]
        return structure.unflatten(jaxpr_as_fun(ClosedJaxpr(closed.jaxpr, consts))(*jax.tree.leaves(args)))

    own = [value for flag, value in zip(traced, closed.consts, strict=True) if flag]
    return kernel(whole)(own, *args)


BACK_ENDS = {
    "cpu": (together, cpu.call, cpu.written),
    "gpu": (lambda _: THREADS, gpu.call, lambda known, _: gpu.kinds_of_results(known)),
}
"""By backend: the number of worlds that a kernel computes together, its call, and a function of a signature and that
number that raises NotImplementedError if there is no such kernel."""


def why_not(function: Callable[..., Any], args: tuple[Any, ...], many: tuple[bool, ...]) -> str | None:
    """Return the reason why no kernel can do what a function does, if so; `many`: which leaves of `args`, arrays or
    their shapes, have a first axis of worlds."""
    try:
        write = BACK_ENDS[jax.default_backend()][2]
        write(signature_of_one(function, args, many), _block(jax.tree.leaves(args), many))
    except NotImplementedError as reason:
        return str(reason)
    except Exception as error:  # whatever it is, XLA does not need it
        return fallback.warn(error)
    return None


def _block(leaves: Sequence[Any], many: tuple[bool, ...]) -> int:
    """Return the number of worlds that a kernel of these arguments computes together; see `why_not`."""
    worlds = next(leaf.shape[0] for leaf, own in zip(leaves, many, strict=True) if own)
    return BACK_ENDS[jax.default_backend()][0](worlds)


def one_world(function: Callable[..., Any], *static: Any) -> Callable[..., Any]:
    """`function`, with `static` for its first arguments, of arrays without an axis of worlds.

    `function` computes one world, and is written for arrays with a last axis of length 1.
    """
    written = jax.jit(partial(function, *static))  # lowered once however often a program calls it

    return lambda *args: _alone(written, args)


def _alone(function: Callable[..., Any], args: tuple[Any, ...]) -> Any:
    """Call a function of arrays with a last axis of worlds for one world, whose arrays have none."""
    found = function(*jax.tree.map(lambda x: jnp.asarray(x)[..., None], args))
    return jax.tree.map(lambda x: x[..., 0] if jnp.ndim(x) else jnp.asarray(x), found)


@lru_cache
def one_kernel(function: Callable[..., Any], *static: Any, lanes: int = 1) -> Callable[..., Any]:
    """`one_world(function, *static)`, such that `jax.vmap` of it, once or nested, is one kernel.

    The function takes and returns pytrees of arrays. It is traced once for each number of worlds, whatever programs use
    it. On a GPU a world has a thread for each of so many `lanes`, and a world alone is computed by XLA.
    """
    written, on_cpu = jax.jit(partial(function, *static)), jax.default_backend() == "cpu"
    kernel = jax.jit(partial(cpu_kernel, written) if on_cpu else partial(gpu_kernel, written, lanes=lanes))
    by_xla = jax.vmap(one_world(function, *static), in_axes=-1, out_axes=-1)

    def computed(*args: Any) -> Any:
        alone = jax.tree.leaves(args)[0].shape[-1] == 1
        if not fallback.given_up and (on_cpu or not alone):
            try:
                return kernel(*args)
            except Exception as error:  # whatever it is, XLA does not need it
                fallback.by_xla_instead(error)
        return by_xla(*args)

    return worlds_last(computed, contiguous=True)


@lru_cache
def worlds_last(function: Callable[..., Any], *static: Any, contiguous: bool = False) -> Callable[..., Any]:
    """`function`, with `static` for its first arguments, as one of a single world.

    Under `jax.vmap`, once or nested, the function gets all worlds at once, in the last axis of every array. It takes
    and returns pytrees of arrays, and must not mix worlds. `contiguous`: see `_contiguous`.
    """
    written = partial(function, *static)

    many = custom_vmap(written)

    @many.def_vmap
    def _(runs: int, batched: Any, *args: Any) -> tuple[Any, Any]:
        def merged(x: Any, flag: bool) -> Any:
            whole = (*x.shape[:-1], runs, x.shape[-1])
            x = jnp.moveaxis(x, 0, -2) if flag else jnp.broadcast_to(x[..., None, :], whole)
            return x.reshape(*x.shape[:-2], -1)

        found = many(*jax.tree.map(merged, args, tuple(batched)))
        found = jax.tree.map(lambda x: jnp.moveaxis(x.reshape(*x.shape[:-1], runs, -1), -2, 0), found)
        return found, jax.tree.map(lambda _: True, found)

    batched = custom_vmap(lambda *args: _alone(written, args))

    @batched.def_vmap
    def _(worlds: int, batched: Any, *args: Any) -> tuple[Any, Any]:
        def last(x: Any, flag: bool) -> Any:
            return jnp.moveaxis(x, 0, -1) if flag else jnp.broadcast_to(x[..., None], (*jnp.shape(x), worlds))

        found = many(*jax.tree.map(last, args, tuple(batched)))
        found = jax.tree.map(lambda x: jnp.moveaxis(x, -1, 0), found)
        return jax.tree.map(_contiguous, found) if contiguous else found, jax.tree.map(lambda _: True, found)

    return batched


@custom_vmap
def _contiguous(x: Any) -> Any:
    """An array whose first axis is that of worlds, these contiguous in memory.

    XLA:GPU would make the last axis contiguous, and transpose what a kernel gives and takes in each time step.
    """
    return with_layout_constraint(x, Layout((*range(1, x.ndim), 0)))


@_contiguous.def_vmap
def _(runs: int, batched: Any, x: Any) -> tuple[Any, Any]:
    return with_layout_constraint(x, Layout((*range(2, x.ndim), 0, 1))), True
