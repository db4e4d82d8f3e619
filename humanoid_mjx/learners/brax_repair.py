"""Shims for JAX functions removed in 0.10 that Brax 0.14.2 calls."""

from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from types import ModuleType
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
from jax.sharding import Mesh, NamedSharding, PartitionSpec

from humanoid_mjx.types import Device


@contextmanager
def repaired(module: Any) -> Iterator[None]:
    """Give a module of Brax, in this block, a `jax` that has what it needs. jax itself and all others stay as they are.

    Only what is missing is added, so that on a jax or with a Brax that needs no repair nothing changes.
    """
    original = module.jax
    module.jax = _Jax("jax")
    try:
        yield
    finally:
        module.jax = original


class _Jax(ModuleType):
    def __getattr__(self, name: str) -> Any:
        try:
            return getattr(jax, name)
        except AttributeError:
            if name == "device_put_replicated":
                return device_put_replicated
            raise


def device_put_replicated(tree: Any, devices: Sequence[Device]) -> Any:
    """A copy of every array on each device, in one array with a leading axis of devices.

    The axis has the name that Brax's pmaps give it: from another sharding than theirs training would compile twice.
    """
    sharding = NamedSharding(Mesh(np.array(devices), ("i",)), PartitionSpec("i"))

    def put(leaf: Any) -> jax.Array:
        leaf = jnp.asarray(leaf)
        return jax.device_put(jnp.broadcast_to(leaf, (len(devices), *leaf.shape)), sharding)

    return jax.tree.map(put, tree)
