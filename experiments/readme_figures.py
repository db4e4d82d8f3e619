"""Make the README's figures again, by the commands that it names.

    python experiments/readme_figures.py                      # all of them
    python experiments/readme_figures.py robots               # one of them, in seconds
    python experiments/readme_figures.py leg_reach_learners --seeds 1 --out /tmp/figures

On two CPU cores `joint1_learning_curves` takes a quarter of a minute, `walk` one, `leg_reach_sweep_curves` and
`leg_reach_learners` minutes for every seed.
"""

import argparse
import shutil
import subprocess
import sys
import tempfile
from pathlib import Path

WALK_S, FRAME_S = (10.4, 18.0), 0.04
"""The part of the shipped policy's first episode that is shown, s, and the time between frames of a film, s."""

LEARNERS = ("leg_reach", "leg_reach_linear", "leg_reach_ppo")
"""The configs whose learning curves are drawn side by side."""


def robots(target: Path, seeds: int) -> None:
    """Both robots at zero, with the axes of their joints."""
    from humanoid_mjx.report.robots import draw_robots

    draw_robots(target)


def joint1_learning_curves(target: Path, seeds: int) -> None:
    """The learning curves of the README's first command."""
    with tempfile.TemporaryDirectory() as folder:
        run = Path(folder) / "joint1"
        command("sweep", "joint1", "--out", run)
        shutil.copy(run / "figures" / "learning_curves.png", target)


def leg_reach_sweep_curves(target: Path, seeds: int) -> None:
    """The learning curves of tile coding by epsilon, its decay and the learning rate."""
    with tempfile.TemporaryDirectory() as folder:
        run = Path(folder) / "leg_reach_sweep"
        command("sweep", "leg_reach_sweep", "--out", run, "--set", f"seeds={seeds}")
        shutil.copy(run / "figures" / "learning_curves.png", target)


def leg_reach_learners(target: Path, seeds: int) -> None:
    """All learners on `leg_reach`, in samples and in wall time."""
    with tempfile.TemporaryDirectory() as folder:
        runs = [Path(folder) / name for name in LEARNERS]
        for run in runs:
            command("sweep", run.name, "--out", run, "--set", f"seeds={seeds}")
        command("evaluate", *runs, "--out", target)


def walk(target: Path, seeds: int) -> None:
    """The shipped policy under one command, every other frame, small enough for a page."""
    from PIL import Image

    with tempfile.TemporaryDirectory() as folder:
        film = Path(folder) / "walk.gif"
        command("play", "walk", "--out", film)
        frames = []
        with Image.open(film) as whole:
            first, last = (round(second / FRAME_S) for second in WALK_S)
            for number in range(first, last, 2):
                whole.seek(number)
                frames.append(whole.convert("RGB").resize((360, 270), Image.Resampling.LANCZOS))
    # The colour of the far leg covers little, and would be left out of a palette by frequency.
    palette = frames[0].quantize(96, method=Image.Quantize.MAXCOVERAGE)
    begin, *others = (frame.quantize(palette=palette, dither=Image.Dither.NONE) for frame in frames)
    begin.save(target, save_all=True, append_images=others, duration=2000 * FRAME_S, loop=0)


def command(*arguments: object) -> None:
    """Run `humanoid-mjx` in a process of its own, so that each starts from nothing, as a reader's does."""
    subprocess.run([sys.executable, "-m", "humanoid_mjx", *map(str, arguments)], check=True)


FIGURES = {
    make.__name__: make for make in (robots, walk, joint1_learning_curves, leg_reach_sweep_curves, leg_reach_learners)
}


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("figures", nargs="*", metavar="FIGURE", help=f"{', '.join(FIGURES)}; by default all")
    parser.add_argument("--seeds", type=int, default=5, help="of every point of a leg_reach figure")
    parser.add_argument("--out", type=Path, default=Path(__file__).parent.parent / "docs", help="the folder")
    chosen = parser.parse_args()
    if odd := [name for name in chosen.figures if name not in FIGURES]:
        parser.error(f"there is no figure {odd[0]}; there are {', '.join(FIGURES)}")
    chosen.out.mkdir(parents=True, exist_ok=True)
    for name in chosen.figures or FIGURES:
        target = chosen.out / f"{name}.{'gif' if name == 'walk' else 'png'}"
        FIGURES[name](target, chosen.seeds)
        print(target)


if __name__ == "__main__":
    main()
