"""Film the shipped policy of `walk` under one command after another.

    python experiments/walk_film.py            # writes docs/walk_commands.webm and docs/walk.gif, in three minutes

The first is all of it; the second the part that the README shows, every other frame, small enough for a page.
"""

import argparse
from itertools import islice
from pathlib import Path
from typing import Any, NamedTuple

import jax.numpy as jnp
import numpy as np
from PIL import Image, ImageSequence

from humanoid_mjx import compute
from humanoid_mjx.evaluation.episode import begun, decided, robot_of, single
from humanoid_mjx.evaluation.film import Film
from humanoid_mjx.evaluation.gait.scenarios import TURN_GAIN, TURN_RATE, settings_of
from humanoid_mjx.evaluation.gait.tally import heading_of, wrapped
from humanoid_mjx.evaluation.policy import find_policy, in_world
from humanoid_mjx.mechanics.rotations import rotation_matrix
from humanoid_mjx.report.rendering import render_film

FRAME_S, SMALL = 0.04, (360, 270)
"""Time between frames of the film, s, and size of the README's, pixels."""


class Scene(NamedTuple):
    """A part of the film."""

    words: str
    seconds: float
    command: tuple[float, float, float]
    """Velocity forward and to the left, m/s, and turn rate to the left, rad/s."""
    turn_by: float = 0.0
    """Degrees to turn to the left, at once at the beginning."""


SCENES = (
    Scene("stand", 2.0, (0.0, 0.0, 0.0)),
    *(Scene(f"forward {speed} m/s", 3.0, (speed, 0.0, 0.0)) for speed in (0.15, 0.3, 0.5, 0.8)),
    *(Scene(f"turn {rate:+.0f} rad/s", 3.0, (0.0, 0.0, rate)) for rate in (1.0, -1.0)),
    *(Scene(f"sideways {speed:+} m/s", 2.0, (0.0, speed, 0.0)) for speed in (0.15, -0.15)),
    Scene("forward 0.3 m/s", 2.0, (0.3, 0.0, 0.0)),
    Scene("45 degrees left, at once", 2.5, (0.3, 0.0, 0.0), 45.0),
    Scene("45 degrees right, at once", 2.5, (0.3, 0.0, 0.0), -45.0),
    Scene("stand", 2.0, (0.0, 0.0, 0.0)),
)

README = slice(9, 13)
"""The scenes that the README shows."""


def filmed(name: str) -> Film:
    """The policy of this name through all scenes."""
    trained = in_world(find_policy(name), None, settings_of([]))
    task = trained.learner.task.for_driving()
    learner, episode = trained.learner.replace(task=task), jnp.int32(0)
    state = single(begun)(learner, episode)
    rows, told = [np.asarray(state.data.world.qpos)], []
    for scene in SCENES:
        told.append(((len(rows) - 1) * task.period, scene.words))
        goal = heading(rows[-1]) + np.radians(scene.turn_by)
        for _ in range(round(scene.seconds / task.period)):
            command = np.array(scene.command, np.float32)
            if scene.turn_by:
                rate = TURN_GAIN * wrapped(goal - heading(rows[-1]))
                command[2] = np.clip(rate, -TURN_RATE, TURN_RATE)
            asked = dict(zip(task.told_ranges, command, strict=True))
            state = single(decided)(learner, trained.policy, episode, state, jnp.int32(len(rows) - 1), asked)[0]
            rows.append(np.asarray(state.data.world.qpos))
        if state.terminated:
            raise SystemExit(f"{name} falls when told: {scene.words}")
    return Film(robot_of(trained), np.stack(rows), task.period, "Q-learning walks as told", tuple(told))


def heading(qpos: np.ndarray) -> Any:
    """Direction of the torso, rad."""
    return heading_of(rotation_matrix(jnp.asarray(qpos[3:7])))


def small(film: Film, target: Path) -> None:
    """The README's scenes as an animation of few colours."""
    first, last = (round(sum(scene.seconds for scene in SCENES[:n]) / film.step_s) for n in (README.start, README.stop))
    times = np.array([start for start, _ in film.told[README]]) - first * film.step_s
    told = tuple(zip(times.tolist(), [words for _, words in film.told[README]], strict=True))
    part = film._replace(qpos=film.qpos[first:last], told=told)
    render_film(part, target)
    with Image.open(target) as whole:
        shown = islice(ImageSequence.Iterator(whole), 0, None, 2)
        frames = [frame.convert("RGB").resize(SMALL, Image.Resampling.LANCZOS) for frame in shown]
    # The colour of the far leg covers little, and would be left out of a palette by frequency.
    palette = frames[0].quantize(96, method=Image.Quantize.MAXCOVERAGE)
    begin, *others = (frame.quantize(palette=palette, dither=Image.Dither.NONE) for frame in frames)
    begin.save(target, save_all=True, append_images=others, duration=2000 * FRAME_S, loop=0)


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--policy", default="walk", help="a policy by name, or a run folder")
    parser.add_argument("--out", type=Path, default=Path(__file__).parent.parent / "docs", help="the folder")
    chosen = parser.parse_args()
    compute.start()
    film = filmed(chosen.policy)
    print(render_film(film, chosen.out / "walk_commands.webm"))
    small(film, chosen.out / "walk.gif")
    print(chosen.out / "walk.gif")


if __name__ == "__main__":
    main()
