"""Finite decision processes given by tables, and two slow, obvious ways to solve them."""

from typing import Any

import jax.numpy as jnp
import numpy as np

from humanoid_mjx.compute import rng
from humanoid_mjx.spec import traced
from humanoid_mjx.tasks.finite import FiniteTask


class TableTask(FiniteTask):
    """A decision process whose transitions stand in tables; the tables are traced, their sizes are not."""

    next_state: Any = traced()
    reward: Any = traced()
    terminal: Any = traced()
    rows: Any = traced()
    num_rows: int
    actions: int
    printed: bool = False
    success_rate: float = traced(1.0)
    max_episode_steps: int = traced(50)

    @property
    def num_states(self):
        return self.num_rows

    @property
    def num_actions(self):
        return self.actions

    @property
    def as_printed(self):
        return self.printed

    def reset(self, key):
        return jnp.int32(0)

    def step(self, state, action, key):
        following = self.next_state[state, action]
        return following, self.reward[state, action], self.terminal[following]

    def state_index(self, state):
        return self.rows[state]

    @property
    def execution_rate(self):
        return self.success_rate


def random_task(seed, states, actions, rows, **kwargs):
    """Rewards are multiples of 1/4, so that ties occur and sums are exact. State 0 starts, the last is terminal."""
    draw = np.random.default_rng(seed)
    return TableTask(
        next_state=jnp.asarray(draw.integers(states, size=(states, actions)), jnp.int32),
        reward=jnp.asarray(draw.integers(-4, 5, size=(states, actions)) / 4, jnp.float32),
        terminal=jnp.arange(states) == states - 1,
        rows=jnp.asarray(draw.permutation(np.arange(states) % rows), jnp.int32),
        num_rows=rows,
        actions=actions,
        **kwargs,
    )


def q_learning(learner, q_table, draws):
    """Tabular Q-learning in plain Python. `draws[t]` are the three random numbers of step t; draws[0] of the first.

    Yields, after each step: (row, action) learned about, the table, epsilon and the number of finished episodes.
    """
    f = np.float32
    q = np.array(q_table, f)
    task = learner.task

    def choose(t, row, epsilon, episode):
        explore, choice, tie = draws[t]
        epsilon = max(f(learner.epsilon_min), epsilon)
        if task.printed and episode == learner.episodes - 1:
            epsilon = f(0)
        if explore < (f(1) - epsilon) * f(task.success_rate):
            best = [a for a in range(task.num_actions) if q[row, a] == q[row].max()]
            return best[0] if task.printed else best[int(f(tie) * f(len(best)))]
        return int(f(choice) * f(task.num_actions))

    state, epsilon, episode, length = 0, f(learner.epsilon), 0, 0
    action = choose(0, int(task.rows[state]), epsilon, episode)
    for t in range(1, len(draws)):
        row = int(task.rows[state])
        following = int(task.next_state[state, action])
        reward = f(task.reward[state, action])
        ended = bool(task.terminal[following])
        training = episode < learner.episodes
        value = q[int(task.rows[following])].max()
        if ended and not task.printed:
            value = f(0)
        target = reward + f(learner.discount) * value
        if training and (ended or not task.printed):
            q[row, action] += f(learner.learning_rate) * (target - q[row, action])
        learned = row, action
        length += 1
        over = ended or length >= task.max_episode_steps
        if task.printed:
            if training:
                episode, epsilon, length = episode + 1, epsilon * f(learner.epsilon_decay), 0
            if ended:
                episode = learner.episodes
        elif training and over:
            episode, epsilon, length = episode + 1, epsilon * f(learner.epsilon_decay), 0
        state = 0 if over else following
        action = choose(t, int(task.rows[state]), epsilon, episode)
        yield learned, q.copy(), epsilon, episode


def value_iteration(task, discount, sweeps=5000):
    """The optimal Q of a finite task whose states are 0 ... num_states - 1 and whose step draws nothing."""
    states, actions = task.num_states, task.num_actions
    following, reward, terminal = (np.zeros((states, actions), kind) for kind in (int, float, float))
    key = rng.key(0)
    for s, a in np.ndindex(states, actions):
        following[s, a], reward[s, a], terminal[s, a] = task.step(jnp.int32(s), jnp.int32(a), key)
    q = np.zeros((states, actions))
    for _ in range(sweeps):
        q, old = reward + discount * (1 - terminal) * q.max(axis=1)[following], q
        if np.abs(q - old).max() < 1e-10:
            break
    return q
