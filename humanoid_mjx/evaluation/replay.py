"""Replay a run that stopped at numbers that were not finite, and remarks on such runs and others."""

import re
from collections.abc import Mapping
from pathlib import Path
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np

from humanoid_mjx.compute import compiler_options
from humanoid_mjx.config import parse
from humanoid_mjx.learners import Learner
from humanoid_mjx.runs.folder import diverged_name, read_arrays, read_config
from humanoid_mjx.runs.ranking import fallen_in_words, rungs_in_words
from humanoid_mjx.spec import InputError
from humanoid_mjx.training.plan import make_plan
from humanoid_mjx.training.program import Training
from humanoid_mjx.training.progress import counted
from humanoid_mjx.training.state import from_arrays


class Replay(NamedTuple):
    """A run just before it broke: `learner.train_step(carry)` takes the step that breaks it."""

    learner: Learner
    carry: Any
    training: Training


def replay(folder: Path | str, point: int, seed: int) -> Replay:
    """The state of a diverged run of a run folder.

    Raises:
      InputError: no such run diverged there, or its file is damaged.
    """
    path = Path(folder)
    plan = make_plan(parse(read_config(path), str(path / "config.yaml")))
    file = path / diverged_name(point, seed)
    if not file.is_file():
        known = sorted(file.stem for file in path.glob("checkpoint/diverged-*.npz"))
        raise InputError(f"{file}: point {point} with seed {seed} did not diverge; here {known or 'nothing'} did.")
    (group,) = (group for group in plan.groups if point in group.points)
    row = int(np.searchsorted(group.points, point))
    training = jax.tree.map(jnp.asarray, from_arrays(group.one_run, read_arrays(file), "training", str(file)))
    return Replay(group.learner(row), training.carry, training)


def remarks(path: Path, summary: Mapping[str, np.ndarray]) -> list[str]:
    """Return sentences on a run folder that its tables do not say: on rungs, on runs that stopped, and on those that
    learned to end their episodes early."""
    words = rungs_in_words(summary), why_stopped(path, summary), fallen_in_words(path, summary)
    return [each for each in words if each]


def why_stopped(path: Path, summary: Mapping[str, np.ndarray]) -> str:
    """Sentences on the runs of a run folder that stopped at numbers that were not finite: how many, and of the first
    which number, when, and how to look at it; empty if none did."""
    stopped = np.flatnonzero(summary["diverged"])
    if not len(stopped):
        return ""
    words = f"{counted(len(stopped), 'run')} stopped at numbers that were not finite; the summary marks them."
    point, seed = (int(summary[name][stopped[0]]) for name in ("point", "seed"))
    try:
        learner, _, training = replay(path, point, seed)
    except InputError:  # an earlier version kept no state
        return words
    what, share = _culprit(learner, training)
    unit, done = learner.unit.removeprefix("total_").rstrip("s"), round(share * float(learner.budget))
    call = f"humanoid_mjx.evaluation.replay.replay({str(path)!r}, {point}, {seed})"
    first = f"Point {point} with seed {seed} stopped after {unit} {done:,}; not finite: {what}."
    return f"{words} {first} In Python, {call} returns its last state."


def _culprit(learner: Learner, training: Training) -> tuple[str, float]:
    """The number of a diverged run that is not finite, in words, and the share of training that was done."""
    if learner.lap > 1:  # it went on to its end; its curve tells since when
        bad = ~np.isfinite(np.asarray(training.record)).all(axis=1)
        share = bad.argmax() / learner.record if bad.any() else float(learner.progress(training.carry))
        return "the reward" if bad.any() else "a value of the policy", share
    options = compiler_options(learner.task.arithmetic, learner.program)
    step = jax.jit(lambda learner, carry: learner.train_step(carry), compiler_options=options)
    leaves = jax.tree_util.tree_leaves_with_path(step(learner, training.carry))
    numbers = [(jax.tree_util.keystr(path), x) for path, x in leaves if jnp.issubdtype(x.dtype, jnp.floating)]
    broken = " ".join(place for place, x in numbers if not np.isfinite(np.asarray(x)).all())
    share, terms = float(learner.progress(training.carry)), set(re.findall(r"\.totals\['(.*?)'\]", broken))
    if "obs" in broken or ".moments.mean" in broken:
        return "an observation", share
    if terms:
        return " ".join(["the reward", *sorted(terms - {"return"})]), share
    what = "the loss" if ".squares[" in broken else "a weight"
    return f"{what} (try a smaller learner.learning_rate)", share
