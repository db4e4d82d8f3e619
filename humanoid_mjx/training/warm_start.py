"""Start from what an earlier run learned (thesis section 6.4: "the next time it executes with the old values")."""

from pathlib import Path
from typing import Any

import jax
import numpy as np

from humanoid_mjx.runs.archive import check_finite
from humanoid_mjx.runs.folder import read_config
from humanoid_mjx.runs.tables import kept_runs
from humanoid_mjx.spec import InputError
from humanoid_mjx.training.plan import Group
from humanoid_mjx.training.state import from_arrays


def earlier_policies(group: Group) -> Any:
    """The policies that a group's runs start from, with a leading axis of runs; None where they start anew.

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
    arrays = kept_runs(path, ("point", "seed", "policy"))
    if not arrays:
        raise InputError(f"{where}: holds no finished run.")
    points, seeds = np.divmod(np.tile(group.first_runs, group.rungs), group.seeds)
    if len(np.unique(arrays["point"])) == 1:
        points = np.full_like(points, arrays["point"][0])
    if len(arrays["point"]) == 1:
        seeds = np.full_like(seeds, arrays["seed"][0])
    place = {pair: i for i, pair in enumerate(zip(arrays["point"].tolist(), arrays["seed"].tolist(), strict=True))}
    wanted = list(zip(points.tolist(), seeds.tolist(), strict=True))
    if missing := [pair for pair in wanted if pair not in place]:
        raise InputError(f"{where}: holds no run of point {missing[0][0]} with seed {missing[0][1]}.")
    rows = np.array([place[pair] for pair in wanted])
    like = jax.tree.map(lambda leaf: jax.ShapeDtypeStruct((len(rows), *leaf.shape), leaf.dtype), group.policy)
    chosen = {key: array[rows] for key, array in arrays.items() if key.startswith("policy")}
    check_finite(chosen, f"{where}: a policy")
    return from_arrays(like, chosen, "policy", where)
