"""Q-learning in a table (thesis section 6.2; C. Watkins, "Learning from Delayed Rewards", 1989).

    td_target = reward + discount * max_a' Q(s', a'),   Q(s, a) += learning_rate * (td_target - Q(s, a))

with no value beyond a terminal state. How a task bends this (the pseudo-code of section 6.3 does) stands in its
`Rules`. With `agents` above 1 the learner is collective: that many episodes run at once and feed one table, each
visited (s, a) moving by the mean of the updates that fell on it.
"""

from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
from jaxtyping import Array, Bool, Float, Int, Key
from pydantic import Field, model_validator

from humanoid_mjx.learners.base import Learner
from humanoid_mjx.tasks.finite import FiniteTask, uniform_action


class Agent(NamedTuple):
    """One episode under way: where it stands, what it will do next, what it has gathered."""

    key: Key[Array, ""]
    state: Any
    row: Int[Array, ""]
    q_row: Float[Array, " num_actions"]
    action: Int[Array, ""]
    epsilon: Float[Array, ""]
    episode: Int[Array, ""]
    length: Int[Array, ""]
    episode_return: Float[Array, ""]


class Carry(NamedTuple):
    """The training state of one sweep point. `agents` has a leading axis where the learner is collective."""

    q_table: Float[Array, "num_states num_actions"]
    agents: Agent
    step: Int[Array, ""]
    record: Float[Array, "record 4"]


class Transition(NamedTuple):
    """What one step says of Q(row, action), and, if it ended an episode, what is to be recorded."""

    row: Int[Array, ""]
    action: Int[Array, ""]
    td_error: Float[Array, ""]
    learns: Bool[Array, ""]
    point: Int[Array, ""]
    outcome: Float[Array, "4"]


class TabularQ(Learner):
    """Epsilon-greedy Q-learning in a table. In episode k epsilon is `max(epsilon_min, epsilon * epsilon_decay**k)`."""

    epsilon: float = Field(0.6, ge=0, le=1)
    epsilon_decay: float = Field(1.0, ge=0, le=1)
    epsilon_min: float = Field(0.0, ge=0, le=1)
    learning_rate: float = Field(0.5, gt=0, le=1)
    discount: float = Field(0.9, ge=0, lt=1)
    agents: int = Field(1, ge=1, le=1_000_000, description="episodes at once that feed one table")

    class Params(NamedTuple):
        task: Any
        episodes: int
        epsilon: float
        epsilon_decay: float
        epsilon_min: float
        learning_rate: float
        discount: float

    @model_validator(mode="after")
    def _task_must_be_finite(self) -> "TabularQ":
        if not isinstance(self.task, FiniteTask):
            raise ValueError(f"a table needs a finite task, and {type(self.task).__name__} is none")
        return self

    def init(
        self, hyper: Params, key: Key[Array, ""], policy: Float[Array, "num_states num_actions"] | None = None
    ) -> Carry:
        q_table = jnp.asarray(self.task.initial_q(hyper.task) if policy is None else policy, jnp.float32)
        step = jnp.int32(0)

        def start(key: Key[Array, ""]) -> Agent:
            zero = jnp.int32(0)
            state = self.task.reset(hyper.task, jax.random.fold_in(key, 2**32 - 1))
            epsilon = jnp.asarray(hyper.epsilon, jnp.float32)
            agent = Agent(key, state, zero, q_table[0], zero, epsilon, zero, zero, jnp.float32(0))
            return self._choose(hyper, q_table, step, agent)

        agents = start(key) if self.agents == 1 else jax.vmap(start)(jax.random.split(key, self.agents))
        return Carry(q_table, agents, step, jnp.zeros((self.record, 4)))

    def train_chunk(self, hyper: Params, carry: Carry, steps: int) -> tuple[Carry, dict[str, Array]]:
        carry, _ = jax.lax.scan(lambda carry, _: (self.train_step(hyper, carry), None), carry, length=steps)
        return carry, {"progress": jnp.mean(carry.agents.episode / hyper.episodes)}

    def train_step(self, hyper: Params, carry: Carry) -> Carry:
        """One step of every agent, and its effect on the table."""
        one = self.agents == 1
        over_agents = (lambda f: f) if one else (lambda f: jax.vmap(f, in_axes=(None, None, None, 0)))
        write = _write if one else _write_mean
        agents, seen = over_agents(self._move)(hyper, carry.q_table, carry.step, carry.agents)
        q_table = write(carry.q_table, seen, hyper.learning_rate)
        record = carry.record.at[seen.point].add(seen.outcome, mode="promise_in_bounds")
        step = carry.step + 1
        return Carry(q_table, over_agents(self._choose)(hyper, q_table, step, agents), step, record)

    def policy(self, carry: Carry) -> Float[Array, "num_states num_actions"]:
        return carry.q_table

    def act(
        self,
        hyper: Params,
        policy: Float[Array, "num_states num_actions"],
        observation: Int[Array, ""],
        key: Key[Array, ""],
    ) -> Int[Array, ""]:
        """The greedy action in table row `observation`."""
        return self._greedy(policy[observation], jax.random.uniform(key))

    def curve(self, hyper: Params, carry: Carry) -> dict[str, Float[Array, " record"]]:
        """Means over the episodes of each point: length, return, and the share that reached a terminal state."""
        episodes, steps, successes, returns = carry.record.T
        return {"steps": steps / episodes, "success": successes / episodes, "return": returns / episodes}

    def _move(
        self, hyper: Params, q_table: Float[Array, "num_states num_actions"], step: Int[Array, ""], agent: Agent
    ) -> tuple[Agent, Transition]:
        """Carry out the chosen action; end the episode where it ends."""
        rules = self.task.learning_rules
        step_key, reset_key = jax.random.split(jax.random.fold_in(jax.random.fold_in(agent.key, step), 1))
        state, reward, terminated = self.task.step(hyper.task, agent.state, agent.action, step_key)
        value = q_table.at[self.task.row(hyper.task, state)].get(mode="promise_in_bounds").max()
        if not rules.bootstrap_at_end:
            value = jnp.where(terminated, 0.0, value)
        td_error = reward + hyper.discount * value - agent.q_row[agent.action]

        training = agent.episode < hyper.episodes
        length, episode_return = agent.length + 1, agent.episode_return + reward
        over = terminated | (length >= hyper.task.max_episode_steps)
        if rules.episode == "restart":
            ends, episode = training & over, agent.episode + over
        else:
            ends, episode = training, jnp.where(terminated, hyper.episodes, agent.episode + 1)
        seen = Transition(
            row=agent.row,
            action=agent.action,
            td_error=td_error,
            learns=training & (terminated | (rules.update == "every")),
            point=self._point(hyper, agent.episode),
            outcome=jnp.where(ends, jnp.stack([1.0, length, terminated, episode_return]), 0.0),
        )
        fresh = self.task.reset(hyper.task, reset_key)
        agent = agent._replace(
            state=jax.tree.map(lambda new, old: jnp.where(over, new, old), fresh, state),
            epsilon=jnp.where(ends, agent.epsilon * hyper.epsilon_decay, agent.epsilon),
            episode=jnp.where(training, episode, agent.episode),
            length=jnp.where(ends, 0, length),
            episode_return=jnp.where(ends, 0.0, episode_return),
        )
        return agent, seen

    def _choose(
        self, hyper: Params, q_table: Float[Array, "num_states num_actions"], step: Int[Array, ""], agent: Agent
    ) -> Agent:
        """Choose the next action, epsilon-greedily."""
        rules = self.task.learning_rules
        key = jax.random.fold_in(agent.key, step)
        explore, choice, tie = jax.random.uniform(key, (3,))
        row = self.task.row(hyper.task, agent.state)
        q_row = q_table.at[row].get(mode="promise_in_bounds")
        epsilon = jnp.maximum(hyper.epsilon_min, agent.epsilon)
        if rules.episode == "step":
            epsilon = jnp.where(agent.episode == hyper.episodes - 1, 0.0, epsilon)
        random = (choice * self.task.num_actions).astype(jnp.int32)
        action = jnp.where(explore < epsilon, random, self._greedy(q_row, tie))
        action = self.task.override(hyper.task, action, jax.random.fold_in(key, 0))
        return agent._replace(row=row, q_row=q_row, action=action)

    def _greedy(self, q_row: Float[Array, " num_actions"], tie: Float[Array, ""]) -> Int[Array, ""]:
        """The best action; `tie` in [0, 1) chooses among equally good ones."""
        if self.task.learning_rules.ties == "first":
            return jnp.argmax(q_row).astype(jnp.int32)
        best = [q == jnp.max(q_row) for q in q_row]
        skip = jnp.floor(tie * sum(b.astype(jnp.float32) for b in best))
        action, passed = jnp.int32(0), jnp.float32(0)
        for index, is_best in enumerate(best):
            action = jnp.where(is_best & (passed == skip), index, action)
            passed += is_best
        return action

    def _point(self, hyper: Params, episode: Int[Array, ""]) -> Int[Array, ""]:
        """The point of the learning curve that an episode belongs to."""
        point = episode.astype(jnp.float32) * (self.record / hyper.episodes)
        return jnp.minimum(point.astype(jnp.int32), self.record - 1)


def _write(
    q_table: Float[Array, "num_states num_actions"], seen: Transition, learning_rate: Float[Array, ""]
) -> Float[Array, "num_states num_actions"]:
    change = jnp.where(seen.learns, learning_rate * seen.td_error, 0.0)
    return q_table.at[seen.row, seen.action].add(change, mode="promise_in_bounds", unique_indices=True)


def _write_mean(
    q_table: Float[Array, "num_states num_actions"], seen: Transition, learning_rate: Float[Array, ""]
) -> Float[Array, "num_states num_actions"]:
    errors = jnp.where(seen.learns, seen.td_error, 0.0)
    total = jnp.zeros_like(q_table).at[seen.row, seen.action].add(errors, mode="promise_in_bounds")
    count = jnp.zeros_like(q_table).at[seen.row, seen.action].add(seen.learns, mode="promise_in_bounds")
    return q_table + learning_rate * total / jnp.maximum(count, 1.0)
