"""The protocol of learners: a learner holds its algorithm, and nothing else.

`humanoid_mjx.training` adds learning curves, snapshots, the guard against NaN, evaluation, checkpoints and progress to
every learner.
"""

from collections.abc import Mapping
from typing import Any, ClassVar, NamedTuple

import jax.numpy as jnp
from jaxtyping import Array, Key
from pydantic import Field, model_validator

from humanoid_mjx.compute import Program
from humanoid_mjx.spec import Spec, traced
from humanoid_mjx.tasks.base import Task
from humanoid_mjx.tasks.continuous import ContinuousTask, State, as_continuous
from humanoid_mjx.types import FloatScalar

ENVS = "envs"
"""The axis of a mesh of devices that share the environments of each run."""


class Outcome(NamedTuple):
    """Entries of the learning curve from one training step; each is a scalar, or has an axis of agents."""

    done: FloatScalar
    """Training done before the step, in units of `budget`."""
    episodes: FloatScalar
    """Number of episodes that ended."""
    totals: dict[str, FloatScalar]
    """Sums over these episodes: `steps`, `success`, `return`, and the reward's terms by name."""
    squares: dict[str, FloatScalar]
    """Mean squares over the step, such as that of the `td_error`."""


class Learner(Spec):
    """Base of learners: an algorithm for one task, whose hyper-parameters are data.

    A learner is a pytree whose leaves are its `traced` hyper-parameters and those of its task. All methods are pure and
    written for one point of a sweep; `jax.vmap` over learners makes them a sweep.
    """

    unit: ClassVar[str] = "total_steps"
    """The field with the length of training: `total_steps` or `episodes`."""
    lap: ClassVar[int] = 1
    """Training steps between two checks. With 1, training stops before a step that would make the policy non-finite;
    with more, the steps of a lap run unchecked."""

    program: ClassVar[Program] = "other"
    """Kind of the programs that train and evaluate, which chooses XLA's options (`compute.options`)."""

    read_with: ClassVar[Mapping[str, Mapping[str, str]]] = {}
    """Keys that are read with one word of another key alone: `{other key: {key: word}}`."""

    task: Task = Field(exclude=True, repr=False)
    record: int = Field(100, ge=1, le=10_000, exclude=True, description="points of a learning curve")
    start_from: str | None = Field(None, description="a run folder whose policies to start from")
    evaluations: int = Field(1, ge=1, le=1000, description="greedy evaluations along the learning curve")
    evaluation_envs: int = Field(1, ge=1, le=100_000, description="greedy episodes of an evaluation")

    devices: int = Field(1, ge=1, le=1, exclude=True, repr=False)
    """Devices that share the environments, along the axis `ENVS`: set by training, in no config."""

    @model_validator(mode="after")
    def _keys_must_be_read(self) -> "Learner":
        fields = type(self).model_fields
        for other, keys in self.read_with.items():
            mine = getattr(self, other)
            for key, word in keys.items():
                if mine != word and getattr(self, key) != fields[key].default:
                    needed = f"set learner.{other}={word}"
                    raise ValueError(f"{key} is not read with {other} {mine}; leave it out, or {needed}")
        return self

    def can_share(self, devices: int) -> bool:
        """Return whether so many devices may share the environments of a run."""
        return devices == 1

    @property
    def budget(self) -> Any:
        """Length of training, in `unit`."""
        return getattr(self, self.unit)

    @property
    def update_steps(self) -> int:
        """Steps of an update, in `unit`s: training ends with the update that reaches the budget."""
        return 1

    @property
    def env(self) -> ContinuousTask:
        """The task in which episodes are played: the continuous form of a finite task."""
        return as_continuous(self.task)

    @property
    def cumulative(self) -> bool:
        """True if learning curves show totals so far, not means over the episodes of each point."""
        return False

    def init(self, key: Key[Array, ""], policy: Any = None) -> Any:
        """Return the training state before the first step, a pytree of arrays. `policy`: that of an earlier run."""
        raise NotImplementedError

    def train_step(self, carry: Any) -> tuple[Any, Outcome]:
        """Return the training state after a step, and the statistics of the step. After the end it changes nothing."""
        raise NotImplementedError

    def progress(self, carry: Any) -> FloatScalar:
        """Return the share of the training that is done; 1.0 at its end."""
        raise NotImplementedError

    def policy(self, carry: Any) -> Any:
        """Return the policy: a pytree of all arrays that acting greedily needs."""
        raise NotImplementedError

    def observation(self, state: State) -> Any:
        """The observation that `act` takes, from the state of an episode in `env`."""
        return state.obs

    def act(self, policy: Any, observation: Any, key: Key[Array, ""]) -> Any:
        """The greedy action: a choice of each joint, int (joints,), or numbers in [-1, 1], float (joints,).
        Episodes with another are no success, and their returns are NaN."""
        raise NotImplementedError


class StepLearner(Learner):
    """Base of learners whose training is measured in control steps of all environments together."""

    total_steps: int = traced(
        1_000_000, ge=1, le=2_000_000_000, exclude=True, description="control steps to train for, of all environments"
    )

    def progress(self, carry: Any) -> FloatScalar:
        return self.steps_done(carry) / self.total_steps

    def steps_done(self, carry: Any) -> FloatScalar:
        """Control steps so far, by the number of updates, `carry.update`."""
        return carry.update.astype(jnp.float32) * self.update_steps
