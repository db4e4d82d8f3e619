"""Training of any learner: learning curves, snapshots, the guard against NaN, evaluation.

All functions are of one run; `training.programs` compiles them for runs side by side.
"""

from typing import Any, NamedTuple, TypeAlias

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float, Key

from humanoid_mjx.compute import rng
from humanoid_mjx.compute.ways import add_at
from humanoid_mjx.learners import Learner
from humanoid_mjx.learners.base import Outcome
from humanoid_mjx.learners.rollout import greedy, mean_scores
from humanoid_mjx.spec import InputError, ships
from humanoid_mjx.tasks.check import arrays, check_same, fault
from humanoid_mjx.types import BoolScalar, FloatScalar, IntScalar


class Training(NamedTuple):
    """The state of one run under way."""

    carry: Any
    """The learner's own."""
    record: Float[Array, "record measures"]
    """Sums for each point of the learning curve, in the order of `measures`."""
    snapshots: Any
    """The policies at the end of each part of training, for evaluation, and whether there is one: a leading axis of
    `evaluations`, or None."""
    failed: BoolScalar
    """True if the next step leads to numbers that are not finite; training has stopped before it."""


SLACK = 1e-3
"""Share of a part of training by which rounding may move its end."""

SHOWN = ("success", "return", "steps")
"""Columns of a learning curve that show how a run does."""

Progress: TypeAlias = tuple[FloatScalar, Float[Array, "3"]]
"""Share of a run's training that is done, and its scores by `SHOWN`: means over the episodes of the last points of its
curve, or NaN."""


def begin(learner: Learner, key: Key[Array, ""], policy: Any = None) -> Training:
    """The state of a run before its first step."""
    carry = learner.init(key, policy)
    record = jnp.zeros((learner.record, len(measures(learner, carry))))
    snapshots = None
    if learner.evaluations > 1:
        many = (learner.evaluations,)
        snapshots = jax.tree.map(lambda x: jnp.zeros(many + x.shape, x.dtype), _snapshot(learner, carry))
    return Training(carry, record, snapshots, jnp.bool_(False))


def advance(learner: Learner, training: Training, steps: IntScalar) -> tuple[Training, Progress]:
    """Return the state after `train`, and the progress."""
    last = train(learner, training, steps)
    return last, progress_of(learner, last)


def train(learner: Learner, training: Training, steps: IntScalar) -> Training:
    """Train for `steps` steps, or up to a lap more, or less where training ends.

    An episode counts at the point of the curve in which its middle lies, moved so that none lies between two points,
    where rounding would choose; an update of many steps at that of its last step. `plan.Plan.places` are the counts.
    """
    size = learner.update_steps
    middle = size - 1 + (learner.record // 2 + 0.5) / learner.record
    end = learner.budget if size == 1 else jnp.ceil(learner.budget / size) * size

    def step(_: IntScalar, inner: tuple[Any, Array]) -> tuple[Any, Array]:
        carry, outcome = _train_step(learner, inner[0])
        place = (jnp.asarray(outcome.done, jnp.float32) + middle) * (learner.record / end)
        point = jnp.minimum(place.astype(jnp.int32), learner.record - 1)
        values = [jnp.asarray(value, jnp.float32) for value in _recorded(outcome).values()]
        return carry, add_at(inner[1], point, jnp.stack(values, axis=-1))

    def lap(_: IntScalar, old: Training) -> Training:
        """`snapshots` are rows here."""
        inner = old.carry, old.record
        new: Any = step(0, inner) if learner.lap == 1 else jax.lax.fori_loop(0, learner.lap, step, inner)
        failed = old.failed
        if learner.lap == 1:
            failed |= ~_finite(learner.policy(new[0]))
            stop = failed | (learner.progress(old.carry) >= 1.0)
            new = jax.tree.map(lambda new, old: jnp.where(stop, old, new), new, inner)
        snapshots = old.snapshots
        if snapshots is not None:
            parts = learner.evaluations
            ends = jnp.ceil(learner.progress(new[0]) * parts - SLACK).astype(jnp.int32)
            part = jnp.clip(ends - 1, 0, parts - 1)  # that in which the step ends; the last step ends the last part
            snapshots = [
                old.at[part].set(new) for old, new in zip(snapshots, _row(_snapshot(learner, new[0])), strict=True)
            ]
        return Training(new[0], new[1], snapshots, failed)

    kept = training.snapshots
    rows = training if kept is None else training._replace(snapshots=jax.vmap(_row)(kept))
    last = jax.lax.fori_loop(0, (steps + learner.lap - 1) // learner.lap, lap, rows)
    return last if kept is None else last._replace(snapshots=_unrow(last.snapshots, kept))


def _snapshot(learner: Learner, carry: Any) -> tuple[Any, BoolScalar]:
    return learner.policy(carry), jnp.bool_(True)


def _row(tree: Any) -> list[Array]:
    """A pytree as one vector, or one for each type of number in it.

    Rows of snapshots are written at once. One write for each leaf takes longer, and XLA would compute writes of equal
    shapes in one kernel, on which it aborts (`compute.options.XLA_FLAGS`).
    """
    leaves = jax.tree.leaves(tree)
    return [jnp.concatenate([x.reshape(-1) for x in leaves if x.dtype == kind]) for kind in _kinds(leaves)]


def _unrow(rows: list[Array], like: Any) -> Any:
    """The pytrees of `_row` again, side by side along the first axis of all arrays."""
    leaves, structure = jax.tree.flatten(like)
    found = [jnp.empty(0)] * len(leaves)
    for row, kind in zip(rows, _kinds(leaves), strict=True):
        places = [place for place, leaf in enumerate(leaves) if leaf.dtype == kind]
        ends = np.cumsum([leaves[place][0].size for place in places])
        for place, part in zip(places, jnp.split(row, ends[:-1], axis=1), strict=True):
            found[place] = part.reshape(leaves[place].shape)
    return jax.tree.unflatten(structure, found)


def _kinds(leaves: list[Array]) -> list[np.dtype]:
    return list(dict.fromkeys(leaf.dtype for leaf in leaves))


def finish(learner: Learner, training: Training, key: Key[Array, ""]) -> dict[str, Any]:
    """Return what is kept of a run that is over: its `curve`, its `final` scores and its `policy`.

    Where the learner is evaluated more than once the curve has scores called `greedy_`, measured at the end of each of
    `evaluations` parts of training: NaN at all other points, and in parts in which no step ended.
    """
    policy, found = learner.policy(training.carry), curve(learner, training)
    diverged = training.failed | ~_finite(policy)

    def scores(policy: Any) -> dict[str, FloatScalar]:
        means = mean_scores(learner, greedy(learner, policy), learner.evaluation_envs, key)
        return {f"greedy_{name}": mean for name, mean in means.items()}

    if training.snapshots is None:
        final = scores(policy)
    else:
        policies, there = training.snapshots
        along, part = jax.vmap(scores)(policies), np.arange(learner.evaluations)
        at = np.full(learner.record, learner.evaluations)
        at[-(-(part + 1) * learner.record // learner.evaluations) - 1] = part
        found |= {name: jnp.append(jnp.where(there, x, jnp.nan), jnp.nan)[at] for name, x in along.items()}
        final = {name: score[jnp.max(part * there)] for name, score in along.items()}
    return {"curve": found, "final": final | {"diverged": diverged}, "policy": policy}


@jax.jit
def _train_step(learner: Learner, carry: Any) -> Any:
    """The learner's step, traced once for all that asks for it."""
    return learner.train_step(carry)


def _recorded(outcome: Outcome) -> dict[str, Any]:
    """Return the values that a step adds to the columns of `Training.record`, by their names."""
    squares = {"updates": 1.0, **dict(sorted(outcome.squares.items()))} if outcome.squares else {}
    return {"episodes": outcome.episodes, **dict(sorted(outcome.totals.items())), **squares}


def measures(learner: Learner, carry: Any) -> tuple[str, ...]:
    """Return the columns of `Training.record`."""
    return tuple(_recorded(jax.eval_shape(_train_step, learner, carry)[1]))


def curve(learner: Learner, training: Training) -> dict[str, Float[Array, " record"]]:
    """The learning curve so far, by name: means over the episodes that ended in each point, or totals so far where the
    learner's curves are cumulative; of squares the root of the mean over updates. NaN where nothing was recorded."""
    names = measures(learner, training.carry)
    columns = dict(zip(names, training.record.T, strict=True))
    episodes, updates = columns.pop("episodes"), columns.pop("updates", None)
    squares = names[names.index("updates") + 1 :] if updates is not None else ()
    ended = jnp.where(episodes > 0, episodes, jnp.nan)
    found = {name: jnp.cumsum(x) if learner.cumulative else x / ended for name, x in columns.items()}
    return found | {name: jnp.sqrt(columns[name] / updates) for name in squares}


def run_key(seed: jax.Array, number: jax.Array) -> jax.Array:
    """The key of a run: of the config's seed and the run's number alone, so that a point trains as it would alone."""
    return jax.random.fold_in(rng.key(seed), number)


def progress_of(learner: Learner, training: Training) -> Progress:
    """Return the progress of a run, with its scores over the last twentieth of its curve."""
    share = jnp.where(training.failed, 1.0, learner.progress(training.carry))
    columns = dict(zip(measures(learner, training.carry), training.record.T, strict=True))
    place = jnp.arange(learner.record)
    recent = jnp.abs(place - jnp.floor(share * learner.record)) <= max(1, learner.record // 20)
    episodes = jnp.sum(columns["episodes"] * recent)
    mean = {name: jnp.sum(columns[name] * recent) / episodes for name in SHOWN if name in columns}
    return share, jnp.stack([mean[name] if name in mean else jnp.float32(jnp.nan) for name in SHOWN])


def _finite(tree: Any) -> BoolScalar:
    return jnp.stack([jnp.isfinite(leaf).all() for leaf in jax.tree.leaves(tree)]).all()


def check_learner(learner: Learner) -> None:
    """Trace a step of training, and an action, of a learner that does not ship with this package; raise an InputError
    if a method fails, or does not return what the protocol of `Learner` says."""
    if ships(type(learner)):
        return
    what = f"learner: {type(learner).__name__}"
    try:
        jax.eval_shape(lambda learner: _trace(learner, what, rng.key(0)), arrays(learner))
    except Exception as error:
        raise fault(what, error) from error


def _trace(learner: Learner, what: str, key: Key[Array, ""]) -> None:
    carry = arrays(learner.init(key))
    found: Any = _train_step(learner, carry)
    if not (isinstance(found, tuple) and len(found) == 2 and isinstance(found[1], Outcome)):
        raise InputError(f"{what}.train_step must return a tuple (training state, Outcome).")
    check_same(f"{what}.train_step", carry, found[0], "init")
    if lacks := sorted(set(SHOWN) - found[1].totals.keys()):
        raise InputError(f"{what}.train_step must return an Outcome whose totals have {', '.join(lacks)}, too.")
    policy, state = learner.policy(carry), learner.env.reset(key)
    if not all(hasattr(leaf, "dtype") for leaf in jax.tree.leaves(policy)):
        raise InputError(f"{what}.policy must return a pytree of arrays.")
    action, joints = learner.act(policy, learner.observation(state), key), len(learner.env.action_bins)
    if jnp.shape(action) != (joints,):
        raise InputError(f"{what}.act must return an action of shape {(joints,)}, got {jnp.shape(action)}.")
