# pyright: reportAttributeAccessIssue=false
"""A motion with its words and its pushes: what is shown of a played episode."""

from collections.abc import Mapping
from itertools import pairwise
from typing import Any, NamedTuple

import jax
import mujoco
import numpy as np
from jaxtyping import Float

from humanoid_mjx.evaluation.episode import Played, play, robot_of, rows_of
from humanoid_mjx.evaluation.policy import StoredPolicy
from humanoid_mjx.mechanics.terrain import Terrain
from humanoid_mjx.training.progress import Reporter
from humanoid_mjx.types import AnyArray

SHORT_S = 0.25
"""Length, s, below which a push is described by its impulse, and from which by its force."""

SHOWN_S = 0.5
"""A push is shown for at least so long, s."""

DRIVEN = 0.6
"""Share of the largest command under which a robot is shown."""


class Push(NamedTuple):
    """A force on the torso."""

    start: float
    """s"""
    seconds: float
    force: Float[np.ndarray, "3"]
    """N, world."""

    @property
    def shown(self) -> float:
        """Time for which it is shown, s: most pushes last shorter than the eye takes to see them."""
        return max(self.seconds, SHOWN_S)

    @property
    def words(self) -> str:
        """Size of the push, in words."""
        size = float(np.linalg.norm(self.force))
        return f"push {size * self.seconds:.2g} N s" if self.seconds < SHORT_S else f"push {size:.2g} N"


class Film(NamedTuple):
    """A motion, its rows `step_s` apart, and what goes with it."""

    model: mujoco.MjModel
    qpos: Float[AnyArray, "rows nq"]
    step_s: float
    title: str = ""
    told: tuple[tuple[float, str], ...] = ()
    """Commands to the robot: the time from which each holds, s, and its words."""
    pushes: tuple[Push, ...] = ()
    terrain: Terrain | None = None
    """The shape of the ground, in a world whose z axis points against gravity; none: a level plane."""

    def at(self, fps: float) -> tuple[Float[np.ndarray, "frames nq"], Float[np.ndarray, " frames"]]:
        """Postures at the motion's own speed, so many a second, and their times, s; interpolated linearly between
        rows."""
        rows = np.arange(0.0, len(self.qpos) - 0.999, 1.0 / (fps * self.step_s))
        columns = np.asarray(self.qpos, np.float64).T
        places = np.arange(len(self.qpos))
        return np.stack([np.interp(rows, places, column) for column in columns], axis=1), rows * self.step_s

    def asked(self, seconds: float) -> str:
        """The command to the robot at a time, in words."""
        return next((words for start, words in reversed(self.told) if start <= seconds + 1e-9), "")


def film_of(trained: StoredPolicy, played: Played, title: str) -> Film:
    """The film of a played episode; raises as `robot_of` and `world_of`."""
    model, (qpos, step_s) = robot_of(trained), rows_of(trained, played)
    period: float = trained.learner.task.period
    words = pairwise(["", *map(in_words, played.told)])
    told = [(number * period, now) for number, (before, now) in enumerate(words) if now != before]
    film = Film(model, qpos, step_s, title, tuple(told), tuple(merged(played.pushes, period)))
    terrain = getattr(played.states[0], "terrain", None)
    return film if terrain is None else _level(film, jax.tree.map(float, terrain), trained)


def _level(film: Film, terrain: Terrain, trained: StoredPolicy) -> Film:
    """The film of a body on a terrain, turned so that the z axis points against gravity; its model has no ground but a
    plane."""
    turn, qpos = np.empty(4), np.array(film.qpos, np.float64)
    mujoco.mju_quatZ2Vec(turn, terrain.up(np) * [-1.0, -1.0, 1.0])
    for row in qpos:
        mujoco.mju_rotVecQuat(row[:3], row[:3].copy(), turn)
        mujoco.mju_mulQuat(row[3:7], turn, row[3:7].copy())
    for push in film.pushes:
        mujoco.mju_rotVecQuat(push.force, push.force.copy(), turn)
    return film._replace(qpos=qpos, terrain=terrain, model=trained.learner.task.robot.model)


def show(trained: StoredPolicy, reporter: Reporter, episode: int = 0) -> tuple[Film, str]:
    """Play a policy's held-out episode of this number; 0 is the first. Return its film, and its end in a sentence;
    raises as `film_of`."""
    robot_of(trained)
    period: float = trained.learner.task.period
    reporter.phase("compiling")
    played = play(trained, episode, lambda decisions: reporter.phase("simulating"))
    which = f", episode {episode}" * (episode > 0)
    film = film_of(trained, played, f"{trained.title}, point {trained.point}, seed {trained.seed}{which}")
    decisions = len(played.actions)
    outcome = "succeeds" if played.success else "does not succeed"
    return film, (
        f"point {trained.point}, seed {trained.seed}: {outcome} in {decisions} decisions, {decisions * period:g} s; "
        f"return {played.episode_return:.4g}"
    )


def driven_films(trained: StoredPolicy, seconds: float) -> list[Film]:
    """Films of a policy under a constant command: for each part of the command one film at `DRIVEN` of each end of its
    range that is not 0."""
    task: Any = trained.learner.task
    driven = trained._replace(learner=trained.learner.replace(task=task.for_driving()))
    films = []
    for name, ends in task.told_ranges.items():
        for end in sorted({end for end in ends if end}, reverse=True):
            told = dict.fromkeys(task.told_ranges, 0.0) | {name: DRIVEN * end}
            played = play(driven, told=told, most=round(seconds / task.period))
            films.append(film_of(driven, played, in_words({name: DRIVEN * end})))
    return films


def in_words(values: Mapping[str, float]) -> str:
    """Format a command: `{"forward, m/s": 0.3}` becomes `forward 0.30 m/s`. Negative values to the left are shown as
    positive ones to the right; semicolons separate several parts."""
    parts = []
    for key, value in values.items():
        name, _, unit = key.partition(", ")
        if "left" in name.split() and value < 0:
            name, value = name.replace("left", "right"), -value
        parts.append(f"{name} {value:.2f} {unit}".rstrip())
    return "; ".join(parts)


def merged(forces: Float[np.ndarray, "decisions 3"], period: float) -> list[Push]:
    """Pushes from the force during each decision; one that stays the same is one push."""
    pushes: list[Push] = []
    for number, force in enumerate(forces):
        if not force.any():
            continue
        last, start = (pushes[-1] if pushes else None), number * period
        if last and np.isclose(last.start + last.seconds, start) and np.allclose(last.force, force):
            pushes[-1] = last._replace(seconds=last.seconds + period)
        else:
            pushes.append(Push(start, period, force))
    return pushes
