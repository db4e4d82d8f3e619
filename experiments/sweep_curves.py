"""Draw the learning curves of several sweeps over the same three axes, a row for each run folder.

python experiments/sweep_curves.py docs/sweep_curves.png runs/*_sweep
"""

import sys
from pathlib import Path

import humanoid_mjx
from humanoid_mjx.report.figures import averaged, draw_curves
from humanoid_mjx.report.style import figure, wrapped

AXES = ("learner.epsilon", "learner.epsilon_decay", "learner.learning_rate")


def main() -> None:
    """Read the run folders and write the figure."""
    target, runs = Path(sys.argv[1]), [Path(name) for name in sys.argv[2:]]
    results = [humanoid_mjx.load_run(run).results for run in runs]
    with figure(target, len(runs), len(AXES), sharey="row") as (fig, panels):
        fig.suptitle(wrapped(f"Return while learning: {averaged(AXES, results[0])}", fig), x=0.01, ha="left")
        for row, (run, found) in enumerate(zip(runs, results, strict=True)):
            for panel, axis in zip(panels[row], AXES, strict=True):
                draw_curves(panel, found, axis, "return")
                panel.set_title(f"{run.name}: {axis}" if axis == AXES[0] else axis)


if __name__ == "__main__":
    main()
