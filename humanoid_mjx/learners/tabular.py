"""Q-learning in a table (thesis section 6.2; C. Watkins, "Learning from Delayed Rewards", 1989).

    td_target = reward + discount * max_a' Q(s', a'),   Q(s, a) += learning_rate * (td_target - Q(s, a))

with no value beyond a terminal state. The pseudo-code of section 6.3 differs (`FiniteTask.as_printed`).
The other methods are those of R. Sutton and A. Barto, "Reinforcement Learning" (2018): Sarsa (section 6.4), expected
Sarsa (6.6), double Q-learning (6.7), n-step Sarsa (7.2) and Watkins's Q(lambda) with replacing traces (12.10).

With `agents` above 1 the learner is collective: that many episodes run at once and feed one table, each visited (s, a)
moving by the mean of the updates that fell on it.

A step first learns from the move that each agent has under way, then makes the next one. In this order a table is read
at two places and written at one, and XLA's CPU compiler keeps the arithmetic between them in fast loops.
"""

from collections.abc import Mapping
from functools import reduce
from typing import Any, ClassVar, Literal, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float, Int, Key
from pydantic import Field, model_validator

from humanoid_mjx.compute import Program
from humanoid_mjx.compute.rng import uniform
from humanoid_mjx.compute.ways import add_at, ways
from humanoid_mjx.learners.base import Learner, Outcome
from humanoid_mjx.learners.exploration import QRow, drawn, entry, softmax, upper_bounds
from humanoid_mjx.spec import traced
from humanoid_mjx.tasks.continuous import State
from humanoid_mjx.tasks.finite import FiniteTask
from humanoid_mjx.types import BoolScalar, FloatScalar, IntScalar

QTable = Float[Array, "num_states num_actions"]

MOST_STEPS = 16
"""Moves that an agent of `n_step` holds. The number of `steps` is data and may be swept up to here."""

LAST = np.uint32(2**32 - 1)
"""Number of the random key that draws the first table; the numbers of steps count up from 0."""


class Past(NamedTuple):
    """The moves of the episode from which no value has learned yet, (row, action, reward) with the newest first.

    `due`: the target of the oldest is complete. `waits`: the episode has ended, and others than the oldest are left.
    """

    moves: tuple[tuple[IntScalar, IntScalar, FloatScalar], ...]
    count: IntScalar
    due: BoolScalar
    waits: BoolScalar


class Agent(NamedTuple):
    """One episode under way, and the move just made in it.

    `epsilon`: with `boltzmann` the temperature, with `ucb` the confidence. `ahead`: of `sarsa` and `n_step`, the action
    chosen in `next_row`. `coin`: of `double_q`, a uniform number that says which table learns. `past`: of `n_step`.
    """

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
    ahead: IntScalar | None = None
    coin: FloatScalar | None = None
    past: Past | None = None


class Carry(NamedTuple):
    """The training state of one sweep point. `agents` has a leading axis where the learner is collective.

    `q_table` has a column of values for each action, with `double_q` two. Where updates are counted their numbers stand
    in as many columns more. `traces`: of `q_lambda`.
    """

    q_table: Float[Array, "num_states columns"]
    agents: Agent
    step: IntScalar
    traces: QTable | None = None


class Update(NamedTuple):
    """TD error of the value at (row, column) from one move; `learns`: whether it changes the value."""

    row: IntScalar
    column: IntScalar
    td_error: FloatScalar
    learns: BoolScalar


class TabularQ(Learner):
    """Q-learning and its relatives in a table. In episode k epsilon is `max(epsilon_min, epsilon * epsilon_decay**k)`.

    `decay` makes k the number of steps, or of updates in the state. Temperature and confidence decay as epsilon does.
    """

    unit: ClassVar[str] = "episodes"
    program: ClassVar[Program] = "tabular"
    lap: ClassVar[int] = 32
    """On a GPU a loop of known length runs without a test on the host after each step."""

    read_with: ClassVar[Mapping[str, Mapping[str, str]]] = {
        "method": {"steps": "n_step", "trace_decay": "q_lambda"},
        "exploration": {"epsilon": "epsilon_greedy", "temperature": "boltzmann", "confidence": "ucb"},
        "step_size": {"learning_rate": "constant"},
    }

    task: FiniteTask = Field(exclude=True, repr=False)
    episodes: int = traced(1000, ge=1, le=1_000_000_000, exclude=True, description="episodes to train for")
    method: Literal["q_learning", "sarsa", "expected_sarsa", "double_q", "n_step", "q_lambda"] = Field(
        "q_learning", description="rule of the target"
    )
    steps: int = traced(4, ge=1, le=MOST_STEPS, description="rewards in a target of n_step")
    trace_decay: float = traced(0.9, ge=0, le=1, description="lambda of q_lambda")
    exploration: Literal["epsilon_greedy", "boltzmann", "ucb"] = Field(
        "epsilon_greedy", description="rule by which training chooses actions"
    )
    epsilon: float = traced(0.6, ge=0, le=1, description="initial probability of a random action")
    temperature: float = traced(1.0, gt=0, le=1e6, description="initial temperature of boltzmann, in units of value")
    confidence: float = traced(1.0, ge=0, le=1e6, description="initial factor of ucb's bonus, in units of value")
    epsilon_decay: float = traced(1.0, ge=0, le=1, description="factor on epsilon after each episode, or see decay")
    epsilon_min: float = traced(0.0, ge=0, le=1, description="lower bound of epsilon")
    decay: Literal["episode", "step", "visit"] = Field(
        "episode", description="epsilon decays by each episode, each step, or each update in the state"
    )
    learning_rate: float = traced(0.5, gt=0, le=1, description="share of the TD error that a value moves by")
    step_size: Literal["constant", "visits"] = Field(
        "constant", description="constant: the learning rate; visits: 1 / number of updates of the value"
    )
    initial_value: float = traced(0.0, description="added to the task's table before learning")
    initial_spread: float = traced(
        0.0, ge=0, le=1e6, description="bound of random numbers of both signs that are added to it as well"
    )
    discount: float = traced(0.9, ge=0, lt=1, description="discount factor per step")
    agents: int = Field(1, ge=1, le=1_000_000, description="episodes at once that feed one table")

    @model_validator(mode="after")
    def _keys_must_fit_together(self) -> "TabularQ":
        if self.start_from and (own := [key for key in ("initial_value", "initial_spread") if getattr(self, key)]):
            raise ValueError(f"{own[0]} is not read with start_from, which brings tables; leave one of them out")
        if self.task.as_printed and (self.method, self.exploration) != ("q_learning", "epsilon_greedy"):
            raise ValueError(
                "a task with rules of its own takes method q_learning and exploration epsilon_greedy alone"
            )
        if self.agents > 1 and (self.counts or self.method in ("sarsa", "n_step", "q_lambda")):
            alone = "method sarsa, n_step or q_lambda, exploration ucb, step_size visits or decay visit"
            raise ValueError(f"agents must be 1 with {alone}, got {self.agents}")
        return self

    @property
    def cumulative(self) -> bool:
        """True where an episode is a step of the only trajectory: curves are its totals so far."""
        return self.task.as_printed

    @property
    def counts(self) -> bool:
        """True where the table holds the number of updates of each value."""
        return self.step_size == "visits" or self.exploration == "ucb" or self.decay == "visit"

    @property
    def columns(self) -> int:
        """Values in a row of the table."""
        return self.task.num_actions * (2 if self.method == "double_q" else 1)

    def init(self, key: Key[Array, ""], policy: QTable | None = None) -> Carry:
        values = jnp.asarray(self.task.initial_q() + self.initial_value if policy is None else policy, jnp.float32)
        q_table = jnp.tile(values, self.columns // self.task.num_actions)
        if policy is None:
            draws = jax.random.uniform(jax.random.fold_in(key, LAST), q_table.shape, minval=-1.0)
            q_table = q_table + self.initial_spread * draws
        q_table = jnp.concatenate([q_table, jnp.zeros_like(q_table)], axis=1) if self.counts else q_table
        step, amounts = jnp.int32(0), {"boltzmann": self.temperature, "ucb": self.confidence}

        def start(key: Key[Array, ""]) -> Agent:
            state = self.task.reset(jax.random.fold_in(key, 0))
            row, zero, nothing = self.task.state_index(state), jnp.int32(0), jnp.float32(0)
            epsilon = jnp.asarray(amounts.get(self.exploration, self.epsilon), jnp.float32)
            ahead = zero if self.method in ("sarsa", "n_step") else None
            no, q_row = jnp.bool_(False), _row(q_table, row)
            past = Past(((zero, zero, nothing),) * MOST_STEPS, zero, no, no) if self.method == "n_step" else None
            moved = row, nothing, no, ahead, None, past
            return self.move(Agent(key, epsilon, zero, zero, nothing, row, q_row, zero, state, *moved), q_row, step)

        agents = start(key) if self.agents == 1 else jax.vmap(start)(jax.random.split(key, self.agents))
        return Carry(q_table, agents, step, jnp.zeros_like(values) if self.method == "q_lambda" else None)

    def train_step(self, carry: Carry) -> tuple[Carry, Outcome]:
        """Learn from the moves under way and make the next ones."""
        q_table, agents, step, traces = carry
        mapped: Any = jax.vmap if self.agents > 1 else lambda function, in_axes=0: function
        rows = mapped(_row, in_axes=(None, 0))
        next_q_row = rows(q_table, agents.next_row)
        if agents.ahead is not None:
            agents = agents._replace(ahead=self.choose(agents, next_q_row, step + 1))
        if (past := agents.past) is not None:  # its oldest move takes the place of the one under way
            row, action, _ = (entry(each, past.count - 1) for each in zip(*past.moves, strict=True))
            last = agents.terminated | (agents.length >= self.task.max_episode_steps)
            past = past._replace(due=last | (past.count >= self.steps), waits=last & (past.count > 1))
            agents = agents._replace(row=row, action=action, q_row=_row(q_table, row), past=past)
        update, outcome = mapped(self.learn)(agents, next_q_row)
        if self.agents == 1:
            q_table, traces = self._learned(q_table, traces, agents, update)
        else:
            total = _add(jnp.zeros_like(q_table), update, update.td_error)
            count = _add(jnp.zeros_like(q_table), update, jnp.ones_like(update.td_error))
            q_table = q_table + self.learning_rate * total / jnp.maximum(count, 1.0)
        agents = mapped(self.go_on, in_axes=(0, None))(agents, step + 1)
        agents = mapped(self.move, in_axes=(0, 0, None))(agents, rows(q_table, agents.row), step + 1)
        return Carry(q_table, agents, step + 1, traces), outcome

    def progress(self, carry: Carry) -> FloatScalar:
        return jnp.mean(carry.agents.episode / self.episodes)

    def policy(self, carry: Carry) -> QTable:
        """The values by action, of `double_q` the means of both tables."""
        return jax.vmap(lambda q_row: jnp.stack(self._values(tuple(q_row))))(carry.q_table)

    def observation(self, state: State) -> IntScalar:
        """The table row of the state of an episode."""
        return self.task.state_index(state.data[0])

    def act(self, policy: QTable, observation: IntScalar, key: Key[Array, ""]) -> Int[Array, " joints"]:
        """The greedy action in table row `observation`."""
        greedy = self._greedy(tuple(policy[observation]), jax.random.uniform(key))
        return self.env.joint_action(greedy)

    def learn(self, agent: Agent, next_q_row: QRow) -> tuple[Update, Outcome]:
        """Return the update by the move under way, and the record if it ended an episode. After training: nothing."""
        value = self._next_value(agent, next_q_row)
        if not self.task.as_printed:
            value = jnp.where(agent.terminated, 0.0, value)
        column = agent.action
        if agent.coin is not None:
            column = jnp.where(agent.coin < 0.5, column, column + self.task.num_actions)
        old = entry(agent.q_row[: self.columns], column)
        td_target = agent.reward + self.discount * value
        learns = agent.episode < self.episodes
        if self.task.as_printed:
            learns &= agent.terminated
        if agent.past is not None:
            learns, td_target = learns & agent.past.due, value
            for back, (_, _, reward) in enumerate(agent.past.moves):
                td_target = jnp.where(back < agent.past.count, reward + self.discount * td_target, td_target)
        update = Update(agent.row, column, jnp.where(learns, td_target - old, 0.0), learns)
        _, ends = self._ended(agent)
        totals = {"steps": agent.length, "return": agent.episode_return}
        totals = {name: jnp.where(ends, x, 0.0) for name, x in totals.items()}
        totals["success"] = jnp.where(ends & agent.terminated, 1.0, 0.0)
        return update, Outcome(agent.episode, jnp.where(ends, 1.0, 0.0), totals, {})

    def go_on(self, agent: Agent, step: IntScalar) -> Agent:
        """Leave the move under way behind: the agent where the next is made, in a new episode if it ended one."""
        over, ends = self._ended(agent)
        fresh = self.task.reset(jax.random.fold_in(agent.key, step))
        episode, past = agent.episode + ends, agent.past
        if self.task.as_printed:
            episode = jnp.where(agent.terminated, self.episodes, episode)
        if past is not None:
            past = past._replace(count=past.count - past.due)
        decays = ends if self.decay == "episode" else jnp.bool_(False)
        return agent._replace(
            epsilon=jnp.where(decays, agent.epsilon * self.epsilon_decay, agent.epsilon),
            episode=episode,
            length=jnp.where(ends, 0, agent.length),
            episode_return=jnp.where(ends, 0.0, agent.episode_return),
            row=jnp.where(over, self.task.state_index(fresh), agent.next_row),
            state=jax.tree.map(lambda new, old: jnp.where(over, new, old), fresh, agent.state),
            past=past,
        )

    def move(self, agent: Agent, q_row: QRow, step: IntScalar) -> Agent:
        """Carry out an action where the agent is; `q_row`: the table's row there."""
        action = self.choose(agent, q_row, step)
        if agent.ahead is not None:
            action = jnp.where(agent.length > 0, agent.ahead, action)
        task_key = jax.random.fold_in(jax.random.fold_in(agent.key, step), 1)
        state, reward, terminated = self.task.step(agent.state, action, task_key)
        moved = agent._replace(
            length=agent.length + 1,
            episode_return=agent.episode_return + reward,
            q_row=q_row,
            action=action,
            state=state,
            next_row=self.task.state_index(state),
            reward=jnp.asarray(reward, jnp.float32),
            terminated=terminated,
        )
        if self.decay == "step":
            moved = moved._replace(epsilon=agent.epsilon * self.epsilon_decay)
        if self.method == "double_q":
            moved = moved._replace(coin=uniform(agent.key, ~jnp.asarray(step).astype(jnp.uint32)))
        if (past := agent.past) is None:
            return moved
        moves = (agent.row, action, moved.reward), *past.moves[:-1]
        moved = moved._replace(past=past._replace(moves=moves, count=past.count + 1))
        kept = jax.tree.map(lambda old, new: jnp.where(past.waits, old, new), agent[1:], moved[1:])
        return Agent(agent.key, *kept)

    def choose(self, agent: Agent, q_row: QRow, step: IntScalar) -> IntScalar:
        """Choose an action in a row.

        Three random numbers belong to a step: whether an action at random takes the place of the preferred one, the
        random action, the choice among equally good ones. Of the last two only one is needed. A CPU draws both, which
        is sooner than to wait until it is known which.
        """
        draw = jnp.asarray(step).astype(jnp.uint32) * np.uint32(3)
        preferred = uniform(agent.key, draw) < self._obedience(agent, q_row)
        tie, other = draw + np.uint32(2), draw + np.uint32(1)
        if ways().draws_ahead:
            choice = jnp.where(preferred, uniform(agent.key, tie), uniform(agent.key, other))
        else:
            choice = uniform(agent.key, jnp.where(preferred, tie, other))
        random = (choice * self.task.num_actions).astype(jnp.int32)
        greedy = self.exploration == "epsilon_greedy"
        best = self._greedy(self._values(q_row), choice) if greedy else drawn(self._odds(agent, q_row), choice)
        return jnp.where(preferred, best, random)

    def _obedience(self, agent: Agent, q_row: QRow) -> FloatScalar:
        """The probability of the preferred action; else one at random takes its place."""
        if self.exploration != "epsilon_greedy":
            return self.task.execution_rate
        obeys = (1.0 - self._amount(agent, q_row)) * self.task.execution_rate
        if self.task.as_printed:
            obeys = jnp.where(agent.episode == self.episodes - 1, self.task.execution_rate, obeys)
        return obeys

    def _amount(self, agent: Agent, q_row: QRow) -> FloatScalar:
        """Epsilon, the temperature or the confidence in a row."""
        amount = agent.epsilon
        if self.decay == "visit":
            amount = amount * self.epsilon_decay ** sum(q_row[self.columns :])
        return jnp.maximum(self.epsilon_min, amount)

    def _odds(self, agent: Agent, q_row: QRow) -> QRow:
        """The odds of each action to be the preferred one."""
        values = self._values(q_row)
        if self.exploration == "boltzmann":
            return softmax(values, self._amount(agent, q_row))
        if self.exploration == "ucb":
            visits = self._by_action(q_row[self.columns :])
            values = upper_bounds(values, visits, self._amount(agent, q_row))
        best = reduce(jnp.maximum, values)
        return tuple((value == best).astype(jnp.float32) for value in values)

    def _next_value(self, agent: Agent, q_row: QRow) -> FloatScalar:
        """The value of the next state, whose row is given, by the `method`."""
        values, count = self._values(q_row), self.task.num_actions
        if agent.ahead is not None:
            return entry(values, agent.ahead)
        if agent.coin is not None:  # one bit of it says which table learns, the others break ties
            first = agent.coin < 0.5
            learning = tuple(jnp.where(first, *pair) for pair in zip(q_row[:count], q_row[count:], strict=False))
            best = self._greedy(learning, 2.0 * agent.coin - jnp.where(first, 0.0, 1.0))
            return entry(q_row[: self.columns], jnp.where(first, best + count, best))
        if self.method == "expected_sarsa":
            odds, mean = self._odds(agent, q_row), sum(values) / count
            preferred = sum(share * value for share, value in zip(odds, values, strict=True)) / sum(odds)
            return mean + self._obedience(agent, q_row) * (preferred - mean)
        return reduce(jnp.maximum, values)

    def _learned(self, q_table: Array, traces: QTable | None, agent: Agent, update: Update) -> tuple[Array, Any]:
        """The table and the traces after an update."""
        rate, columns = self.learning_rate, self.columns
        if self.counts:
            visit = update._replace(column=update.column + columns)
            q_table = _add(q_table, visit, update.learns.astype(jnp.float32))
        if traces is None:
            if self.step_size == "visits":
                rate = 1.0 / (entry(agent.q_row[columns:], update.column) + 1.0)
            return _add(q_table, update, rate * update.td_error), None
        greedy = entry(agent.q_row[:columns], agent.action) == reduce(jnp.maximum, agent.q_row[:columns])
        traces = traces * jnp.where(greedy & (agent.length > 1), self.discount * self.trace_decay, 0.0)
        traces = traces.at[agent.row, agent.action].set(1.0)
        values, visits = q_table[:, :columns], q_table[:, columns:]
        if self.step_size == "visits":
            rate = 1.0 / jnp.maximum(visits, 1.0)
        return jnp.concatenate([values + rate * update.td_error * traces, visits], axis=1), traces

    def _ended(self, agent: Agent) -> tuple[BoolScalar, BoolScalar]:
        """Return whether the trajectory ended with the move, and whether an episode did."""
        over = agent.terminated | (agent.length >= self.task.max_episode_steps)
        if agent.past is not None:
            over &= ~agent.past.waits
        training = agent.episode < self.episodes
        return over, training if self.task.as_printed else training & over

    def _by_action(self, q_row: QRow) -> QRow:
        """The sums over the columns of each action, of which `double_q` has two."""
        return tuple(reduce(jnp.add, q_row[action :: self.task.num_actions]) for action in range(self.task.num_actions))

    def _values(self, q_row: QRow) -> QRow:
        """The values by action."""
        values = self._by_action(q_row[: self.columns])
        return tuple(0.5 * value for value in values) if self.method == "double_q" else values

    def _greedy(self, q_row: QRow, tie: FloatScalar) -> IntScalar:
        """The best action; `tie` in [0, 1) chooses among equally good ones."""
        top = reduce(jnp.maximum, q_row)
        best = [(q == top).astype(jnp.float32) for q in q_row]
        skip = 0.0 if self.task.as_printed else jnp.floor(tie * sum(best))
        action, passed = jnp.int32(0), jnp.float32(0)
        for index, is_best in enumerate(best):
            action = jnp.where((is_best > 0) & (passed == skip), index, action)
            passed += is_best
        return action


def _row(q_table: QTable, row: IntScalar) -> QRow:
    """The values of one row as scalars: a maximum over them compiles to arithmetic, over an array to a slow loop."""
    return tuple(q_table.at[row].get(mode="promise_in_bounds", wrap_negative_indices=False))


def _add(q_table: QTable, update: Update, change: Float[Array, "..."]) -> QTable:
    place = update.row * q_table.shape[1] + update.column
    return add_at(q_table.reshape(-1), place, change).reshape(q_table.shape)
