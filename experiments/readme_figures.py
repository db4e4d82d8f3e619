"""Make the figures of README and docs again, by the commands that they name.

    python experiments/readme_figures.py                      # all of them
    python experiments/readme_figures.py robots               # one of them, in seconds
    python experiments/readme_figures.py leg_reach_learners --seeds 1 --out /tmp/figures

On two CPU cores `joint1_learning_curves` takes a quarter of a minute, `leg_reach_learners`
minutes for every seed. The film is made by `walk_film.py`.
"""

import argparse
import shutil
import subprocess
import sys
import tempfile
from pathlib import Path

from robot_pictures import draw_robots

LEARNERS = ("leg_reach", "leg_reach_linear", "leg_reach_ppo")
"""The configs whose learning curves are drawn side by side."""


def robots(target: Path, seeds: int) -> None:
    """Both robots at zero, with the axes of their joints."""
    draw_robots(target)


def joint1_learning_curves(target: Path, seeds: int) -> None:
    """The learning curves of the README's first command."""
    with tempfile.TemporaryDirectory() as folder:
        run = Path(folder) / "joint1"
        command("sweep", "joint1", "--out", run)
        shutil.copy(run / "figures" / "learning_curves.png", target)


def leg_reach_learners(target: Path, seeds: int) -> None:
    """All learners on `leg_reach`, in samples and in wall time."""
    with tempfile.TemporaryDirectory() as folder:
        runs = [Path(folder) / name for name in LEARNERS]
        for run in runs:
            command("sweep", run.name, "--out", run, "--set", f"seeds={seeds}")
        command("evaluate", *runs, "--out", target)


def command(*arguments: object) -> None:
    """Run `humanoid-mjx` in a process of its own, so that each starts from nothing, as a reader's does."""
    subprocess.run([sys.executable, "-m", "humanoid_mjx", *map(str, arguments)], check=True)


FIGURES = {make.__name__: make for make in (robots, joint1_learning_curves, leg_reach_learners)}


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
        target = chosen.out / f"{name}.png"
        FIGURES[name](target, chosen.seeds)
        print(target)


if __name__ == "__main__":
    main()
