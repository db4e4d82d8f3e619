"""Training states as plain arrays, to be written and read back bit by bit."""

from typing import Any

import jax
import jax.numpy as jnp
import numpy as np

from humanoid_mjx.compute import rng
from humanoid_mjx.spec import InputError


def to_arrays(tree: Any, prefix: str) -> dict[str, np.ndarray]:
    """The leaves of a pytree by path; random keys as their words."""
    leaves = jax.tree_util.tree_leaves_with_path(tree)
    return {prefix + jax.tree_util.keystr(path): np.asarray(_plain(leaf)) for path, leaf in leaves}


def from_arrays(like: Any, arrays: dict[str, np.ndarray], prefix: str, where: str) -> Any:
    """The pytree of `to_arrays` again; `like` has its structure, shapes and dtypes.

    Raises:
      InputError: the arrays are of another structure.
    """

    def leaf(path: Any, like: Any) -> Any:
        array = arrays.get(prefix + jax.tree_util.keystr(path))
        words = jax.eval_shape(_plain, like)
        if array is None or array.shape != words.shape or array.dtype != words.dtype:
            raise InputError(f"{where}: what it holds does not fit this training.")
        return jax.random.wrap_key_data(jnp.asarray(array), impl=rng.FAST) if _is_key(like) else array

    return jax.tree_util.tree_map_with_path(leaf, like)


def blank(like: Any, size: int) -> Any:
    """A pytree like `like`, every leaf with a leading axis of `size`, full of zeros: of numpy, so that none compiles a
    program of its own, but for random keys."""

    def leaf(like: Any) -> Any:
        words = jax.eval_shape(_plain, like)
        zeros = np.zeros((size, *words.shape), words.dtype)
        return jax.random.wrap_key_data(jnp.asarray(zeros), impl=rng.FAST) if _is_key(like) else zeros

    return jax.tree.map(leaf, like)


def _is_key(leaf: Any) -> bool:
    return jnp.issubdtype(leaf.dtype, jax.dtypes.prng_key)


def _plain(leaf: Any) -> Any:
    return jax.random.key_data(leaf) if _is_key(leaf) else leaf
