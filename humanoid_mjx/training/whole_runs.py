"""Runs of a learner that trains each as a whole, one after another."""

from collections import deque
from threading import Event
from typing import Any

import jax
import jax.numpy as jnp

from humanoid_mjx.learners.base import WholeRunLearner
from humanoid_mjx.training.plan import Group
from humanoid_mjx.training.pool import Pool
from humanoid_mjx.training.program import outcome
from humanoid_mjx.types import Device


class Stopped(Exception):
    """Ends a training that the user stopped."""


class WholeRuns(Pool):
    """A pool of one slot. `train` trains its run to the end; where `stop` is set meanwhile the run stays untrained."""

    def __init__(self, group: Group, waiting: deque[int], device: Device, seed: int, policies: Any, stop: Event):
        super().__init__(group, waiting, 1, device, seed, policies)
        self.stop = stop
        # Such a learner compiles by itself what it wants compiled.
        self.program = self.program._replace(finish=self._finish)

    def train(self) -> None:
        hyper, carry = _only((self.hyper, self.carry))
        try:
            carry = self._learner().train_run(hyper, carry, self._report)
        except Stopped:
            self.progress[0] = 0.0
            return
        self.carry = _as_one_of_one(carry)
        self.progress[0] = 1.0
        self.note_time()

    def _finish(self, hyper: Any, carry: Any, seeds: Any) -> dict[str, Any]:
        return _as_one_of_one(outcome(self._learner(), *_only((hyper, carry, seeds))))

    def _learner(self) -> WholeRunLearner:
        learner = self.group.learner.structure()
        assert isinstance(learner, WholeRunLearner)
        return learner

    def _report(self, share: float) -> None:
        self.progress[0] = min(share, 0.999)
        self.note_time()
        if self.stop.is_set():
            raise Stopped


def _only(tree: Any) -> Any:
    return jax.tree.map(lambda leaf: leaf[0], tree)


def _as_one_of_one(tree: Any) -> Any:
    return jax.tree.map(lambda leaf: jnp.asarray(leaf)[None], tree)
