"""Move one joint from a start angle to a goal angle in equal steps (thesis section 6.3, results 7 E to 7 G)."""

import math
from typing import ClassVar, Literal

import jax.numpy as jnp
from jaxtyping import Array, Float, Int, Key
from pydantic import Field, model_validator

from humanoid_mjx.compute import Arithmetic
from humanoid_mjx.spec import traced
from humanoid_mjx.tasks.finite import FiniteTask
from humanoid_mjx.thesis import q_learning as thesis
from humanoid_mjx.types import BoolScalar, FloatScalar, IntScalar


class JointReach(FiniteTask):
    """A joint stands at `start` degrees; the actions are to stay, or to move by `action` degrees towards the goal.

    The controller's `states` are points spaced equally from start to goal, and the joint's angle maps to the nearest
    of them (the first of two equally near). The reward of a step is a tenth of the new point's angle, and
    `step_reward`; reaching the goal ends the episode and earns `bonus`. With probability `1 - success_rate` a random
    action takes the place of the chosen one.
    """

    arithmetic: ClassVar[Arithmetic] = "scalars"
    num_actions: ClassVar[int] = 2

    joint: Literal[1, 4, 5] | None = Field(1, description="which joint's start and goal to take where none are given")
    start: float = traced(description="angle at the start, degrees")
    goal: float = traced(description="angle to reach, degrees")
    action: float = traced(5.0, description="degrees a move takes towards the goal")
    states: int = Field(24, ge=2, le=1_000_000, description="rows of the table")
    rules: Literal["standard", "printed"] = Field(
        "standard", description="learning as section 6.2 describes it, or as the pseudo-code of 6.3 prints it"
    )
    bonus: float = traced(100.0, description="reward for reaching the goal")
    step_reward: float = traced(0.0, description="added to the reward of every step")
    success_rate: float = traced(1.0, ge=0, le=1, description="probability that the chosen action is carried out")

    @model_validator(mode="before")
    @classmethod
    def _fill_from_joint(cls, data: dict) -> dict:
        joint = data.get("joint", 1) if isinstance(data, dict) else None
        if isinstance(joint, int) and joint in thesis.JOINT_RANGES:
            start, goal = thesis.JOINT_RANGES[joint]
            data = {"start": start, "goal": goal} | data
        return data

    @model_validator(mode="after")
    def _goal_must_be_hit(self) -> "JointReach":
        if self.goal == self.start:
            raise ValueError("goal equals start, so there is nothing to learn")
        if self.action == 0:
            raise ValueError("action must be a non-zero number of degrees")
        moves = (self.goal - self.start) / self.action
        if moves < 0.5 or not math.isfinite(moves) or abs(moves - round(moves)) > 1e-6:
            raise ValueError(
                f"from {self.start:g} the goal {self.goal:g} cannot be hit in steps of {self.action:g} degrees; "
                f"the distance {self.goal - self.start:g} must be a whole multiple of action"
            )
        if round(moves) > 1_000_000:
            raise ValueError(
                f"{round(moves)} steps of action lie between start and goal; at most 1,000,000 are handled"
            )
        return self

    @property
    def num_states(self) -> int:
        return self.states

    @property
    def as_printed(self) -> bool:
        return self.rules == "printed"

    def reset(self, key: Key[Array, ""]) -> IntScalar:
        """The number of moves made: none."""
        return jnp.int32(0)

    def step(
        self, state: IntScalar, action: IntScalar, key: Key[Array, ""]
    ) -> tuple[IntScalar, FloatScalar, BoolScalar]:
        goal = self._moves_to_goal()
        state = jnp.minimum(state + action, goal)
        reached = state == goal
        reward = thesis.REWARD_SCALE * self._angle_of_row(self.state_index(state))
        return state, reward + self.step_reward + jnp.where(reached, self.bonus, 0.0), reached

    def state_index(self, state: IntScalar) -> IntScalar:
        place = state * (self.states - 1.0) / self._moves_to_goal()
        return jnp.ceil(place - 0.5).astype(jnp.int32)

    def initial_q(self) -> Float[Array, "num_states 2"]:
        """The reward of each row, for both actions (section 6.3: `Q = repmat(R, ...)`)."""
        rewards = thesis.REWARD_SCALE * self._angle_of_row(jnp.arange(self.states))
        return jnp.stack([rewards, rewards], axis=1)

    @property
    def execution_rate(self) -> FloatScalar:
        return self.success_rate

    def _moves_to_goal(self) -> IntScalar:
        return jnp.round((self.goal - self.start) / self.action).astype(jnp.int32)

    def _angle_of_row(self, row: Int[Array, "..."]) -> Float[Array, "..."]:
        return self.start + (self.goal - self.start) * row / (self.states - 1)
