"""Figures of a learned table: its values and best actions, what it knew along the way, and the visits by state."""

from functools import partial
from pathlib import Path
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Bool, Float, Int, Key
from matplotlib.colors import PowerNorm

from humanoid_mjx.compute import compiler_options
from humanoid_mjx.evaluation.policy import StoredPolicy, find_policy
from humanoid_mjx.learners.tabular import TabularQ
from humanoid_mjx.report.figures import Figure, side_by_side
from humanoid_mjx.report.rendering import FILMS, Frame, check_file, write_frames
from humanoid_mjx.report.style import COLORS, SEQUENTIAL, figure, label_lines, log_axis, shades
from humanoid_mjx.spec import InputError
from humanoid_mjx.tasks.navigate import MOVES, Navigate, next_cells
from humanoid_mjx.training.program import run_key
from humanoid_mjx.types import IntScalar

STAGES, FRAMES, MOST_MOVES = 5, 40, 1_000_000
"""Numbers of tables drawn of a training in a figure and in a film, and the moves of the longest training that is
repeated for them."""


class Stages(NamedTuple):
    """A table after some numbers of episodes, and the moves made in each state by then."""

    episodes: Int[np.ndarray, " stages"]
    tables: Float[np.ndarray, "stages states actions"]
    visits: Int[np.ndarray, "stages states"]

    @property
    def words(self) -> list[str]:
        return [f"after {count:,} episode{'s' * (count > 1)}" for count in self.episodes.tolist()]

    @property
    def known(self) -> Float[np.ndarray, "stages states actions"]:
        """The tables, NaN in states that were never visited."""
        return np.where(self.visits[..., None] > 0, self.tables, np.nan)


def learned(trained: StoredPolicy, film: bool = False) -> tuple[str, list[Figure]]:
    """Return sentences and figures on the table of a run; of a film the frames alone.

    Raises:
      InputError: its learner has no table.
    """
    task, stages = trained.learner.task, repeated(trained, FRAMES if film else STAGES)
    words = f"The table of the best run, point {trained.point} with seed {trained.seed}; white: never visited."
    if stages is None:
        words = words.replace("white: never visited", "its training cannot be repeated here, so its end alone is shown")
        end = int(trained.learner.budget), trained.policy, np.ones(len(trained.policy), int)
        stages = Stages(*(np.asarray(x)[None] for x in end))
    if isinstance(task, Navigate):
        words += " Colour: value of the best move. Arrows: the best move. Orange: the way that these lead."
        return words, _rooms(task.map, stages)[: len(stages.words) if film else None]
    if film:
        return f"{words} Dots: the best action.", [_table(stages, at, each) for at, each in enumerate(stages.words)]
    return f"{words} Dots: the best action. The value of a state is that of its best action.", _tables(stages)


def repeated(trained: StoredPolicy, count: int = STAGES) -> Stages | None:
    """Train the table of a run again and keep what it knew after so many numbers of episodes.

    None where this does not end in the same table: the run is longer than `MOST_MOVES`, started from another, or was
    trained on another kind of device.
    """
    learner: Any = trained.learner
    if not isinstance(learner, TabularQ):
        no = f"{trained.config.learner['name']} has no table to draw"
        raise InputError(f"{trained.name}: {no}; choose a run of tabular_q, or a column such as --y return.")
    episodes = np.unique(np.rint(np.geomspace(1, int(learner.episodes), count)).astype(np.int32))
    options = compiler_options(learner.task.arithmetic, learner.program)
    train = jax.jit(jax.vmap(_train, (None, None, 0)), compiler_options=options)
    found = train(learner, run_key(jnp.uint32(trained.config.seed), jnp.uint32(trained.seed)), episodes)
    stages = Stages(episodes, *map(np.asarray, found))
    return stages if np.allclose(stages.tables[-1], trained.policy, rtol=1e-4, atol=1e-5) else None


def _train(learner: TabularQ, key: Key[Array, ""], episodes: IntScalar) -> tuple[Array, Array]:
    """The table after so many episodes, and the moves made in each state."""
    learner = learner.replace(episodes=episodes)

    def step(loop: tuple[Any, Array, IntScalar]) -> tuple[Any, Array, IntScalar]:
        carry, visits, moves = loop
        agents, moved = carry.agents, carry.agents.episode < episodes
        if agents.past is not None:  # after an episode its last moves are learned from, one at a time
            moved &= ~agents.past.waits
        return learner.train_step(carry)[0], visits.at[agents.row].add(moved), moves + learner.agents

    start = learner.init(key), jnp.zeros(learner.task.num_states, jnp.int32), jnp.int32(0)
    going_on = lambda loop: (learner.progress(loop[0]) < 1.0) & (loop[2] < MOST_MOVES)  # noqa: E731
    carry, visits, _ = jax.lax.while_loop(going_on, step, start)
    return learner.policy(carry), visits


def draw_learned(path: Path, out: Path | None) -> tuple[Path, list[str]]:
    """Draw the table of a run folder's best run, as a film where the file is one: the file, and sentences on it. Raises
    as `find_policy`, `learned` and `write_frames`."""
    if out and out.suffix in FILMS:
        check_file(out)
        words, figures = learned(find_policy(path), film=True)
        write_frames(map(partial(_frame, path.resolve().name), figures), out, fps=4.0)
        return out, [words]
    words, figures = learned(find_policy(path))
    target = out or path / "figures" / "learned.png"
    side_by_side(target, path.resolve().name, figures)
    return target, [words]


def _frame(heading: str, each: Figure) -> Frame:
    """A frame of a film."""
    with figure(None, 1, 1, (5.2, 4.0), heading) as (fig, panels):
        panels[0, 0].set_title(each.title)
        each.draw(panels[0, 0], None)
        fig.canvas.draw()
        return np.array(fig.canvas.buffer_rgba())[..., :3]


def best(table: Float[np.ndarray, "states actions"]) -> Bool[np.ndarray, "states actions"]:
    """True for the best action of a state, where no other is as good."""
    found = table == table.max(axis=1, keepdims=True)
    return found & (found.sum(axis=1, keepdims=True) == 1)


def _table(stages: Stages, stage: int, title: str) -> Figure:
    """The whole of any table."""
    known, table = stages.known[-1], stages.known[stage]
    look = {"vmin": np.nanmin(known), "vmax": np.nanmax(known), "cmap": SEQUENTIAL}

    def whole(panel: Any, _: str | None) -> None:
        panel.figure.colorbar(panel.imshow(table.T, aspect="auto", origin="lower", **look), ax=panel)
        size = float(np.clip(150 / len(table), 0.5, 5))
        panel.plot(*np.nonzero(best(table)), "o", color="white", markeredgecolor="black", markersize=size)
        panel.set_yticks(range(0, table.shape[1], 1 + table.shape[1] // 12))
        panel.set(xlabel="state", ylabel="action")
        panel.grid(False)

    return Figure(title, whole)


def _tables(stages: Stages) -> list[Figure]:
    """The whole of any table, then lines of values and visits by state."""

    def lines(rows: np.ndarray, panel: Any, _: str | None) -> None:
        for row, words, color in zip(rows, stages.words, shades(len(rows)), strict=True):
            panel.plot(row, color=color, label=words, marker="o", markersize=2, linewidth=1)
        panel.set_xlabel("state")
        label_lines(panel)
        if rows is visits:
            log_axis(panel, counted=True, upright=True)

    visits = np.where(stages.visits > 0, stages.visits, np.nan)
    by_state = {"value of each state": stages.known.max(axis=2), "visits: moves made in each state": visits}
    along = [Figure(title, partial(lines, rows)) for title, rows in by_state.items()]
    return [_table(stages, -1, "the table at the end"), *(along if len(stages.episodes) > 1 else [])]


def _rooms(grid: tuple[str, ...], stages: Stages) -> list[Figure]:
    """Values and best moves on a map along the way and at the end, then the visits."""
    text, shape = "".join(grid), (len(grid), len(grid[0]))
    walls, goal, start = (np.array([cell == mark for cell in text]) for mark in "#GS")
    known = np.where((walls | goal)[:, None], np.nan, stages.known)
    least, most = (bound(known[-1].max(axis=1)) for bound in (np.nanmin, np.nanmax))

    def room(panel: Any, values: np.ndarray, **look: Any) -> None:
        panel.imshow(np.where(walls, 0.35, np.nan).reshape(shape), cmap="gray", vmin=0, vmax=1)
        panel.figure.colorbar(panel.imshow(values.reshape(shape), cmap=SEQUENTIAL, **look), ax=panel)
        for letter in "SG":
            row, column = divmod(text.index(letter), shape[1])
            panel.text(column, row, letter, ha="center", va="center", fontweight="bold", color=COLORS[1])
        panel.set(xticks=[], yticks=[])
        panel.grid(False)

    def policy(stage: int, panel: Any, _: str | None) -> None:
        table = known[stage]
        rows, columns = np.divmod(greedy_way(grid, stages.tables[stage]), shape[1])
        panel.plot(columns, rows, color=COLORS[1], linewidth=2)
        cells, moves = np.nonzero(best(table) & ~start[:, None])
        (rows, columns), (down, right) = np.divmod(cells, shape[1]), np.array(MOVES)[moves].T
        size = {"units": "xy", "scale": 1.6, "width": 0.08, "headwidth": 5, "headlength": 4, "headaxislength": 4}
        look = {"color": "white", "edgecolor": "black", "linewidth": 0.4, "zorder": 3}
        panel.quiver(columns, rows, right, down, angles="xy", scale_units="xy", pivot="mid", **size, **look)
        room(panel, table.max(axis=1), vmin=least, vmax=most)

    def visits(panel: Any, _: str | None) -> None:
        room(panel, np.where(stages.visits[-1] > 0, stages.visits[-1], np.nan), norm=PowerNorm(0.5))

    along = [Figure(words, partial(policy, stage)) for stage, words in enumerate(stages.words)]
    return [*along, *[Figure("visits: moves made in each cell", visits)] * (len(along) > 1)]


def greedy_way(grid: tuple[str, ...], table: Float[np.ndarray, "cells moves"]) -> list[int]:
    """The cells from S on through which the first of the best moves lead, to G or up to the first that comes again."""
    text, cells, way = "".join(grid), next_cells(grid).reshape(table.shape), []
    cell = text.index("S")
    while cell not in way:
        way.append(cell)
        cell = cell if text[cell] == "G" else int(cells[cell, table[cell].argmax()])
    return way
