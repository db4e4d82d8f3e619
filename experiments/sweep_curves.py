"""Draw the learning curves of several sweeps over the same axes, a row for each record.

python experiments/sweep_curves.py docs/sweep_curves.png cpu_2_cores_leg_reach_sweep h200_leg_reach_deep_sweep ...
python experiments/sweep_curves.py --one-task docs/learner_curves.png cpu_2_cores_posture_switch_{table,linear,deep}
"""

import argparse
import json
from pathlib import Path
from typing import Any

import numpy as np

from humanoid_mjx.report.drawing import COUNTED, CURVES, draw_line, over_seeds
from humanoid_mjx.report.style import count_axis, figure, label_lines, log_axis, shades, wrapped
from humanoid_mjx.runs.ranking import find_levels

BENCH = Path(__file__).parent.parent / "docs" / "bench"


def main() -> None:
    """Read the records and write the figure."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("target", type=Path)
    parser.add_argument("records", nargs="+", help="names in docs/bench")
    parser.add_argument("--one-task", action="store_true", help="rows share their axes; steps on a logarithmic scale")
    given = parser.parse_args()
    rows = [json.loads((BENCH / f"{name}.json").read_text()) for name in given.records]
    axes = list(rows[0]["config"]["sweep"]["axes"])
    shared: Any = {"sharex": True, "sharey": True} if given.one_task else {"sharey": "row"}
    with figure(given.target, len(rows), len(axes), **shared) as (fig, panels):
        others = ", mean over all values of the other parameters" * (len(axes) > 1)
        words = f"Return while learning: {over_seeds(rows[0]['config']['seeds'])}{others}"
        fig.suptitle(wrapped(words, fig), x=0.01, ha="left")
        for row, record in enumerate(rows):
            found, config = columns(record), record["config"]
            for panel, axis in zip(panels[row], axes, strict=True):
                draw(panel, found, axis)
                name = f"{config['name']}, {config['learner']['name']}: {axis}"
                panel.set_title(name if axis == axes[0] else axis)
                panel.set_ylabel(CURVES["return"] if axis == axes[0] else "")
                if given.one_task:
                    log_axis(panel, counted=True)
                else:
                    count_axis(panel)


def columns(record: dict[str, Any]) -> dict[str, np.ndarray]:
    """The curves of a record as columns, a row for each point, seed and record step.

    Where a learner counts episodes, `step` is the control steps until the end of each record step.
    """
    returns = np.array(record["curves"]["return"])
    point, seed, place = (x.ravel() for x in np.indices(returns.shape))
    if "step" in record:
        step = np.broadcast_to(record["step"], returns.shape)
    else:
        step = np.cumsum(np.diff(record["episode"], prepend=0) * record["curves"]["steps"], axis=-1)
    swept = {axis: np.array([p[axis] for p in record["points"]])[point] for axis in record["config"]["sweep"]["axes"]}
    return swept | {"seed": seed, "place": place, "step": step.ravel(), "return": returns.ravel()}


def draw(panel: Any, found: dict[str, np.ndarray], axis: str) -> None:
    """A line with its band for each value of an axis, over all values of the others."""
    levels = find_levels(found[axis])
    for level, (label, color) in enumerate(zip(levels.labels, shades(len(levels.labels)), strict=True)):
        mine = levels.index == level
        step, seed, value, place = (found[name][mine] for name in ("step", "seed", "return", "place"))
        draw_line(panel, step, seed, value, color, place=place, label=label)
    label_lines(panel)
    panel.set_xlabel(COUNTED["step"])


if __name__ == "__main__":
    main()
