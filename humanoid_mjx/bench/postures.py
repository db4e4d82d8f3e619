"""Episodes a second of the whole of training: tables on `posture_switch`, by the values of the config of that name.

Every call is a sweep into a folder of its own, from the first episode to the tables on disk. An episode is short once a
table is good, so that the steps a second, one for each decision of the learner, stand beside it; each is 40 control
steps of two legs. Fewer runs and episodes than the config's are trained where a physics is slow.

    chain posture_switch     the config's physics
    mjx-jax posture_switch   MJX in its place
"""

from collections.abc import Callable, Mapping
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import NamedTuple

import jax
import numpy as np

from humanoid_mjx.bench.measure import Record, Subject, record, time_in_turn
from humanoid_mjx.bench.running import with_room
from humanoid_mjx.config import load
from humanoid_mjx.training.plan import make_plan
from humanoid_mjx.training.sweep import sweep

REPEATS = 3


class Size(NamedTuple):
    """Size of a training: seeds of every point of the config's sweep, and episodes of each run."""

    seeds: int
    episodes: int


SETTINGS: dict[str, Mapping[str, Size]] = {
    "cpu": {"chain": Size(32, 60), "mjx-jax": Size(2, 4)},
    "gpu": {"chain": Size(256, 60), "mjx-jax": Size(256, 10)},
}


def run(say: Callable[[str], None], setting: Mapping[str, Size] | None = None) -> list[Record]:
    """Time the training in each physics, one after another."""
    setting = setting or SETTINGS.get(jax.default_backend(), SETTINGS["gpu"])
    records: list[Record] = []
    for physics, size in setting.items():
        sizes = f"seeds={size.seeds}", f"episodes={size.episodes}", "record=1"
        runs = make_plan(load("posture_switch", sizes)).num_runs
        overrides = *sizes, f"task.physics={physics}"
        call = with_room(training, *overrides) if physics.startswith("mjx") else training(*overrides)
        subject = Subject(call, runs * size.episodes, runs, REPEATS)
        name = f"{physics} posture_switch"
        timing = time_in_turn({name: subject})[name]
        records.append(record("physics", name, subject, timing, "episodes/s"))
        records.append(record("physics", name, subject, timing, "steps/s", float(timing.result)))
        say(f"{name:22} {runs:9,} runs  {records[-2].value:10.3e} episodes/s  {records[-1].value:10.3e} steps/s"
            f"  compiled in {timing.compile_s:4.1f} s")  # fmt: skip
    return records


def training(*overrides: str) -> Callable[[], np.float64]:
    """A call that trains the sweep of `posture_switch` so changed, and counts the steps of all its episodes."""

    def call() -> np.float64:
        with TemporaryDirectory() as folder:
            results = sweep("posture_switch", Path(folder) / "run", overrides=overrides).results
        return np.sum(results["steps"] * results["episode"], dtype=np.float64)

    return call
