"""Training compiled for runs side by side, on as many devices as there are."""

from collections.abc import Callable, Sequence
from concurrent.futures import Future
from functools import lru_cache, partial
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jax.sharding import Mesh, NamedSharding, PartitionSpec, SingleDeviceSharding
from jaxtyping import Array, Bool

from humanoid_mjx import compute
from humanoid_mjx.learners import Learner
from humanoid_mjx.learners.base import ENVS
from humanoid_mjx.training.program import Progress, Training, advance, begin, finish, progress_of, run_key
from humanoid_mjx.types import Device, IntScalar

RUNS = "runs"
"""The axis of a mesh of devices over which runs are shared out."""


class Programs(NamedTuple):
    """Compiled functions over runs side by side; every array has a leading axis of runs, shared out over the devices.

    Each device computes its runs by itself: the program is compiled once, and none waits for another within it. Where
    the mesh has several devices along `ENVS`, these have the same runs and a part of the environments each.
    """

    begin: Callable[..., Training]
    """(fresh, learners, seeds, training states, policies) -> training states, new where `fresh` is true."""
    advance: Callable[[Any, Training, IntScalar], tuple[Training, Progress]]
    """(learners, training states, steps) -> states so many steps later, and progress. Gives up the old states."""
    finish: Callable[[Any, Training, Any], dict[str, Any]]
    """(learners, training states, seeds) -> curves, final scores and policies."""
    compiled: "dict[Any, Future[Callable[..., Any]]]"
    """What was or is being compiled of them, by name and kind of arguments: a second sweep in a process does not trace
    them."""


@lru_cache
def programs(
    options: tuple[tuple[str, str | bool], ...], mesh: Mesh, training: Training, fused: bool = False
) -> Programs:
    """The programs of all learners with these compiler options on the devices of `mesh`.

    `seeds` is (the config's seed, the seed number). `training` says how training states lie on the mesh, as
    `layout_of` has it. Where `fused` the kernel of `training.fused` makes the steps.
    """
    by_run, same, split = PartitionSpec(RUNS), PartitionSpec(), mesh.shape[ENVS]

    def anew(fresh: Bool[Array, ""], learner: Learner, seeds: Any, old: Training, policy: Any) -> Training:
        new = begin(learner.split_over(split), run_key(*seeds), policy)
        return jax.tree.map(partial(jnp.where, fresh), new, old)

    def further(learner: Learner, old: Training, steps: IntScalar) -> tuple[Training, Progress]:
        return advance(learner.split_over(split), old, steps)

    def end(learner: Learner, last: Training, seeds: Any) -> dict[str, Any]:
        return finish(learner.split_over(split), last, jax.random.fold_in(run_key(*seeds), 1))

    def by_kernel(learners: Any, old: Training, steps: IntScalar) -> tuple[Training, Progress]:
        from humanoid_mjx.training import fused  # whose import takes time that all others save

        new = fused.advance(learners, old, steps)
        return new, jax.vmap(progress_of)(learners, new)

    def compiled(function: Callable[..., Any], given: Any, found: Any, **options_of_jit: Any) -> Callable[..., Any]:
        spread = function
        if mesh.size > 1:  # in which all is traced anew that planning has traced
            spread = jax.shard_map(function, mesh=mesh, in_specs=given, out_specs=found, check_vma=False)
        # By itself jax says of arrays without entries that every device has them whole, and a compiled program then
        # refuses the states that another one has made.
        lying = jax.tree.map(partial(placed, mesh), found)
        return jax.jit(spread, compiler_options=dict(options), out_shardings=lying, **options_of_jit)

    train = by_kernel if fused else jax.vmap(further, in_axes=(0, 0, None))
    return Programs(
        begin=compiled(jax.vmap(anew), (by_run, by_run, by_run, training, by_run), training, donate_argnums=3),
        advance=compiled(train, (by_run, training, same), (training, by_run), donate_argnums=1),
        finish=compiled(jax.vmap(end), (by_run, training, by_run), by_run),
        compiled={},
    )


def programs_of(learners: Learner, devices: Sequence[Device], share: int = 1) -> Programs:
    """The programs that train learners such as these, which stand side by side, on the given devices.

    `share`: how many of the devices share the environments of each run.

    On a GPU tables that the kernel of `training.fused` can train are trained by it.
    """
    alone = len(devices) == 1
    options = compute.compiler_options(learners.task.arithmetic, learners.program, every_device=not alone)
    fused = False
    if jax.default_backend() == "gpu":
        from humanoid_mjx.training.fused import why_not  # whose import takes time that all others save

        fused = why_not(learners) is None
    return programs(tuple(sorted(options.items())), mesh_of(devices, share), layout_of(learners), fused)


def arranged(learners: Learner, runs: int, room: int) -> tuple[int, Sequence[Device], int]:
    """How so many runs train side by side, where the devices of this process have `room` for as many at once.

    Returns:
      how many runs each device, or each group of devices that share a run, trains at once; the devices; how many of
      these share a run.
    """
    share = devices_of_a_run(learners, runs)
    devices = jax.local_devices()[: min(runs, room) * share]
    return min(room * share // len(devices), -(-runs * share // len(devices))), devices, share


def devices_of_a_run(learners: Learner, runs: int) -> int:
    """How many devices share the environments of each run: several where there are fewer runs than GPUs.

    Cores of a CPU share a run's arrays as they are.
    """
    most = 1 if jax.default_backend() == "cpu" else jax.local_device_count() // runs
    return next((share for share in range(most, 1, -1) if learners.can_split(share)), 1)


def mesh_of(devices: Sequence[Device], share: int = 1) -> Mesh:
    """Devices for runs to be shared out over them; `share` of them share the environments of each run."""
    return Mesh(np.array(devices).reshape(-1, share), (RUNS, ENVS))


def placed(mesh: Mesh, spec: PartitionSpec) -> NamedSharding | SingleDeviceSharding:
    """How an array lies on a mesh. On one device it lies as any array does, so that functions which were traced of such
    ones need not be traced again."""
    return NamedSharding(mesh, spec) if mesh.size > 1 else SingleDeviceSharding(mesh.devices.item())


def layout_of(learners: Learner) -> Training:
    """How training states lie on a mesh of devices: the beginnings of their branches."""
    by_run: Any = PartitionSpec(RUNS)
    return Training(learners.layout(by_run, PartitionSpec(RUNS, ENVS)), by_run, by_run, by_run)
