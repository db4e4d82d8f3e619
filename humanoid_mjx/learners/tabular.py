"""Q-learning in a table (thesis section 6.2; C. Watkins, "Learning from Delayed Rewards", 1989).

    td_target = reward + discount * max_a' Q(s', a'),   Q(s, a) += learning_rate * (td_target - Q(s, a))

with no value beyond a terminal state. How a task bends this (the pseudo-code of section 6.3 does) stands in its
`Rules`. With `agents` above 1 the learner is collective: that many episodes run at once and feed one table, each
visited (s, a) moving by the mean of the updates that fell on it.

A step first learns from the move that each agent has under way, then makes the next one. In this order a table is
read at two places and written at one, and XLA's CPU compiler keeps the arithmetic between them in fast loops.
"""

from collections.abc import Mapping
from functools import reduce
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
from jaxtyping import Array, Float, Key
from pydantic import Field

from humanoid_mjx.spec import traced
from humanoid_mjx.learners.base import Learner
from humanoid_mjx.rng import uniforms
from humanoid_mjx.tasks.finite import FiniteTask
from humanoid_mjx.types import BoolScalar, FloatScalar, IntScalar

LAP = 32
"""Steps of training come in laps of so many: a GPU runs a loop of known length without asking after each step."""

QTable = Float[Array, "num_states num_actions"]


class Agent(NamedTuple):
    """One episode under way, and the move just made in it."""

    key: Key[Array, ""]
    epsilon: FloatScalar
    episode: IntScalar
    length: IntScalar
    episode_return: FloatScalar
    row: IntScalar
    q_row: tuple[FloatScalar, ...]
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
    record: Float[Array, "record 4"]


class Lesson(NamedTuple):
    """What a move says of Q(row, action), and what to record if it ended an episode."""

    row: IntScalar
    action: IntScalar
    td_error: FloatScalar
    point: IntScalar
    outcome: Float[Array, "4"]


class TabularQ(Learner):
    """Epsilon-greedy Q-learning in a table. In episode k epsilon is `max(epsilon_min, epsilon * epsilon_decay**k)`."""

    task: FiniteTask = Field(exclude=True, repr=False)
    epsilon: float = traced(0.6, ge=0, le=1)
    epsilon_decay: float = traced(1.0, ge=0, le=1)
    epsilon_min: float = traced(0.0, ge=0, le=1)
    learning_rate: float = traced(0.5, gt=0, le=1)
    discount: float = traced(0.9, ge=0, lt=1)
    agents: int = Field(1, ge=1, le=1_000_000, description="episodes at once that feed one table")

    @property
    def compiler_options(self) -> Mapping[str, str | bool]:
        return self.task.compiler_options

    def init(self, hyper: Params, key: Key[Array, ""], policy: QTable | None = None) -> Carry:
        q_table = jnp.asarray(self.task.initial_q(hyper.task) if policy is None else policy, jnp.float32)
        step = jnp.int32(0)

        def start(key: Key[Array, ""]) -> Agent:
            state = self.task.reset(hyper.task, jax.random.fold_in(key, 0))
            epsilon = jnp.asarray(hyper.epsilon, jnp.float32)
            return self._move(hyper, q_table, step, key, state, epsilon, step, step, jnp.float32(0))

        agents = start(key) if self.agents == 1 else jax.vmap(start)(jax.random.split(key, self.agents))
        return Carry(q_table, agents, step, jnp.zeros((self.record, 4)))

    def train_chunk(self, hyper: Params, carry: Carry, steps: IntScalar) -> tuple[Carry, dict[str, Array]]:
        def lap(_: IntScalar, carry: Carry) -> Carry:
            return jax.lax.fori_loop(0, LAP, lambda _, carry: self.train_step(hyper, carry), carry)

        carry = jax.lax.fori_loop(0, (steps + LAP - 1) // LAP, lap, carry)
        return carry, {"progress": jnp.mean(carry.agents.episode / hyper.episodes)}

    def train_step(self, hyper: Params, carry: Carry) -> Carry:
        """Learn from the moves under way and make the next ones."""
        q_table, agents, step, record = carry
        if self.agents == 1:
            lesson = self._lesson(hyper, q_table, agents)
            q_table = _add(q_table, lesson, hyper.learning_rate * lesson.td_error)
            agents = self._next(hyper, q_table, step + 1, agents)
        else:
            lesson = jax.vmap(self._lesson, in_axes=(None, None, 0))(hyper, q_table, agents)
            total = _add(jnp.zeros_like(q_table), lesson, lesson.td_error)
            count = _add(jnp.zeros_like(q_table), lesson, jnp.ones_like(lesson.td_error))
            q_table = q_table + hyper.learning_rate * total / jnp.maximum(count, 1.0)
            agents = jax.vmap(self._next, in_axes=(None, None, None, 0))(hyper, q_table, step + 1, agents)
        record = record.at[lesson.point].add(lesson.outcome, mode="promise_in_bounds")
        return Carry(q_table, agents, step + 1, record)

    def policy(self, carry: Carry) -> QTable:
        return carry.q_table

    def act(self, hyper: Params, policy: QTable, observation: IntScalar, key: Key[Array, ""]) -> IntScalar:
        """The greedy action in table row `observation`."""
        return self._greedy(tuple(policy[observation]), jax.random.uniform(key))

    def evaluate(self, hyper: Params, policy: QTable, key: Key[Array, ""]) -> dict[str, Array]:
        """One greedy episode; it succeeds if it reaches a terminal state before the cap."""
        start_key, key = jax.random.split(key)

        def running(loop):
            _, _, steps, terminated = loop
            return ~terminated & (steps < hyper.task.max_episode_steps)

        def step(loop):
            state, total, steps, _ = loop
            act_key, obey_key, choice_key, step_key = jax.random.split(jax.random.fold_in(key, steps), 4)
            action = self.act(hyper, policy, self.task.row(hyper.task, state), act_key)
            obeys = jax.random.uniform(obey_key) < self.task.obedience(hyper.task)
            random = (jax.random.uniform(choice_key) * self.task.num_actions).astype(jnp.int32)
            action = jnp.where(obeys, action, random)
            state, reward, terminated = self.task.step(hyper.task, state, action, step_key)
            return state, total + reward, steps + 1, terminated

        start = self.task.reset(hyper.task, start_key), jnp.float32(0), jnp.int32(0), jnp.bool_(False)
        _, total, steps, terminated = jax.lax.while_loop(running, step, start)
        return {"greedy_return": total, "greedy_steps": steps, "greedy_success": terminated.astype(jnp.float32)}

    def curve(self, hyper: Params, carry: Carry) -> dict[str, Float[Array, " record"]]:
        """Means over the episodes of each point: length, return, and the share that reached a terminal state.

        Where an episode is a step of the only trajectory: its totals so far.
        """
        episodes, steps, successes, returns = carry.record.T
        if self.task.learning_rules.episode == "step":
            return {
                "steps": jnp.cumsum(steps),
                "success": jnp.cumsum(successes),
                "return": jnp.cumsum(returns),
            }
        return {"steps": steps / episodes, "success": successes / episodes, "return": returns / episodes}

    def _ended(self, hyper: Params, agent: Agent) -> tuple[BoolScalar, BoolScalar]:
        """Whether the trajectory ended with the move, and whether an episode did."""
        over = agent.terminated | (agent.length >= hyper.task.max_episode_steps)
        training = agent.episode < hyper.episodes
        return over, training if self.task.learning_rules.episode == "step" else training & over

    def _lesson(self, hyper: Params, q_table: QTable, agent: Agent) -> Lesson:
        """What the move under way teaches. Once training is over it teaches nothing."""
        rules = self.task.learning_rules
        value = reduce(jnp.maximum, _row(q_table, agent.next_row))
        if not rules.bootstrap_at_end:
            value = jnp.where(agent.terminated, 0.0, value)
        old = agent.q_row[0]
        for action, q in enumerate(agent.q_row[1:], start=1):
            old = jnp.where(agent.action == action, q, old)
        td_error = agent.reward + hyper.discount * value - old
        learns = agent.episode < hyper.episodes
        if rules.update == "terminal":
            learns &= agent.terminated
        _, ends = self._ended(hyper, agent)
        outcome = 1.0, agent.length, agent.terminated, agent.episode_return
        return Lesson(
            row=agent.row,
            action=agent.action,
            td_error=jnp.where(learns, td_error, 0.0),
            point=self._point(hyper, agent.episode),
            outcome=jnp.stack([jnp.where(ends, x, 0.0) for x in outcome]),
        )

    def _next(self, hyper: Params, q_table: QTable, step: IntScalar, agent: Agent) -> Agent:
        """Go on from the move under way, in a new episode where it ended one."""
        over, ends = self._ended(hyper, agent)
        fresh = self.task.reset(hyper.task, jax.random.fold_in(agent.key, step))
        state = jax.tree.map(lambda new, old: jnp.where(over, new, old), fresh, agent.state)
        episode = agent.episode + ends
        if self.task.learning_rules.episode == "step":
            episode = jnp.where(agent.terminated, hyper.episodes, episode)
        epsilon = jnp.where(ends, agent.epsilon * hyper.epsilon_decay, agent.epsilon)
        length, total = jnp.where(ends, 0, agent.length), jnp.where(ends, 0.0, agent.episode_return)
        return self._move(hyper, q_table, step, agent.key, state, epsilon, episode, length, total)

    def _move(
        self,
        hyper: Params,
        q_table: QTable,
        step: IntScalar,
        key: Key[Array, ""],
        state: Any,
        epsilon: FloatScalar,
        episode: IntScalar,
        length: IntScalar,
        episode_return: FloatScalar,
    ) -> Agent:
        """Choose an action epsilon-greedily in `state`, and carry it out."""
        rules = self.task.learning_rules
        row = self.task.row(hyper.task, state)
        q_row = _row(q_table, row)
        explore, choice, tie = uniforms(key, step, 3)
        obeys = (1.0 - jnp.maximum(hyper.epsilon_min, epsilon)) * self.task.obedience(hyper.task)
        if rules.episode == "step":
            obeys = jnp.where(episode == hyper.episodes - 1, self.task.obedience(hyper.task), obeys)
        random = (choice * self.task.num_actions).astype(jnp.int32)
        action = jnp.where(explore < obeys, self._greedy(q_row, tie), random)
        task_key = jax.random.fold_in(jax.random.fold_in(key, step), 1)
        state, reward, terminated = self.task.step(hyper.task, state, action, task_key)
        return Agent(
            key=key,
            epsilon=epsilon,
            episode=episode,
            length=length + 1,
            episode_return=episode_return + reward,
            row=row,
            q_row=q_row,
            action=action,
            state=state,
            next_row=self.task.row(hyper.task, state),
            reward=jnp.asarray(reward, jnp.float32),
            terminated=terminated,
        )

    def _greedy(self, q_row: tuple[FloatScalar, ...], tie: FloatScalar) -> IntScalar:
        """The best action; `tie` in [0, 1) chooses among equally good ones."""
        top = reduce(jnp.maximum, q_row)
        best = [(q == top).astype(jnp.float32) for q in q_row]
        skip = 0.0 if self.task.learning_rules.ties == "first" else jnp.floor(tie * sum(best))
        action, passed = jnp.int32(0), jnp.float32(0)
        for index, is_best in enumerate(best):
            action = jnp.where((is_best > 0) & (passed == skip), index, action)
            passed += is_best
        return action

    def _point(self, hyper: Params, episode: IntScalar) -> IntScalar:
        """The point of the learning curve that an episode belongs to."""
        point = episode.astype(jnp.float32) * (self.record / hyper.episodes)
        return jnp.minimum(point.astype(jnp.int32), self.record - 1)


def _row(q_table: QTable, row: IntScalar) -> tuple[FloatScalar, ...]:
    """The values of one row as scalars: a maximum over them compiles to arithmetic, over an array to a slow loop."""
    return tuple(q_table.at[row].get(mode="promise_in_bounds"))


def _add(q_table: QTable, lesson: Lesson, change: Float[Array, "..."]) -> QTable:
    return q_table.at[lesson.row, lesson.action].add(change, mode="promise_in_bounds")
