"""Replay a run that stopped at numbers that were not finite."""

from pathlib import Path
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np

from humanoid_mjx.config import parse
from humanoid_mjx.learners import Learner
from humanoid_mjx.runs.folder import diverged_name, read_arrays, read_config
from humanoid_mjx.spec import InputError
from humanoid_mjx.training.plan import make_plan
from humanoid_mjx.training.state import from_arrays


class Replay(NamedTuple):
    """A run just before it broke: `learner.train_step(carry)` takes the step that breaks it."""

    learner: Learner
    carry: Any


def replay(path: Path | str, point: int, seed: int) -> Replay:
    """The state of a diverged run of the run folder `path`.

    Raises:
      InputError: no such run diverged there, or its file is damaged.
    """
    path = Path(path)
    plan = make_plan(parse(read_config(path), str(path / "config.yaml")))
    file = path / diverged_name(point, seed)
    if not file.is_file():
        known = sorted(file.stem for file in path.glob("checkpoint/diverged-*.npz"))
        raise InputError(f"{file}: point {point} with seed {seed} did not diverge; here {known or 'nothing'} did.")
    (group,) = (group for group in plan.groups if point in group.points)
    row = int(np.searchsorted(group.points, point))
    training = from_arrays(group.one_run, read_arrays(file), "training", str(file))
    return Replay(group.learner(row), jax.tree.map(jnp.asarray, training.carry))
