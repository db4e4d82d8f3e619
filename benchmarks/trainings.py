"""Training end to end by each learner, as the shipped configs say: steps and episodes a second, what success takes.

Each config is swept with several seeds into a folder of its own, with nothing compiled before it, not on disk either.
Seeds train side by side. Rates are of all seeds together and leave compiling out: they are taken between the first and
the last look at the training.

    steps/s             decisions of the task, all environments together, with the learning between them
    episodes/s          the same by the mean length of an episode in training
    steps to 95 %       of a seed up to the first record point whose greedy episodes succeed in 95 %, the median over
                        seeds: of all figures the one that another machine, or a busy one, does not change
    success at the end  share of greedy episodes that succeed after training, the mean over seeds
    s to 95 %           wall time, compiling included, until every seed has come to such a point

Beside them the shares of an update (`shares.py`). Of `walk_cpu` one seed trains, alone and briefly: its rate is that of
a run that has all cores, its shares are of one.
`by_seed` has the value of each seed, None where it never came to such a point; `interval` is the 95 % interval of the
mean over seeds. The greedy episodes that learners are judged by run after training and take none of this time. A config
that does not ship, or needs brax where that is not installed, is left out.
"""

from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from importlib.util import find_spec
from json import loads
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any, NamedTuple

import jax
import numpy as np
from jax.experimental.compilation_cache import compilation_cache
from jaxtyping import Float
from timing import Record, spread

from humanoid_mjx.config import load
from humanoid_mjx.files import names
from humanoid_mjx.kernels import cpu_kernel
from humanoid_mjx.runs.statistics import estimate
from humanoid_mjx.training.programs import programs
from humanoid_mjx.training.sweep import Run, sweep

SUCCESS = 0.95

SEEDS = 5

LEG = ("leg_reach", "leg_reach_linear", "leg_reach_ppo")
CONFIGS = {"cpu": (*LEG, "walk_cpu"), "gpu": (*LEG, "stand", "stand_ppo")}

BRIEF = {
    "walk_cpu": ("seeds=1", "total_steps=1_000_000", "learner.evaluations=1"),
    "walk": ("seeds=5", "total_steps=20_000_000", "learner.evaluations=1"),
}
"""Overrides of configs that do not train to the end: only their rate is measured."""


class Measured(NamedTuple):
    """Measures of a learner, from the only point of a sweep."""

    steps_per_s: float
    """Of all seeds together; NaN where training was over at the first look."""
    episodes_per_s: float
    steps: Float[np.ndarray, " seeds"]
    """To the first point of success; NaN where a seed never came there."""
    seconds: float
    """Until every seed has come there; NaN where one never did."""
    final: Float[np.ndarray, " seeds"]
    """Share of greedy episodes that succeed after training."""


def run(
    say: Callable[[str], None], configs: Sequence[str] | None = None, overrides: Sequence[str] = (), seeds: int = SEEDS
) -> list[Record]:
    """Train every config with so many seeds."""
    records: list[Record] = []
    for name in configs or CONFIGS.get(jax.default_backend(), CONFIGS["gpu"]):
        if name not in names("configs", ".yaml"):
            say(f"{name}: does not ship")
            continue
        config = load(name, [*BRIEF.get(name, [f"seeds={seeds}"]), *overrides])
        learner = config.learner["name"]
        if learner == "brax_ppo" and find_spec("brax") is None:
            say(f"{name}: brax is not installed")
            continue
        with TemporaryDirectory() as folder, nothing_compiled(Path(folder) / "programs"):
            trained = sweep(config, Path(folder) / "run")
            compile_s = loads((trained.path / "provenance.json").read_text())["compile_s"]
            found, envs = measure(trained), environments(trained.config.learner)
        device = jax.devices()[0].device_kind
        common = {"device": device, "batch": envs, "compile_s": compile_s, "repeats": config.seeds}
        records += [
            Record(bench="training", subject=name, **common, **figure)
            for figure in figures(found)[: 1 if name in BRIEF else None]
            if np.isfinite(figure["value"])
        ]
        success = "" if name in BRIEF else f"  {in_words(found)}"
        say(f"{name:20} {envs:7,} envs  {found.steps_per_s:10.3e} steps/s  {found.episodes_per_s:10.3e} episodes/s"
            f"{success}  compiled in {compile_s:4.1f} s")  # fmt: skip
    return records


def figures(found: Measured) -> list[dict[str, Any]]:
    """Figures of a training, as fields of `Record`."""
    steps = [float(x) if np.isfinite(x) else None for x in found.steps]
    final = estimate(found.final, 0.0, 1.0)
    ends = (final.low, final.high) if len(found.final) > 1 else None
    middle, _ = _middle_and_worst(found.steps)
    known = [x for x in steps if x is not None]
    return [
        {"unit": "steps/s", "value": found.steps_per_s},
        {"unit": "episodes/s", "value": found.episodes_per_s},
        {"unit": "steps to 95 %", "value": middle, "by_seed": steps, "spread": spread(known)},
        {
            "unit": "success at the end",
            "value": final.value,
            "by_seed": found.final.tolist(),
            "interval": ends,
            "spread": spread(found.final.tolist()) if found.final.all() else None,
        },
        {"unit": "s to 95 %", "value": found.seconds},
    ]


def in_words(found: Measured) -> str:
    """Success in a few words: the steps that the seeds took to it, in the middle and at worst, and where they ended."""
    middle, worst = (f"{x:.3g}" if np.isfinite(x) else "never" for x in _middle_and_worst(found.steps))
    took = f"{found.seconds:.1f} s until every seed was there" if np.isfinite(found.seconds) else "not every seed"
    final = f"{found.final.mean():.1%} at the end, at worst {found.final.min():.1%}"
    return f"95 % after {middle} steps, at worst {worst}, {took}; {final}"


def _middle_and_worst(steps: Float[np.ndarray, " seeds"]) -> tuple[float, float]:
    """Median and maximum, infinite where a seed never came to success: it took longer than any that did."""
    known = np.where(np.isfinite(steps), steps, np.inf)
    return float(np.median(known)), float(known.max())


def environments(learner: Mapping[str, object]) -> int:
    """Number of environments that a resolved learner has side by side."""
    return int(str(learner.get("envs", learner.get("num_envs", 1))))


def measure(trained: Run) -> Measured:
    """Rates and success of the only point of a sweep, from the tables of its run folder."""
    results, config = trained.results, trained.config
    budget = float(config.episodes or config.total_steps or np.nan)
    wall_s = trained.timing["wall_s"].astype(float).reshape(config.seeds, -1)
    final, greedy = trained.summary["greedy_success"].astype(float), np.full(wall_s.shape, np.nan)
    greedy[:, -1] = final  # the only evaluation, where a learner has no other
    if "greedy_success" in results:
        greedy = results["greedy_success"].reshape(wall_s.shape)
    steps = float(np.mean(wall_s > wall_s.min())) * budget * config.seeds
    rate = steps / float(np.ptp(wall_s)) if steps else np.nan
    lengths = results["steps"][np.isfinite(results["steps"])]
    reached = greedy >= SUCCESS
    never, place = ~reached.any(axis=1), reached.argmax(axis=1)
    share = (place + 1) / greedy.shape[1]
    seconds = np.where(never, np.nan, wall_s[np.arange(len(place)), place])
    return Measured(
        steps_per_s=rate,
        episodes_per_s=rate / float(lengths.mean()),
        steps=np.where(never, np.nan, share * budget),
        seconds=float(seconds.max()),
        final=final,
    )


@contextmanager
def nothing_compiled(cache: Path | None = None) -> Iterator[None]:
    """Forget compiled programs and find none on disk, but those that the block itself leaves in the folder `cache`."""
    settings = {"jax_enable_compilation_cache": cache is not None, "jax_compilation_cache_dir": cache and str(cache)}
    before = {name: jax.config.values[name] for name in settings}
    programs.cache_clear()
    jax.clear_caches()
    cpu_kernel.forget()
    _set_cache(settings)
    try:
        yield
    finally:
        _set_cache(before)


def _set_cache(settings: Mapping[str, Any]) -> None:
    for name, value in settings.items():
        jax.config.update(name, value)
    compilation_cache.reset_cache()
