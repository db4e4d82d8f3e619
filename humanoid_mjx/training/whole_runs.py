"""Runs of a learner that trains each as a whole, one after another."""

from functools import partial
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np

from humanoid_mjx.learners.base import WholeRunLearner
from humanoid_mjx.learners.rollout import Choose, greedy, mean_scores
from humanoid_mjx.training.plan import Group
from humanoid_mjx.training.pool import Pool
from humanoid_mjx.training.program import SHOWN, run_key

MEASURES = ("return", "steps", "success")


class Stopped(Exception):
    """Ends a training that the user stopped."""


class Diverged(Exception):
    """Ends a training whose policy is no longer finite."""


class WholeRuns(Pool):
    """A pool of one slot. `train` trains its run to the end; where `stop` is set meanwhile the run stays untrained.

    Its curve has the means over `evaluation_envs` episodes at the end of each point, of the policy with its exploration
    and, called `greedy_`, of the greedy policy. NaN where the learner reported nothing in a point.
    """

    def __init__(self, *given: Any):
        super().__init__(*given)
        names = (*MEASURES, *(f"greedy_{name}" for name in MEASURES))
        self.curve = {name: np.full(self.wall_s.shape[1], np.nan, np.float32) for name in names}
        self.failed, self.policy = False, None

    def prepare(self) -> None:
        """Nothing: the learner compiles its own training."""

    def train(self) -> None:
        learner, training = _only((self.learners, self.training))
        self.phase, self.failed = "training", False
        for values in self.curve.values():
            values[:] = np.nan
        try:
            carry = learner.train_run(training.carry, partial(self._look, learner, training.carry))
            self.policy = learner.policy(carry)
        except Stopped:
            self.progress[0] = 0.0
            return
        except Diverged:
            self.failed = True
        self.progress[0] = 1.0
        self.note_time()

    def finish(self) -> dict[str, Any]:
        learner, training, seeds = _only((self.learners, self.training, self.seeds))
        self.phase = "evaluating"
        policy = learner.policy(training.carry) if self.policy is None else self.policy
        final = _scores(learner, policy, jax.random.fold_in(run_key(*seeds), 1))
        final = {f"greedy_{name}": score for name, score in final["greedy"].items()}
        results = {"curve": self.curve, "final": final | {"diverged": jnp.bool_(self.failed)}, "policy": policy}
        return jax.tree.map(lambda leaf: jnp.asarray(leaf)[None], results)

    def curves(self, slots: np.ndarray, most: int) -> dict[str, np.ndarray]:
        return {name: values[None][slots] for name, values in self.curve.items()}

    def _look(self, learner: WholeRunLearner, carry: Any, share: float, policy: Any) -> None:
        """Record a point of the learning curve."""
        if not all(np.isfinite(leaf).all() for leaf in jax.tree.leaves(policy)):
            raise Diverged
        self.policy, points = policy, self.wall_s.shape[1]
        point = max(0, int(np.ceil(share * points - 1e-9)) - 1)
        scores = _scores(learner, policy, jax.random.fold_in(carry.key, point))
        for kind, prefix in (("sample", ""), ("greedy", "greedy_")):
            for name in MEASURES:
                self.curve[prefix + name][point] = scores[kind][name]
        self.recent[0] = [self.curve[name][point] for name in SHOWN]
        self.progress[0] = min(share, 0.999)
        self.note_time()
        self.looked()
        if self.stop.is_set():
            raise Stopped


def pool_of(group: Group, *given: Any) -> Pool:
    """The pool that trains runs of a group; it is `given` what else a `Pool` takes."""
    return (Pool if group.learners.side_by_side else WholeRuns)(group, *given)


@jax.jit
def _scores(learner: WholeRunLearner, policy: Any, key: jax.Array) -> dict[str, dict[str, jax.Array]]:
    """Mean scores of a policy, as training acts and at its best."""

    def sample(state: Any, key: jax.Array) -> jax.Array:
        return learner.sample(policy, learner.observation(state), key)

    agents: dict[str, Choose] = {"sample": sample, "greedy": greedy(learner, policy)}
    return {name: mean_scores(learner.env, choose, learner.evaluation_envs, key) for name, choose in agents.items()}


def _only(tree: Any) -> Any:
    """The single run of a tree of runs, on its device alone: `train_run` may lay out a mesh of its own."""
    return jax.tree.map(lambda leaf: jax.device_put(leaf[0], next(iter(leaf.devices()))), tree)
