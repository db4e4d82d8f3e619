"""The methods of `tabular_q` once more: loops over episodes as in the book's boxes, one seed, plain Python.

R. Sutton and A. Barto, "Reinforcement Learning" (2018), sections 2.7, 6.4 to 6.7, 7.2 and 12.10. Nothing is taken from
the package. `experiments/methods.py` and the tests compare the tables.
"""

from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

import numpy as np

F = np.float32
Numbers = Callable[[int], tuple[F, F, F, F]]
"""From the number of a decision to four uniform numbers: for exploring, for the random action, for the preferred
action, and for the two tables of Double Q-learning."""


@dataclass
class Settings:
    """The keys of `tabular_q`."""

    method: str = "q_learning"
    exploration: str = "epsilon_greedy"
    step_size: str = "constant"
    decay: str = "episode"
    epsilon: float = 0.6
    temperature: float = 1.0
    confidence: float = 1.0
    epsilon_decay: float = 1.0
    epsilon_min: float = 0.0
    learning_rate: float = 0.5
    discount: float = 0.9
    steps: int = 4
    trace_decay: float = 0.9
    initial_value: float = 0.0


class Textbook:
    """An agent in a decision process of tables: `following[s, a]`, `reward[s, a]`, `terminal[s]`; state 0 begins."""

    def __init__(self, process: Any, settings: Settings, numbers: Numbers, obeyed: float = 1.0, most: int = 50):
        self.following, self.reward, self.terminal = process
        self.p, self.numbers, self.obeyed, self.most = settings, numbers, F(obeyed), most
        shape = self.following.shape
        self.tables = [np.full(shape, settings.initial_value, F) for _ in range(1 + (settings.method == "double_q"))]
        self.visits = [np.zeros(shape, F) for _ in self.tables]
        self.traces = np.zeros(shape, F)
        own = {"boltzmann": settings.temperature, "ucb": settings.confidence}
        self.amount = F(own.get(settings.exploration, settings.epsilon))
        self.decision, self.episode = 0, 0

    def q(self, state: int) -> np.ndarray:
        one, *two = (table[state] for table in self.tables)
        return F(0.5) * (one + two[0]) if two else one.copy()

    def present(self, state: int) -> F:
        """Epsilon, temperature or confidence."""
        amount = self.amount
        if self.p.decay == "visit":
            amount = amount * F(self.p.epsilon_decay) ** F(sum(float(visits[state].sum()) for visits in self.visits))
        return max(F(self.p.epsilon_min), amount)

    def preferred(self, state: int) -> np.ndarray:
        """The probabilities of the actions where none is forced at random."""
        q = self.q(state)
        if self.p.exploration == "boltzmann":
            odds = F(np.e) ** ((q - q.max()) / max(self.present(state), F(1e-38)))
            return odds / odds.sum()
        if self.p.exploration == "ucb":
            n = np.sum([visits[state] for visits in self.visits], axis=0, dtype=F)
            bonus = self.present(state) * np.sqrt(np.log(max(n.sum(), F(1))) / np.maximum(n, F(1)))
            q = np.where(n > 0, q + bonus, F(np.inf))
        return (q == q.max()) / F((q == q.max()).sum())

    def forced(self, state: int) -> F:
        """The probability of an action at random."""
        epsilon = self.present(state) if self.p.exploration == "epsilon_greedy" else F(0)
        return F(1) - (F(1) - epsilon) * self.obeyed

    def choose(self, state: int) -> int:
        explore, random, preferred, _ = self.numbers(self.decision)
        if explore >= F(1) - self.forced(state):
            return int(random * F(len(self.q(state))))
        chances = np.cumsum(self.preferred(state), dtype=F)
        return int(np.argmax(chances > preferred * chances[-1]))

    def learn(self, state: int, action: int, target: Any, table: int = 0) -> None:
        self.visits[table][state, action] += 1
        rate = F(1) / self.visits[table][state, action] if self.p.step_size == "visits" else F(self.p.learning_rate)
        self.tables[table][state, action] += rate * (target - self.tables[table][state, action])

    def values(self) -> np.ndarray:
        return np.stack(self.tables).mean(axis=0, dtype=F)

    def play(self, decisions: int) -> None:
        """Play episodes until so many decisions have taught."""
        p, gamma = self.p, F(self.p.discount)
        while True:
            state, length, pending = 0, 0, []
            action = self.choose(state)
            while True:
                coin = self.numbers(self.decision)[3]
                greedy = self.q(state)[action] == self.q(state).max()
                following, reward = int(self.following[state, action]), F(self.reward[state, action])
                ends = bool(self.terminal[following])
                length += 1
                over = ends or length >= self.most
                if p.decay == "step":
                    self.amount = self.amount * F(p.epsilon_decay)
                self.decision += 1
                next_action = None
                if p.method in ("sarsa", "n_step"):
                    next_action = self.choose(following)
                if p.method == "n_step":
                    pending.append((state, action, reward))
                    while pending and (over or len(pending) == p.steps) and self.decision <= decisions:
                        target = F(0) if ends else self.q(following)[next_action]
                        for _, _, later in reversed(pending):
                            target = later + gamma * target
                        first = pending.pop(0)
                        self.learn(first[0], first[1], target)
                        if over and pending:
                            self.decision += 1
                            next_action = self.choose(following)
                elif p.method == "q_lambda":
                    error = reward + gamma * (F(0) if ends else self.q(following).max()) - self.q(state)[action]
                    self.traces *= gamma * F(p.trace_decay) if greedy and length > 1 else F(0)
                    self.traces[state, action] = 1
                    self.visits[0][state, action] += 1
                    rate = 1 / np.maximum(self.visits[0], 1) if p.step_size == "visits" else F(p.learning_rate)
                    self.tables[0] += rate * error * self.traces
                elif p.method == "double_q":
                    mine = int(coin >= F(0.5))
                    best = np.flatnonzero(self.tables[mine][following] == self.tables[mine][following].max())
                    value = self.tables[1 - mine][following, best[int((2 * coin - mine) * len(best))]]
                    self.learn(state, action, reward + gamma * (F(0) if ends else value), mine)
                else:
                    q = self.q(following)
                    value = q.max()
                    if p.method == "sarsa":
                        value = q[next_action]
                    if p.method == "expected_sarsa":
                        forced = self.forced(following)
                        value = (1 - forced) * (self.preferred(following) * q).sum() + forced * q.mean()
                    self.learn(state, action, reward + gamma * (F(0) if ends else value))
                if over or self.decision >= decisions:
                    break
                state, action = following, self.choose(following) if next_action is None else next_action
            if over and not pending:
                self.episode += 1
                self.amount *= F(p.epsilon_decay) if p.decay == "episode" else F(1)
            if self.decision >= decisions:
                return


def mountain_car(step_size: float, episodes: int, agents: int, seed: int = 0, sarsa: bool = True) -> np.ndarray:
    """Steps of each episode, (agents, episodes), of episodic semi-gradient Sarsa without exploration (section 10.1) on
    the mountain car (Example 10.1): 8 tilings of 8 x 8 tiles, shifted by (1, 3) eighths of a tile; `step_size` is the
    share of its error that a value moves by, 8 alpha. The agents learn side by side. Without exploration the targets of
    Sarsa and of Q-learning are the same; Q-learning (`sarsa` False) chooses the next action after the update."""
    draw, every, tilings = np.random.default_rng(seed), np.arange(agents)[:, None], np.arange(8)
    weights, lengths = np.zeros((agents, 8, 9, 9, 3)), np.zeros((agents, episodes), int)

    def tiles(place: np.ndarray, speed: np.ndarray) -> tuple[np.ndarray, ...]:
        cells = 8 * (place + 1.2) / 1.7, 8 * (speed + 0.07) / 0.14
        at = (cell[:, None] + tilings * step % 8 / 8 for cell, step in zip(cells, (1, 3), strict=True))
        return every, tilings, *(np.minimum(x, 8).astype(int) for x in at)

    def greedy(q: np.ndarray) -> np.ndarray:
        return np.where(q == q.max(axis=1, keepdims=True), draw.random(q.shape), -1).argmax(axis=1)

    def start() -> np.ndarray:
        return draw.uniform(-0.6, -0.4, agents)

    place, speed, episode, length = start(), np.zeros(agents), np.zeros(agents, int), np.zeros(agents, int)
    features = tiles(place, speed)
    action = greedy(weights[features].sum(axis=1))
    while (learns := episode < episodes).any():
        speed = np.clip(speed + 0.001 * (action - 1) - 0.0025 * np.cos(3 * place), -0.07, 0.07)
        place = np.clip(place + speed, -1.2, 0.5)
        speed, over = np.where(place == -1.2, 0.0, speed), place >= 0.5
        length += 1
        following = tiles(place, speed)
        q = weights[following].sum(axis=1)
        chosen = greedy(q)
        target = -1.0 + np.where(over, 0.0, q[every[:, 0], chosen])
        error = target - weights[(*features, action[:, None])].sum(axis=1)
        weights[(*features, action[:, None])] += (learns * step_size / 8 * error)[:, None]
        if not sarsa:
            chosen = greedy(weights[following].sum(axis=1))
        ends = over & learns
        lengths[ends, episode[ends]] = length[ends]
        episode, length = episode + ends, np.where(over, 0, length)
        place, speed = np.where(over, start(), place), np.where(over, 0.0, speed)
        features = tiles(place, speed)
        action = np.where(over, greedy(weights[features].sum(axis=1)), chosen)
    return lengths
