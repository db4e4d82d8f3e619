"""Functions for programs and notebooks.

Training and policies are functions of JAX: pure, without a folder, and to be mapped by `jax.vmap`.

    learner = make_learner("tabular_q", make_task("joint_reach"), episodes=500)
    trained = jax.vmap(lambda epsilon: train(learner.replace(epsilon=epsilon), key(0)))(jnp.linspace(0.05, 0.95, 10))

`humanoid_mjx.sweep` trains the same by the same steps; it adds checkpoints, several devices, GPU kernels and tables.
Other functions read a run, evaluate, plot and play it, and a notebook displays their results. `humanoid_mjx.start()`
sets up the process as the commands do.
"""

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Generic, NamedTuple, TypeVar, overload

import jax
import jax.numpy as jnp
import numpy as np
from jax.core import Tracer
from jax.tree_util import Partial
from jaxtyping import Array, Float, Key

from humanoid_mjx.compute.rng import check_key
from humanoid_mjx.evaluation import policy as policies
from humanoid_mjx.evaluation.policy import StoredPolicy
from humanoid_mjx.learners import Learner
from humanoid_mjx.learners import rollout as rollouts
from humanoid_mjx.learners.approximate import ApproximateQ, Weights
from humanoid_mjx.learners.rollout import Episode
from humanoid_mjx.learners.tabular import TabularQ
from humanoid_mjx.report.web import MEDIA, data_address
from humanoid_mjx.runs.folder import read_config
from humanoid_mjx.runs.statistics import Evaluation
from humanoid_mjx.spec import InputError, check_count, check_folder, kinds, ships, shown
from humanoid_mjx.tasks.base import Task
from humanoid_mjx.tasks.check import check_task
from humanoid_mjx.tasks.continuous import ContinuousTask, State, as_continuous
from humanoid_mjx.training import program
from humanoid_mjx.training.progress import Reporter, reporting
from humanoid_mjx.training.sweep import Run

W_co = TypeVar("W_co", covariant=True)


@jax.tree_util.register_dataclass
@dataclass(frozen=True, eq=False, repr=False)
class Policy(Generic[W_co]):
    """A learned policy as a function of an observation: a pytree, to be passed to `jax.jit` and `jax.vmap`."""

    learner: Learner
    """The learner, which knows how `weights` act and in which task."""
    weights: W_co
    """The arrays that acting needs: a table (states, actions), or the weights of a network."""

    def __call__(self, obs: Array, key: Key[Array, ""]) -> Array:
        """Return the greedy action.

        Args:
          obs: an observation as `observation` returns it; in continuous tasks `state.obs`, (observation_size,).
          key: the key that chooses among equally good actions.

        Returns:
          The choice of each joint, int (joints,), or commands in [-1, 1], float (joints,): the action that
          `task.step` or `task.step_continuous` takes. `task.flat_action` makes choices the action of a `FiniteTask`.
        """
        check_key("policy(obs, key)", key)
        policies.check_single(self.learner)
        if isinstance(obs, State):
            raise InputError("policy: this is a state; write policy(policy.observation(state), key).")
        _check_observation(self.learner, obs)
        return _act(self, obs, key)

    def observation(self, state: State) -> Array:
        """Return what the policy observes in a state of `task`: `state.obs`, or the row of a table, int ()."""
        if not isinstance(state, State):  # as those of a FiniteTask are
            raise InputError(f"policy.observation: take a state of policy.task.reset or .step, got {shown(state)}.")
        policies.check_single(self.learner)
        return self.learner.observation(state)

    def save(self, path: Path | str) -> None:
        """Write a policy file, .npz, which `load_policy`, `evaluate`, `play` and `export` read.

        Raises:
          InputError: it cannot be written there, or the class of the task or learner lies in no module.
        """
        if "__main__" in (type(self.learner).__module__, type(self.learner.task).__module__):
            raise InputError(
                "policy.save: a class of the program itself cannot be found again; import it from a module."
            )
        policies.save_policy(policies.with_config(self.learner, self.weights), Path(path))

    def __repr__(self) -> str:
        axes = "".join(f"{size:,} x " for size in np.shape(self.learner.budget))
        return f"Policy({axes}{type(self.learner).__name__} on {type(self.learner.task).__name__})"

    @property
    def task(self) -> ContinuousTask:
        """The task of training, a finite one in its continuous form: `reset(key)`, `step(state, action, key)`."""
        return self.learner.env


@jax.tree_util.register_dataclass
@dataclass(frozen=True, eq=False, repr=False)
class Trained(Generic[W_co]):
    """Result of `train`. Under `jax.vmap` every array has leading axes."""

    policy: Policy[W_co]
    curve: dict[str, Float[Array, "*runs record"]]
    """Learning curve by name, such as `success`, `return` and `steps`: means over the episodes that ended in each of
    `learner.record` equal parts of training, NaN where none ended; `greedy_...`: NaN but at each evaluation."""
    scores: dict[str, Array]
    """`greedy_success`, `greedy_return`, `greedy_steps`: means over `learner.evaluation_envs` greedy episodes; and
    `diverged`: True if training stopped before numbers that are not finite."""
    carry: object
    """The final training state, with which `learner.train_step` goes on."""

    def __repr__(self) -> str:
        return f"Trained({self.policy}; curve: {', '.join(self.curve)}; scores: {', '.join(self.scores)})"

    @property
    def places(self) -> Float[Array, "*runs record"]:
        """Episodes or control steps, as `learner.unit` says, trained by the end of each entry of `curve`."""
        learner = self.policy.learner
        return jnp.asarray(learner.budget)[..., None] * jnp.arange(1, learner.record + 1) / learner.record


@overload
def train(learner: TabularQ, key: Key[Array, ""]) -> Trained[Array]: ...
@overload
def train(learner: ApproximateQ, key: Key[Array, ""]) -> Trained[Weights]: ...
@overload
def train(learner: Learner, key: Key[Array, ""]) -> Trained[object]: ...
def train(learner: Learner, key: Key[Array, ""]) -> Trained[Any]:
    """Train a learner to its end.

    The function is pure and compiled at its first call for each structure of learner. `jax.vmap` maps it over keys and
    over any traced field of the learner or its task, such as `learner.replace(epsilon=...)`; arrays that are sharded
    over devices train where they are. The steps are those of `humanoid_mjx.sweep`, without its GPU kernels; programs of
    another shape round differently. Call `humanoid_mjx.start()` before jax computes: XLA's defaults slow MJX down and
    abort on a few programs.

    Args:
      learner: what `make_learner` returns; its `replace` sets traced fields without a check.
      key: `humanoid_mjx.key(seed)`, or any key of `jax.random`, whose generator is slower.

    Returns:
      The policy, the learning curve and scores of greedy episodes. Numbers that are not finite stop the training and
      set `scores["diverged"]`.

    Raises:
      InputError: no learner, no key, or a fault in a task (`check_task`) or learner of one's own.
    """
    if not isinstance(learner, Learner):
        raise InputError(
            f"train: write train(learner, key(0)); {type(learner).__name__} is no learner of make_learner."
        )
    check_key("train", key)
    for path, leaf in jax.tree_util.tree_leaves_with_path(learner) if all(map(ships, kinds(learner))) else ():
        if np.shape(leaf) or isinstance(leaf, str):
            name, what = jax.tree_util.keystr(path)[1:], "train(learner.replace(...), key)"
            raise InputError(f"train: {name} must be one number, got {shown(leaf)}; map {what} over many by jax.vmap.")
    check_task(learner.task)
    program.check_learner(learner)
    return _train(learner, key)


@jax.jit
def _train(learner: Learner, key: Key[Array, ""]) -> Trained[Any]:
    updates = jnp.ceil(jnp.asarray(learner.budget) / learner.update_steps).astype(jnp.int32)
    last = jax.lax.while_loop(
        lambda state: ~state.failed & (learner.progress(state.carry) < 1.0),
        lambda state: program.train(learner, state, updates),
        program.begin(learner, key),
    )
    found = program.finish(learner, last, jax.random.fold_in(key, 1))
    return Trained(Policy(learner, found["policy"]), found["curve"], found["final"], last.carry)


def _check_observation(learner: Learner, obs: Any) -> None:
    """Raise an InputError if a learner of this package takes no such observation. Under `jax.jit` and `jax.vmap` the
    row of a table is not known."""
    array = jnp.asarray(obs if isinstance(obs, jax.Array | np.ndarray | np.generic | int) else np.nan)
    if isinstance(learner, TabularQ):
        rows, shape, kind = learner.task.num_states, (), jnp.integer
        wanted = f"the row of a table, an integer from 0 to {rows - 1}"
    else:
        rows, shape, kind = np.inf, (learner.env.observation_size,), jnp.number
        wanted = f"numbers of shape {shape}"
    fits = jnp.issubdtype(array.dtype, kind) and array.shape[-1:] == shape
    if ships(type(learner)) and not (fits and (shape or isinstance(array, Tracer) or 0 <= int(array) < rows)):
        got = f"{array.dtype}{list(array.shape)}" if array.ndim else shown(obs)
        raise InputError(f"policy: an observation is {wanted}, got {got}; map over many by jax.vmap.")


@jax.jit
def _act(policy: Policy[Any], obs: Array, key: Key[Array, ""]) -> Array:
    return policy.learner.act(policy.weights, obs, key)


def rollout(
    task: Task, policy: Callable[[Array, Key[Array, ""]], Array], key: Key[Array, ""], discount: float | Array = 1.0
) -> Episode:
    """Play one episode to its end; compiled, pure, and to be mapped by `jax.vmap`.

    Args:
      task: the task, which may differ from that of training: `policy.task.replace(friction=0.5)`.
      policy: from an observation and a key to an action; a `Policy`, or a function of one's own, which gets
        `state.obs`, (observation_size,), of a finite task numbers from 0 to 1 (`FiniteTask.observe`).
      key: the key of the episode.
      discount: the factor of `discounted_return` per step.

    Returns:
      Scalars `success`, `episode_return`, `steps`, `discounted_return`.

    Raises:
      InputError: an argument of another kind, an action of another shape or dtype, or one outside its range. Under
        `jax.jit` and `jax.vmap`, where values are not known, an action outside its range makes both returns NaN.
    """
    if not isinstance(task, Task) or not callable(policy):
        kinds = f"{type(task).__name__} and {type(policy).__name__}"
        raise InputError(f"rollout: write rollout(task, policy or function, key(0)); the first two are {kinds}.")
    check_key("rollout", key)
    if not isinstance(discount, int | float | Array | np.generic | np.ndarray) or np.shape(discount):
        raise InputError(f"rollout: discount must be a number, got {shown(discount)}.")
    episode, action = _rollout(task, policy if isinstance(policy, Policy) else Partial(policy), key, discount)
    env = as_continuous(task)
    allowed = env.allows(action)
    if isinstance(allowed, Tracer):
        return rollouts.marked(episode, allowed)
    if not allowed:
        kinds = _kinds(env.action_bins, env is task)
        raise InputError(f"rollout: the policy must return {kinds}; it returned {shown(action.tolist())}.")
    return episode


@jax.jit
def _rollout(task: Task, policy: Any, key: Key[Array, ""], discount: float | Array) -> tuple[Episode, Array]:
    env = as_continuous(task)

    def choose(state: State, key: Key[Array, ""]) -> Array:
        if isinstance(policy, Policy):
            return policy(policy.observation(state), key)
        return _checked(policy(state.obs, key), env.action_bins, env is task)

    return rollouts.rollout(env, choose, key, discount)


def _checked(action: Any, bins: tuple[int, ...], commands: bool) -> Array:
    """Return an action if it has the shape and the dtype of choices, or of `commands` where these are allowed."""
    kinds = f"rollout: the policy must return {_kinds(bins, commands)}, of shape ({len(bins)},); got"
    try:
        array = jnp.asarray(action)
    except (TypeError, ValueError) as error:
        raise InputError(f"{kinds} {shown(action)}.") from error
    allowed = commands if jnp.issubdtype(array.dtype, jnp.floating) else jnp.issubdtype(array.dtype, jnp.integer)
    if array.shape != (len(bins),) or not allowed:
        raise InputError(f"{kinds} {array.dtype}{list(array.shape)}.")
    return array


def _kinds(bins: tuple[int, ...], commands: bool) -> str:
    return f"integers at least 0 and below {list(bins)}" + ", or numbers from -1 to 1" * commands


def load_policy(name: Path | str, point: int | None = None) -> Policy[object]:
    """Return a policy as a function of an observation and a key.

    Args:
      name: a shipped policy, such as "walk"; a policy file; or a run folder, whose best policy is taken.
      point: the point of the run's sweep; by default the best.

    Raises:
      InputError: there is no such policy, or its file cannot be read.
    """
    trained = policies.find_policy(name, point)
    return Policy(trained.learner, trained.policy)


class Picture(NamedTuple):
    """A figure or film on disk, which a notebook displays."""

    path: Path
    words: str
    """Sentences about what it shows."""

    def _repr_html_(self) -> str:
        data = data_address(self.path.read_bytes(), MEDIA[self.path.suffix])
        if MEDIA[self.path.suffix].startswith("video"):
            return f'<video src="{data}" autoplay loop muted></video><p>{self.words}</p>'
        return f'<img src="{data}" style="max-width: 100%"><p>{self.words}</p>'


def load_run(path: Path | str) -> Run:
    """Return the run in a folder that a sweep has written.

    Raises:
      InputError: this is no run folder.
    """
    read_config(_folder(path))
    return Run(_folder(path))


def draw(run: Run | Path | str) -> list[Picture]:
    """Draw the figures that the command `sweep` draws into the run's `figures/`: learning curves, and swept values.

    Raises:
      InputError: this is no run folder.
    """
    from humanoid_mjx.report.figures import draw_run  # matplotlib takes a while

    run = load_run(_folder(run))
    return [Picture(path, "") for path in draw_run(run, run.summary)[1]]


def evaluate(
    what: Run | StoredPolicy | Policy | Trained | Path | str,
    *,
    point: int | None = None,
    episodes: int = 1024,
    physics: str | None = None,
    overrides: Sequence[str] = (),
) -> dict[str, Evaluation]:
    """Evaluate a policy on held-out episodes.

    Args:
      what: a run or its folder, a policy file, the name of a shipped policy, or what `train` returns.
      point: the point of a run's sweep; by default the best.
      episodes: how many each agent plays.
      physics: another physics than that of training, such as `mujoco`.
      overrides: changes of the task, such as "task.friction=0.5".

    Returns:
      the evaluations of the `greedy` policy and of the `zero` and the `random` agent.

    Raises:
      InputError: there is no such policy, or it cannot be used so.
    """
    from humanoid_mjx.evaluation.evaluate import evaluate_all

    check_count("evaluate: episodes", episodes, 1)
    return {each.agent: each for each in evaluate_all([_policy(what, point, physics, overrides)], episodes)}


def plot(
    *runs: Run | Path | str,
    x: str | None = None,
    y: str = "success",
    by: str | None = None,
    out: Path | str | None = None,
) -> Picture:
    """Draw any column of the tables of runs over any other: lines with their 95 % interval over seeds.

    Args:
      runs: runs or their folders.
      x: the column across; by default the episodes or steps trained.
      y: the column upwards; `learned` draws the table of the best run instead.
      by: the column that has a line for each value; `run` for each run. By default what is swept, if that is one.
      out: a .png; by default in the figures of the first run.

    Raises:
      InputError: no run, or a column that is not there or cannot be drawn.
    """
    from humanoid_mjx.report import plotting

    path, notes = plotting.plot([_folder(run) for run in runs], x, y, by, Path(out) if out else None)
    return Picture(path, " ".join(notes))


def play(
    what: Run | StoredPolicy | Policy | Trained | Path | str,
    *,
    point: int | None = None,
    episode: int = 0,
    physics: str | None = None,
    overrides: Sequence[str] = (),
    out: Path | str | None = None,
) -> Picture:
    """Write a film of a held-out episode.

    Args:
      what: with `point` and `overrides` as `evaluate` takes them.
      episode: its number.
      physics: by default native MuJoCo where the task can, as the command's.
      out: a .gif, .mp4, .webm or .png; by default `figures/play.gif` of the run, or `NAME.gif`.

    Raises:
      InputError: there is no such policy, or its task moves no robot.
    """
    with reporting() as reporter:
        return film(what, reporter, point, episode, physics, overrides, out)


def film(
    what: Run | StoredPolicy | Policy | Trained | Path | str,
    reporter: Reporter,
    point: int | None,
    episode: int,
    physics: str | None,
    overrides: Sequence[str],
    out: Path | str | None,
    **look: Any,
) -> Picture:
    """Write a film as `play` does; `look` is the rate and the size of its pictures, as `render_film` takes them."""
    from humanoid_mjx.evaluation.film import show
    from humanoid_mjx.report.rendering import render_film

    check_count("play: episode", episode, 0)
    trained = _policy(what, point, physics, overrides)
    trained = trained if physics else policies.on_native(trained)
    (shown, outcome), target = show(trained, reporter, episode), Path(out or f"{trained.name}.gif")
    if out is None and isinstance(what, (Run, Path, str)) and _folder(what).is_dir():
        target = _folder(what) / "figures" / "play.gif"
        target.parent.mkdir(exist_ok=True)
        check_folder(target)
    reporter.phase("rendering")
    render_film(shown, target, tell=reporter.count, **look)
    return Picture(target, outcome)


def _policy(what: Any, point: int | None, physics: str | None, overrides: Sequence[str]) -> StoredPolicy:
    what = what.policy if isinstance(what, Trained) else what.path if isinstance(what, Run) else what
    if isinstance(what, Policy):
        what = policies.with_config(what.learner, what.weights)
    found = what if isinstance(what, StoredPolicy) else policies.find_policy(what, point, overrides)
    return policies.in_world(found, physics, overrides)


def _folder(what: object) -> Path:
    return what.path if isinstance(what, Run) else Path(str(what))
