"""Runs of a learner that trains each as a whole, one after another."""

from collections import deque
from threading import Event
from typing import Any

import jax
import jax.numpy as jnp

from humanoid_mjx.learners.base import WholeRunLearner
from humanoid_mjx.training.plan import Group
from humanoid_mjx.training.pool import Pool
from humanoid_mjx.types import Device


class Stopped(Exception):
    """Ends a training that the user stopped."""


class WholeRuns(Pool):
    """A pool of one slot. `train` trains its run to the end; where `stop` is set meanwhile the run stays untrained."""

    def __init__(self, group: Group, waiting: deque[int], device: Device, seed: int, policies: Any, stop: Event):
        super().__init__(group, waiting, 1, device, seed, policies)
        self.stop = stop

    def train(self) -> None:
        learner = self.group.learner.structure()
        assert isinstance(learner, WholeRunLearner)
        hyper, carry = jax.tree.map(lambda leaf: leaf[0], (self.hyper, self.carry))
        try:
            carry = learner.train_run(hyper, carry, self._report)
        except Stopped:
            self.progress[0] = 0.0
            return
        self.carry = jax.tree.map(lambda leaf: jnp.asarray(leaf)[None], carry)
        self.progress[0] = 1.0

    def _report(self, share: float) -> None:
        self.progress[0] = min(share, 0.999)
        if self.stop.is_set():
            raise Stopped
