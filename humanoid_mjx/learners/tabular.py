"""Q-learning in a table (thesis section 6.2; C. Watkins, "Learning from Delayed Rewards", 1989).

    td_target = reward + discount * max_a' Q(s', a'),   Q(s, a) += learning_rate * (td_target - Q(s, a))

with no value beyond a terminal state. A task may change this by its `Rules`, as the pseudo-code of section 6.3 does.
With `agents` above 1 the learner is collective: that many episodes run at once and feed one table, each visited (s, a)
moving by the mean of the updates that fell on it.

A step first learns from the move that each agent has under way, then makes the next one. In this order a table is read
at two places and written at one, and XLA's CPU compiler keeps the arithmetic between them in fast loops.
"""

from functools import reduce
from typing import Any, ClassVar, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float, Int, Key
from pydantic import Field

from humanoid_mjx.compute import Program
from humanoid_mjx.compute.indexing import add_at
from humanoid_mjx.compute.rng import uniform
from humanoid_mjx.learners.base import Learner, Outcome
from humanoid_mjx.spec import traced
from humanoid_mjx.tasks.continuous import State
from humanoid_mjx.tasks.finite import FiniteTask
from humanoid_mjx.types import BoolScalar, FloatScalar, IntScalar

QTable = Float[Array, "num_states num_actions"]
QRow = tuple[FloatScalar, ...]
"""The values of one row of the table."""


class Agent(NamedTuple):
    """One episode under way, and the move just made in it."""

    key: Key[Array, ""]
    epsilon: FloatScalar
    episode: IntScalar
    length: IntScalar
    episode_return: FloatScalar
    row: IntScalar
    q_row: QRow
    action: IntScalar
    state: Any
    next_row: IntScalar
    reward: FloatScalar
    terminated: BoolScalar


class Carry(NamedTuple):
    """The training state of one sweep point. `agents` has a leading axis where the learner is collective."""

    q_table: QTable
    agents: Agent
    step: IntScalar


class Update(NamedTuple):
    """TD error of Q(row, action) from one move."""

    row: IntScalar
    action: IntScalar
    td_error: FloatScalar


class TabularQ(Learner):
    """Epsilon-greedy Q-learning in a table. In episode k epsilon is `max(epsilon_min, epsilon * epsilon_decay**k)`."""

    unit: ClassVar[str] = "episodes"
    program: ClassVar[Program] = "tabular"
    lap: ClassVar[int] = 32
    """On a GPU a loop of known length runs without a test on the host after each step."""

    task: FiniteTask = Field(exclude=True, repr=False)
    episodes: int = traced(1000, ge=1, le=1_000_000_000, exclude=True, description="episodes to train for")
    epsilon: float = traced(0.6, ge=0, le=1, description="initial probability of a random action")
    epsilon_decay: float = traced(1.0, ge=0, le=1, description="factor on epsilon after each episode")
    epsilon_min: float = traced(0.0, ge=0, le=1, description="lower bound of epsilon")
    learning_rate: float = traced(0.5, gt=0, le=1, description="share of the TD error that a value moves by")
    discount: float = traced(0.9, ge=0, lt=1, description="discount factor per step")
    agents: int = Field(1, ge=1, le=1_000_000, description="episodes at once that feed one table")

    @property
    def cumulative(self) -> bool:
        """True where an episode is a step of the only trajectory: curves are its totals so far."""
        return self.task.learning_rules.episode == "step"

    def init(self, key: Key[Array, ""], policy: QTable | None = None) -> Carry:
        q_table = jnp.asarray(self.task.initial_q() if policy is None else policy, jnp.float32)
        step = jnp.int32(0)

        def start(key: Key[Array, ""]) -> Agent:
            state = self.task.reset(jax.random.fold_in(key, 0))
            row, zero, nothing = self.task.state_index(state), jnp.int32(0), jnp.float32(0)
            epsilon, q_row = jnp.asarray(self.epsilon, jnp.float32), _row(q_table, row)
            agent = Agent(key, epsilon, zero, zero, nothing, row, q_row, zero, state, row, nothing, jnp.bool_(False))
            return self.move(agent, q_row, step)

        agents = start(key) if self.agents == 1 else jax.vmap(start)(jax.random.split(key, self.agents))
        return Carry(q_table, agents, step)

    def train_step(self, carry: Carry) -> tuple[Carry, Outcome]:
        """Learn from the moves under way and make the next ones."""
        q_table, agents, step = carry
        if self.agents == 1:
            update, outcome = self.learn(agents, _row(q_table, agents.next_row))
            q_table = _add(q_table, update, self.learning_rate * update.td_error)
            agents = self.go_on(agents, step + 1)
            agents = self.move(agents, _row(q_table, agents.row), step + 1)
        else:
            rows = jax.vmap(_row, in_axes=(None, 0))
            update, outcome = jax.vmap(self.learn)(agents, rows(q_table, agents.next_row))
            total = _add(jnp.zeros_like(q_table), update, update.td_error)
            count = _add(jnp.zeros_like(q_table), update, jnp.ones_like(update.td_error))
            q_table = q_table + self.learning_rate * total / jnp.maximum(count, 1.0)
            agents = jax.vmap(self.go_on, in_axes=(0, None))(agents, step + 1)
            agents = jax.vmap(self.move, in_axes=(0, 0, None))(agents, rows(q_table, agents.row), step + 1)
        return Carry(q_table, agents, step + 1), outcome

    def progress(self, carry: Carry) -> FloatScalar:
        return jnp.mean(carry.agents.episode / self.episodes)

    def policy(self, carry: Carry) -> QTable:
        return carry.q_table

    def observation(self, state: State) -> IntScalar:
        """The table row of the state of an episode."""
        return self.task.state_index(state.data[0])

    def act(self, policy: QTable, observation: IntScalar, key: Key[Array, ""]) -> Int[Array, " joints"]:
        """The greedy action in table row `observation`."""
        greedy = self._greedy(tuple(policy[observation]), jax.random.uniform(key))
        return self.env.joint_action(greedy)

    def _ended(self, agent: Agent) -> tuple[BoolScalar, BoolScalar]:
        """Return whether the trajectory ended with the move, and whether an episode did."""
        over = agent.terminated | (agent.length >= self.task.max_episode_steps)
        training = agent.episode < self.episodes
        return over, training if self.task.learning_rules.episode == "step" else training & over

    def learn(self, agent: Agent, next_q_row: QRow) -> tuple[Update, Outcome]:
        """Return the update by the move under way, and the record if it ended an episode. After training: nothing."""
        rules = self.task.learning_rules
        value = reduce(jnp.maximum, next_q_row)
        if not rules.bootstrap_at_end:
            value = jnp.where(agent.terminated, 0.0, value)
        old = agent.q_row[0]
        for action, q in enumerate(agent.q_row[1:], start=1):
            old = jnp.where(agent.action == action, q, old)
        td_target = agent.reward + self.discount * value
        learns = agent.episode < self.episodes
        if rules.update == "terminal":
            learns &= agent.terminated
        update = Update(agent.row, agent.action, jnp.where(learns, td_target - old, 0.0))
        _, ends = self._ended(agent)
        totals = {"steps": agent.length, "return": agent.episode_return}
        totals = {name: jnp.where(ends, x, 0.0) for name, x in totals.items()}
        totals["success"] = jnp.where(ends & agent.terminated, 1.0, 0.0)
        return update, Outcome(agent.episode, jnp.where(ends, 1.0, 0.0), totals, {})

    def go_on(self, agent: Agent, step: IntScalar) -> Agent:
        """Leave the move under way behind: the agent where the next is made, in a new episode if it ended one."""
        over, ends = self._ended(agent)
        fresh = self.task.reset(jax.random.fold_in(agent.key, step))
        episode = agent.episode + ends
        if self.task.learning_rules.episode == "step":
            episode = jnp.where(agent.terminated, self.episodes, episode)
        return agent._replace(
            epsilon=jnp.where(ends, agent.epsilon * self.epsilon_decay, agent.epsilon),
            episode=episode,
            length=jnp.where(ends, 0, agent.length),
            episode_return=jnp.where(ends, 0.0, agent.episode_return),
            row=jnp.where(over, self.task.state_index(fresh), agent.next_row),
            state=jax.tree.map(lambda new, old: jnp.where(over, new, old), fresh, agent.state),
        )

    def move(self, agent: Agent, q_row: QRow, step: IntScalar) -> Agent:
        """Choose an action epsilon-greedily where the agent is, and carry it out; `q_row`: the table's row there.

        Three random numbers belong to a step: whether to explore, the random action, the choice among equally good
        ones. Of the last two only one is needed, so only that one is drawn.
        """
        draw = jnp.asarray(step).astype(jnp.uint32) * np.uint32(3)
        obeys = (1.0 - jnp.maximum(self.epsilon_min, agent.epsilon)) * self.task.execution_rate
        if self.task.learning_rules.episode == "step":
            obeys = jnp.where(agent.episode == self.episodes - 1, self.task.execution_rate, obeys)
        greedy = uniform(agent.key, draw) < obeys
        choice = uniform(agent.key, draw + jnp.where(greedy, np.uint32(2), np.uint32(1)))
        random = (choice * self.task.num_actions).astype(jnp.int32)
        action = jnp.where(greedy, self._greedy(q_row, choice), random)
        task_key = jax.random.fold_in(jax.random.fold_in(agent.key, step), 1)
        state, reward, terminated = self.task.step(agent.state, action, task_key)
        return agent._replace(
            length=agent.length + 1,
            episode_return=agent.episode_return + reward,
            q_row=q_row,
            action=action,
            state=state,
            next_row=self.task.state_index(state),
            reward=jnp.asarray(reward, jnp.float32),
            terminated=terminated,
        )

    def _greedy(self, q_row: QRow, tie: FloatScalar) -> IntScalar:
        """The best action; `tie` in [0, 1) chooses among equally good ones."""
        top = reduce(jnp.maximum, q_row)
        best = [(q == top).astype(jnp.float32) for q in q_row]
        skip = 0.0 if self.task.learning_rules.ties == "first" else jnp.floor(tie * sum(best))
        action, passed = jnp.int32(0), jnp.float32(0)
        for index, is_best in enumerate(best):
            action = jnp.where((is_best > 0) & (passed == skip), index, action)
            passed += is_best
        return action


def _row(q_table: QTable, row: IntScalar) -> QRow:
    """The values of one row as scalars: a maximum over them compiles to arithmetic, over an array to a slow loop."""
    return tuple(q_table.at[row].get(mode="promise_in_bounds"))


def _add(q_table: QTable, update: Update, change: Float[Array, "..."]) -> QTable:
    place = update.row * q_table.shape[1] + update.action
    return add_at(q_table.reshape(-1), place, change).reshape(q_table.shape)
