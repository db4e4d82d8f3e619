"""Run experiments by name and write down what they find."""

import json
import time
from collections.abc import Callable, Sequence
from dataclasses import asdict, replace
from functools import partial
from importlib import import_module
from pathlib import Path
from typing import Any

from humanoid_mjx.config import apply_override
from humanoid_mjx.files import write_text
from humanoid_mjx.reproduction.findings import Experiment, Finding, Setting
from humanoid_mjx.spec import InputError, known

MODULES = (
    "decision_process",
    "drives",
    "errata",
    "gains",
    "ground_control",
    "ground_gaits",
    "joint_ways",
    "motor_sizing",
    "planned_torques",
    "postures",
    "q_tables",
    "responses",
    "robustness",
    "singularity",
    "stall_torques",
    "tracking",
    "workspace",
)
"""The modules of this package that hold experiments, in their `EXPERIMENTS`."""


def load_experiments() -> dict[str, Experiment]:
    """All experiments by name, in the order of the thesis."""
    modules = [import_module(f"humanoid_mjx.reproduction.{name}") for name in MODULES]
    found = {experiment.name: experiment for module in modules for experiment in module.EXPERIMENTS}
    return dict(sorted(found.items(), key=lambda item: _natural(item[0])))


def reproduce(
    names: Sequence[str],
    out: Path,
    overrides: Sequence[str] = (),
    say: Callable[[Experiment, list[Finding], float], None] = lambda experiment, findings, seconds: None,
    tell: Callable[[Experiment, str], None] = lambda experiment, words: None,
) -> list[Finding]:
    """Run experiments (all, if none is named) and write their figures, `reproduce.json` and what time each took,
    `reproduce_times.json`, into `out`: `wall_s` on the clock, and `cpu_s` of all cores together, which other work on
    the machine hardly changes. Verdicts and times of other experiments that stand there already stay.

    Args:
      say: called after each experiment with what it found and the seconds it took.
      tell: called while one runs, with what it computes at the moment.

    Raises:
      InputError: an unknown name, or an override of what a named experiment does not use.
    """
    experiments = load_experiments()
    if odd := [name for name in names if name not in experiments]:
        raise InputError(f"reproduce: unknown name {odd[0]!r}; {known(odd[0], experiments)}.")
    chosen = [experiments[name] for name in names] or list(experiments.values())
    settings = [_setting(experiment, out, overrides, named=bool(names)) for experiment in chosen]
    try:
        out.mkdir(parents=True, exist_ok=True)
    except OSError as error:
        raise InputError(f"--out {out}: cannot be written: {error.strerror}.") from error
    names = [experiment.name for experiment in chosen]
    findings, earlier = [], [each for each in _stored(out / "reproduce.json", list) if each.get("name") not in names]
    times = _stored(out / "reproduce_times.json", dict)
    place = {name: number for number, name in enumerate(experiments)}
    for experiment, setting in zip(chosen, settings, strict=True):
        start, cpu_start = time.perf_counter(), time.process_time()
        found = experiment.run(replace(setting, tell=partial(tell, experiment)))
        found = [replace(finding, name=experiment.name) for finding in found]
        wall_s, cpu_s = time.perf_counter() - start, time.process_time() - cpu_start
        times[experiment.name] = {"wall_s": round(wall_s, 2), "cpu_s": round(cpu_s, 2)}
        say(experiment, found, wall_s)
        findings += found
        everything = [*earlier, *map(asdict, findings)]
        everything.sort(key=lambda finding: place.get(finding.get("name"), len(place)))
        write_text(out / "reproduce.json", json.dumps(everything, indent=2) + "\n")
        write_text(out / "reproduce_times.json", json.dumps(times, indent=2) + "\n")
    return findings


def _stored(path: Path, kind: type) -> Any:
    """What an earlier call wrote; an empty `kind` where that is nothing or damaged."""
    try:
        found = json.loads(path.read_text(encoding="utf-8"))
    except (OSError, ValueError, RecursionError):
        return kind()
    if isinstance(found, list):
        found = [each for each in found if isinstance(each, dict)]
    return found if isinstance(found, kind) else kind()


def _setting(experiment: Experiment, out: Path, overrides: Sequence[str], named: bool) -> Setting:
    """The experiment's config with the overrides; those of keys it lacks are errors only where it was named."""
    config = json.loads(json.dumps(dict(experiment.config)))
    for override in overrides:
        key = override.partition("=")[0]
        part: Any = config
        for piece in key.split("."):
            part = part.get(piece) if isinstance(part, dict) else None
        if part is None and "=" in override:
            if named:
                keys = [f"{a}.{b}" for a, bs in config.items() for b in (bs if isinstance(bs, dict) else ())]
                raise InputError(f"--set {override}: {experiment.name} has no {key}; {known(key, keys or ['none'])}.")
            continue
        apply_override(config, override)
    return Setting(config, out, name=experiment.name)


def _natural(name: str) -> list[Any]:
    """A sort key in which figure-7.2 comes before figure-7.11."""
    pieces = name.replace("-", " ").replace(".", " ").split()
    return [(0, int(piece), "") if piece.isdigit() else (1, 0, piece) for piece in pieces]
