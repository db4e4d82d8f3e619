"""Training states as plain arrays, to be written and read back bit by bit; and the policies of an earlier run."""

from pathlib import Path
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np

from humanoid_mjx.compute import rng
from humanoid_mjx.runs.archive import check_finite
from humanoid_mjx.runs.folder import read_config
from humanoid_mjx.runs.tables import finished_runs, kept_runs
from humanoid_mjx.spec import InputError
from humanoid_mjx.training.plan import Group


def to_arrays(tree: Any, prefix: str) -> dict[str, np.ndarray]:
    """The leaves of a pytree by path; random keys as their words."""
    leaves = jax.tree_util.tree_leaves_with_path(tree)
    return {prefix + jax.tree_util.keystr(path): np.asarray(_plain(leaf)) for path, leaf in leaves}


def from_arrays(like: Any, arrays: dict[str, np.ndarray], prefix: str, where: str) -> Any:
    """The pytree of `to_arrays` again. Raise an InputError unless it has the structure, shapes and dtypes of `like`."""

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


def earlier_policies(group: Group) -> Any:
    """The policies that a group's runs start from, with a leading axis of runs; None where they start anew. Thesis
    section 6.4: "the next time it executes with the old values".

    Each run starts from the earlier run of the same point and seed; a single earlier point serves all points, and a
    single earlier run all runs.

    Raises:
      InputError: the run folder that `start_from` names cannot serve.
    """
    name = group.learners.start_from
    if name is None:
        return None
    path, where = Path(name), f"learner.start_from: {name}"
    try:
        read_config(path)
    except InputError as error:
        raise InputError(f"learner.start_from: {error}") from error
    arrays = kept_runs(path, ("point", "seed"))
    if not arrays:
        raise InputError(f"{where}: holds no finished run.")
    points, seeds = np.divmod(np.tile(group.first_runs, group.rungs), group.seeds)
    if len(np.unique(arrays["point"])) == 1:
        points = np.full_like(points, arrays["point"][0])
    if len(arrays["point"]) == 1:
        seeds = np.full_like(seeds, arrays["seed"][0])
    arrays = finished_runs(path, ("point", "seed", "policy"), *np.unique(points).tolist())
    place = {pair: i for i, pair in enumerate(zip(arrays["point"].tolist(), arrays["seed"].tolist(), strict=True))}
    wanted = list(zip(points.tolist(), seeds.tolist(), strict=True))
    if missing := [pair for pair in wanted if pair not in place]:
        raise InputError(f"{where}: holds no run of point {missing[0][0]} with seed {missing[0][1]}.")
    rows = np.array([place[pair] for pair in wanted])
    like = jax.tree.map(lambda leaf: jax.ShapeDtypeStruct((len(rows), *leaf.shape), leaf.dtype), group.policy)
    chosen = {key: array[rows] for key, array in arrays.items() if key.startswith("policy")}
    check_finite(chosen, f"{where}: a policy")
    return from_arrays(like, chosen, "policy", where)
