"""The protocol of learners."""

from collections.abc import Callable, Mapping
from typing import Any, ClassVar

import jax
import jax.numpy as jnp
from jaxtyping import Array, Key
from pydantic import Field

from humanoid_mjx.spec import Spec
from humanoid_mjx.tasks.base import Task
from humanoid_mjx.types import BoolScalar, IntScalar


class Learner(Spec):
    """Base of learners: an algorithm for one task, whose hyper-parameters are data.

    `params` (a tuple of numbers, the task's among them) is what the methods take as `hyper`, with arrays in the place
    of numbers. All methods are pure and written for one point of a sweep; `jax.vmap` makes them a sweep.
    """

    nested: ClassVar[tuple[str, ...]] = ("task",)

    unit: ClassVar[str] = "episodes"
    """What `episodes` counts; control steps for learners that count in steps."""

    task: Task = Field(exclude=True, repr=False)
    episodes: int = Field(1000, ge=1, le=1_000_000_000, exclude=True, description="how long to train")
    record: int = Field(100, ge=1, le=10_000, exclude=True, description="points of a learning curve")

    start_from: str | None = Field(None, description="a run folder whose policies to start from")

    @property
    def compiler_options(self) -> Mapping[str, str | bool]:
        """For XLA, of the programs that train."""
        return {}

    def working_bytes(self, state: int) -> int:
        """An estimate of what training one run holds at its peak beside a training state of `state` bytes."""
        return 3 * state

    def init(self, hyper: Any, key: Key[Array, ""], policy: Any = None) -> Any:
        """The training state before the first step: a pytree of arrays. `policy` is one learned before."""
        raise NotImplementedError

    def train_chunk(self, hyper: Any, carry: Any, steps: IntScalar) -> tuple[Any, dict[str, Array]]:
        """Train for `steps` steps or a few more, or less where training ends.

        Returns:
          the new training state, and `progress`, which is 1.0 once training has ended.
        """
        raise NotImplementedError

    def policy(self, carry: Any) -> Any:
        """What was learned, as a pytree of arrays: all that acting greedily needs."""
        raise NotImplementedError

    def act(self, hyper: Any, policy: Any, observation: Any, key: Key[Array, ""]) -> Any:
        """The greedy action."""
        raise NotImplementedError

    def diverged(self, carry: Any) -> BoolScalar:
        """Whether training ended in numbers that are not finite."""
        finite = [jnp.isfinite(leaf).all() for leaf in jax.tree.leaves(self.policy(carry))]
        return ~jnp.stack(finite).all()

    def evaluate(self, hyper: Any, policy: Any, key: Key[Array, ""]) -> dict[str, Array]:
        """How well what was learned does, greedily: numbers by name, `greedy_success` among them."""
        raise NotImplementedError

    def curve(self, hyper: Any, carry: Any) -> dict[str, Array]:
        """The learning curve so far: arrays of `record` points by name; NaN where nothing was recorded."""
        raise NotImplementedError

    def results(self, hyper: Any, carry: Any, key: Key[Array, ""]) -> tuple[dict[str, Array], dict[str, Array]]:
        """The learning curve of a run that is over, and how well what was learned does, as `evaluate` says."""
        return self.curve(hyper, carry), self.evaluate(hyper, self.policy(carry), key)


class WholeRunLearner(Learner):
    """Base of learners whose training is a loop of its own, which cannot be cut into chunks or vmapped.

    `train_run` takes the place of `train_chunk`. Runs train one after another on one device; a kill loses the one under
    way, which then trains anew.
    """

    def train_run(self, hyper: Any, carry: Any, report: Callable[[float], None]) -> Any:
        """Train from a state that `init` made to the end; the last training state.

        `report` wants to be told the share that is done, often. It may raise what ends the training.
        """
        raise NotImplementedError
