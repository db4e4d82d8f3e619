"""Training end to end by each learner, as the shipped configs say: steps and episodes a second, seconds to success.

One run of each config, seed 0, is swept into a folder of its own, with nothing compiled before it and no compiled
program found on disk. Rates leave compiling out: they are taken between the first and the last look at the training.

    steps/s     decisions of the task, all environments together, with the learning between them
    episodes/s  the same by the mean length of an episode in training
    s to 95 %   wall time, compiling included, to the first record point whose greedy episodes succeed in 95 %

The greedy episodes that `deep_q` and `linear_q` are judged by run after training and take none of this time; those of
`brax_ppo` run on the way, and are in its time. A config that does not ship, or needs brax where that is not installed,
is left out.
"""

from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from importlib.util import find_spec
from json import loads
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import NamedTuple

import jax
import numpy as np
from jax.experimental.compilation_cache import compilation_cache

from humanoid_mjx.bench.measure import Record
from humanoid_mjx.config import load
from humanoid_mjx.data import names
from humanoid_mjx.training.sweep import Run, sweep

SUCCESS = 0.95

LEG = ("leg_reach", "leg_reach_linear", "leg_reach_ppo")
CONFIGS = {"cpu": LEG, "gpu": (*LEG, "stand", "stand_ppo")}


class Measured(NamedTuple):
    """What a run tells of its speed."""

    steps_per_s: float
    episodes_per_s: float
    success_s: float
    """NaN where it was never reached."""
    best: float
    """The highest share of greedy episodes that succeeded at any record point."""


def run(
    say: Callable[[str], None], configs: Sequence[str] | None = None, overrides: Sequence[str] = ()
) -> list[Record]:
    """Train one run of every config."""
    records: list[Record] = []
    for name in configs or CONFIGS.get(jax.default_backend(), CONFIGS["gpu"]):
        if name not in names("configs", ".yaml"):
            say(f"{name}: does not ship")
            continue
        config = load(name, ["seeds=1", *overrides])
        learner = config.learner["name"]
        if learner == "brax_ppo" and find_spec("brax") is None:
            say(f"{name}: brax is not installed")
            continue
        with TemporaryDirectory() as folder, nothing_compiled():
            trained = sweep(config, Path(folder) / "run")
            compile_s = loads((trained.path / "provenance.json").read_text())["compile_s"]
            found, envs = measure(trained), environments(trained.config.learner)
        subject = f"{learner} {config.task['name']}"
        values = {"steps/s": found.steps_per_s, "episodes/s": found.episodes_per_s, "s to 95 %": found.success_s}
        device = jax.devices()[0].device_kind
        records += [
            Record("training", subject, device, envs, value, unit, compile_s, 1)
            for unit, value in values.items()
            if np.isfinite(value)
        ]
        reached = f"{found.success_s:.1f} s to 95 %" if np.isfinite(found.success_s) else f"at most {found.best:.1%}"
        say(f"{subject:20} {envs:7,} envs  {found.steps_per_s:10.3e} steps/s  {found.episodes_per_s:10.3e} episodes/s"
            f"  {reached}  compiled in {compile_s:4.1f} s")  # fmt: skip
    return records


def environments(learner: Mapping[str, object]) -> int:
    """How many environments a resolved learner has side by side."""
    return int(str(learner.get("envs", learner.get("num_envs", 1))))


def measure(trained: Run) -> Measured:
    """Rates and the time to success of the only run of a sweep.

    A rate is NaN where training was over at the first look.
    """
    results, wall_s = trained.results, trained.timing["wall_s"].astype(float)
    compiled = np.flatnonzero(wall_s == wall_s[0])[-1]
    steps = (1.0 - (compiled + 1) / len(wall_s)) * trained.config.budget
    seconds = wall_s[-1] - wall_s[0]
    rate = steps / seconds if steps else np.nan
    lengths = results["steps"][np.isfinite(results["steps"])]
    greedy = results["greedy_success"]
    reached = np.flatnonzero(greedy >= SUCCESS)
    success_s = float(wall_s[reached[0]]) if len(reached) else float("nan")
    return Measured(rate, rate / lengths.mean(), success_s, float(np.nanmax(greedy)))


@contextmanager
def nothing_compiled() -> Iterator[None]:
    """Forget compiled programs, and neither find nor leave any on disk."""
    before = jax.config.values["jax_enable_compilation_cache"]
    jax.clear_caches()
    jax.config.update("jax_enable_compilation_cache", False)
    compilation_cache.reset_cache()
    try:
        yield
    finally:
        jax.config.update("jax_enable_compilation_cache", before)
        compilation_cache.reset_cache()
