"""Find the shortest path on a grid among static obstacles (thesis section 6.2)."""

from typing import ClassVar

import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Int, Key
from pydantic import Field, model_validator

from humanoid_mjx.compute import Arithmetic
from humanoid_mjx.spec import traced
from humanoid_mjx.tasks.finite import FiniteTask
from humanoid_mjx.types import BoolScalar, FloatScalar, IntScalar

ROOM = (
    "S....#....",
    ".###.#.##.",
    ".#...#..#.",
    ".#.###..#.",
    ".#......#.",
    ".####.###.",
    "......#...",
    ".####.#.#.",
    ".#....#.#.",
    "...##....G",
)

MOVES = ((-1, 0), (0, 1), (1, 0), (0, -1))
"""Actions as (row, column) steps: up, right, down, left."""


class Navigate(FiniteTask):
    """A robot on a grid moves up, right, down or left; a move into an obstacle or the edge leaves it where it is.

    The map is a list of equally long strings: `S` start, `G` goal, `#` obstacle, `.` free. Reaching the goal ends the
    episode and earns `bonus`; every step earns `step_reward`. Chapter 6 argues against negative reward, so that is 0,
    and the discount alone makes short paths the best. With probability `1 - success_rate` a random action takes the
    place of the chosen one.
    """

    arithmetic: ClassVar[Arithmetic] = "scalars"
    num_actions: ClassVar[int] = len(MOVES)

    map: tuple[str, ...] = Field(ROOM, strict=False, description="rows of S start, G goal, # obstacle and . free")
    bonus: float = traced(100.0, description="reward for reaching the goal")
    step_reward: float = traced(0.0, description="reward of every step")
    success_rate: float = traced(1.0, ge=0, le=1, description="probability that the chosen action is carried out")

    @model_validator(mode="after")
    def _map_must_be_walkable(self) -> "Navigate":
        if not self.map or len({len(line) for line in self.map}) != 1 or not self.map[0]:
            raise ValueError("map must be a list of equally long, non-empty strings")
        text = "".join(self.map)
        if odd := set(text) - set("SG#."):
            raise ValueError(f"map may hold S, G, # and . only, got {''.join(sorted(odd))!r}")
        if text.count("S") != 1 or text.count("G") != 1:
            raise ValueError("map must hold exactly one S and one G")
        if shortest_path(self.map) is None:
            raise ValueError("map has no way from S to G")
        return self

    @property
    def num_states(self) -> int:
        return len(self.map) * len(self.map[0])

    def reset(self, key: Key[Array, ""]) -> IntScalar:
        return jnp.int32("".join(self.map).index("S"))

    def step(
        self, state: IntScalar, action: IntScalar, key: Key[Array, ""]
    ) -> tuple[IntScalar, FloatScalar, BoolScalar]:
        state = jnp.asarray(next_cells(self.map)).at[state * len(MOVES) + action].get(mode="promise_in_bounds")
        reached = state == "".join(self.map).index("G")
        return state, self.step_reward + jnp.where(reached, self.bonus, 0.0), reached

    @property
    def execution_rate(self) -> FloatScalar:
        return self.success_rate


def next_cells(grid: tuple[str, ...]) -> Int[np.ndarray, " cells_times_actions"]:
    free = np.array([list(line) for line in grid]) != "#"
    (height, width), cells = free.shape, np.arange(free.size, dtype=np.int32).reshape(free.shape)
    around = np.pad(np.where(free, cells, -1), 1, constant_values=-1)  # -1: an obstacle, or beyond the edge
    moved = [around[1 + down :, 1 + right :][:height, :width] for down, right in MOVES]
    return np.stack([np.where(place < 0, cells, place) for place in moved], axis=-1).reshape(-1)


def shortest_path(grid: tuple[str, ...]) -> int | None:
    """The number of moves from S to G by breadth-first search; None where there is no way."""
    cells = next_cells(grid).reshape(-1, len(MOVES))
    start, goal = "".join(grid).index("S"), "".join(grid).index("G")
    reached, edge, moves = {start}, {start}, 0
    while edge:
        if goal in edge:
            return moves
        edge, moves = set(cells[list(edge)].ravel().tolist()) - reached, moves + 1
        reached |= edge
    return None
