"""Training compiled for runs side by side, on as many devices as there are."""

from collections.abc import Callable, Sequence
from concurrent.futures import Future
from functools import lru_cache, partial
from typing import Any, TypeAlias

import jax
import jax.numpy as jnp
import numpy as np
from jax.extend.core import jaxpr_as_fun
from jax.sharding import Mesh, NamedSharding, PartitionSpec, SingleDeviceSharding
from jaxtyping import Array, Bool

from humanoid_mjx import compute
from humanoid_mjx.compute import rng
from humanoid_mjx.compute.ways import ways
from humanoid_mjx.kernels import fallback
from humanoid_mjx.kernels.worlds import kernel, why_not
from humanoid_mjx.learners import Learner
from humanoid_mjx.learners.base import ENVS
from humanoid_mjx.learners.tabular import TabularQ
from humanoid_mjx.training.program import Progress, Training, begin, finish, progress_of, run_key, train
from humanoid_mjx.types import Device, IntScalar

TRAIN = kernel(train)
"""Training steps as a kernel, where they are arithmetic: of tables."""

Devices: TypeAlias = Sequence[Device] | np.ndarray
"""Devices that train runs each, or (rows, devices): rows of devices that share the environments of runs."""

RUNS = "runs"
"""The axis of a mesh of devices over which runs are shared out."""


class Programs:
    """Compiled functions over runs side by side; every array has a leading axis of runs, shared out over the devices.

    Each device computes its runs by itself: the program is compiled once, and none waits for another within it. Where
    the mesh has several devices along `ENVS`, these have the same runs, and share the environments in training.
    """

    def __init__(self, options: tuple[tuple[str, str | bool], ...], mesh: Mesh, by_kernel: bool = False):
        """The programs of all learners with these compiler options on the devices of `mesh`.

        `seeds` is (the config's seed, the seed number). `by_kernel`: let a kernel make the steps, if one can.
        """
        by_run, same = PartitionSpec(RUNS), PartitionSpec()

        def anew(fresh: Bool[Array, ""], learner: Learner, seeds: Any, old: Training, policy: Any) -> Training:
            new = begin(learner, run_key(*seeds), policy)
            return jax.tree.map(partial(jnp.where, fresh), new, old)

        def end(learner: Learner, last: Training, seeds: Any) -> dict[str, Any]:
            return finish(learner, last, jax.random.fold_in(run_key(*seeds), 1))

        def further(learner: Learner, old: Training, steps: IntScalar) -> tuple[Training, Progress]:
            learner = learner.replace(devices=mesh.shape[ENVS]) if mesh.shape[ENVS] > 1 else learner
            new = (TRAIN if by_kernel else train)(learner, old, steps)
            return new, progress_of(learner, new)

        def compiled(function: Callable[..., Any], given: Any, **options_of_jit: Any) -> Callable[..., Any]:
            spread = _shared_out(function, mesh, given) if mesh.size > 1 else function
            # By default jax replicates arrays without entries, and a compiled program then refuses the states that
            # another one has made.
            return jax.jit(spread, compiler_options=dict(options), out_shardings=self.by_run, **options_of_jit)

        self.by_run, self.everywhere = _sharding(mesh, by_run), _sharding(mesh, same)
        """Shardings of arrays with a leading axis of runs, and of those that every device has whole."""
        self.begin = compiled(jax.vmap(anew), by_run, donate_argnums=3)
        """(fresh, learners, seeds, training states, policies) -> training states, new where `fresh` is true."""
        self.advance = compiled(jax.vmap(further, in_axes=(0, 0, None)), (by_run, by_run, same), donate_argnums=1)
        """(learners, training states, steps) -> states so many steps later, and progress. Gives up the old states."""
        self.finish = compiled(jax.vmap(end), by_run)
        """(learners, training states, seeds) -> curves, final scores and policies."""
        self.options = f"{options} {mesh.device_ids.tolist()} {by_kernel}"
        """Key of the programs: everything that they depend on beside their arguments."""
        self.compiled: dict[Any, Future[Callable[..., Any]]] = {}
        """Compiled programs, also those under way, by name and kind of arguments: a second sweep in a process does not
        trace them."""


programs = lru_cache(Programs)


def _shared_out(function: Callable[..., Any], mesh: Mesh, given: Any) -> Callable[..., Any]:
    """`shard_map` of a function whose results are arrays with a leading axis of runs.

    Arrays without entries, such as the chain's warm start, are made on each device and not passed: jaxlib 0.11.2
    crashes when it compiles a `shard_map` that takes one.
    """
    size = mesh.shape[RUNS]

    def part_of(spec: PartitionSpec, leaf: Array) -> jax.ShapeDtypeStruct:
        shape = (leaf.shape[0] // size, *leaf.shape[1:]) if RUNS in spec else leaf.shape
        return jax.ShapeDtypeStruct(shape, leaf.dtype, weak_type=leaf.aval.weak_type)

    def call(*args: Any) -> Any:
        parts = jax.tree.map(lambda spec, tree: jax.tree.map(partial(part_of, spec), tree), given, args)
        known = function if mesh.shape[ENVS] > 1 else _traced(function, parts)

        def on_device(*passed: Any) -> Any:
            return known(*jax.tree.map(whole, parts, passed))

        def whole(shape: jax.ShapeDtypeStruct, part: Array | None) -> Array:
            return jnp.zeros(shape.shape, shape.dtype) if part is None else part

        some = jax.tree.map(lambda leaf: leaf if leaf.size else None, args)
        runs = PartitionSpec(RUNS)
        return jax.shard_map(on_device, mesh=mesh, in_specs=given, out_specs=runs, check_vma=False)(*some)

    return call


def _traced(function: Callable[..., Any], shapes: Any) -> Callable[..., Any]:
    """Return the function as traced for these arguments outside of any mesh: what planning has traced is not traced
    again, as it would be within `shard_map`."""
    closed, results = jax.make_jaxpr(function, return_shape=True)(*shapes)
    flat, structure = jaxpr_as_fun(closed), jax.tree.structure(results)
    return lambda *args: jax.tree.unflatten(structure, flat(*jax.tree.leaves(args)))


def programs_of(learners: Learner, devices: Devices) -> Programs:
    """The programs that train learners such as these, which stand side by side, on the given devices.

    A kernel makes the training steps of tables, where one can.
    """
    mesh = Mesh(np.array(devices).reshape(len(devices), -1), (RUNS, ENVS))
    options = compute.compiler_options(learners.task.arithmetic, learners.program, every_device=mesh.size > 1)
    return programs(tuple(sorted(options.items())), mesh, learners.program == "tabular")


def why_no_kernel(learner: Any) -> str | None:
    """Return the reason why XLA makes the training steps of tables, and no kernel; None if a kernel makes them."""
    if not isinstance(learner, TabularQ):
        return "kernels train tables"
    if learner.agents > 1:
        return "several agents feed one table"
    if learner.evaluations > 1:
        return "tables are kept along the way, for evaluation"
    if learner.method == "q_lambda":
        return "each step of q_lambda changes the whole table"
    if reason := fallback.why_none():
        return reason
    shapes = learner, jax.eval_shape(begin, learner, rng.key(0))
    args = jax.tree.map(lambda x: jax.ShapeDtypeStruct((1, *np.shape(x)), jax.typeof(x).dtype), shapes)
    reason = why_not(train, (*args, jax.ShapeDtypeStruct((), np.int32)), (*[True] * len(jax.tree.leaves(args)), False))
    return f"the task {type(learner.task).__name__}: {reason}" if reason else None


def in_turn(learners: Learner, runs: list[int], room: int) -> list[list[int]]:
    """Split runs into full rounds, a run on each device, and a rest of which each has several devices."""
    even = len(runs) - len(runs) % min(room, jax.local_device_count())
    rest = runs[even:]
    shared = bool(rest) and np.shape(placement(learners, len(rest), room)[1])[1] > 1
    return [part for part in ((runs[:even], rest) if shared else (runs,)) if part]


def placement(learners: Learner, runs: int, room: int, width: int | None = None) -> tuple[int, Devices]:
    """Return how many runs each device, or each row of devices that share them, trains at once, and the devices.

    Where a CPU has more cores than there are `runs`, several share the environments of each. Those train one at a time
    on each: a slot that trains nothing costs as much as one that trains. `room`: runs that the devices of this process
    can train at once. `width`: runs that each device trains at once, if that is fixed.
    """
    devices = jax.local_devices()
    shares = range(len(devices), 0, -1) if ways().devices_share_runs else (1,)
    possible = [share for share in shares if learners.can_share(share)]
    each = 1 if len(possible) > 1 else width
    rows = min(-(-runs // (each or 1)), room // (each or 1), len(devices))
    share = next(share for share in possible if rows * share <= len(devices))
    size = each or min(room // rows, -(-runs // rows))
    if isinstance(learners, TabularQ) and learners.agents == 1:
        size = max(size, 2)  # of one table XLA:CPU makes a program of scalars, which it rounds otherwise
    return size, np.array(devices[: rows * share]).reshape(rows, share)


def _sharding(mesh: Mesh, spec: PartitionSpec) -> NamedSharding | SingleDeviceSharding:
    """Return the sharding of an array on a mesh. On one device it is that of any array, so that functions which were
    traced of such ones need not be traced again."""
    return NamedSharding(mesh, spec) if mesh.size > 1 else SingleDeviceSharding(mesh.devices.item())
