"""Run experiments by name and write down what they find."""

import json
import pkgutil
import time
from collections.abc import Callable, Sequence
from dataclasses import asdict, fields, replace
from importlib import import_module
from pathlib import Path
from typing import Any

from humanoid_mjx import compute
from humanoid_mjx.config import apply_override, check_overrides
from humanoid_mjx.files import read_text, write_json
from humanoid_mjx.reproduction.findings import EXPERIMENTS, Experiment, Finding, Setting
from humanoid_mjx.spec import InputError, known

FINDINGS, RUNS = "reproduce.json", "reproduce_runs.json"
"""Files of a folder of results."""


def load_experiments() -> dict[str, Experiment]:
    """All experiments by name, in the order of the thesis."""
    package = import_module("humanoid_mjx.reproduction")
    for module in pkgutil.iter_modules(package.__path__, f"{package.__name__}."):
        import_module(module.name)
    return dict(sorted(EXPERIMENTS.items(), key=lambda item: _natural(item[0])))


def reproduce(
    names: Sequence[str],
    out: Path,
    overrides: Sequence[str] = (),
    say: Callable[[Experiment, list[Finding], float], None] = lambda experiment, findings, seconds: None,
    tell: Callable[[str], None] = lambda words: None,
) -> list[Finding]:
    """Run experiments (all, if none is named) and write their figures, tables and findings into `out`.

    `reproduce.json` gets the findings and `reproduce_runs.json` their origin (`read_runs`). Both keep what earlier
    calls found in the experiments that do not run now.

    Args:
      say: called after each experiment with what it found and the seconds it took.
      tell: called while one runs, with the progress in words.

    Raises:
      InputError: an unknown name, an override of what a named experiment does not use, or a damaged file in `out`.
    """
    check_overrides(overrides)
    experiments = load_experiments()
    if odd := [name for name in names if name not in experiments]:
        raise InputError(f"reproduce: unknown name {odd[0]!r}; {known(odd[0], experiments, 'reproduce --list')}.")
    chosen = [experiments[name] for name in dict.fromkeys(names)] or list(experiments.values())
    settings = [_setting(experiment, out, overrides, named=bool(names)) for experiment in chosen]
    try:
        out.mkdir(parents=True, exist_ok=True)
    except OSError as error:
        raise InputError(f"--out {out}: cannot be written: {error.strerror}.") from error
    findings = read_findings(out / FINDINGS) if (out / FINDINGS).exists() else []
    runs, found_now = [*read_runs(out), compute.made_by() | {"times": {}}], []
    for number, (experiment, setting) in enumerate(zip(chosen, settings, strict=True), start=1):
        place = f"{number} of {len(chosen)}, {experiment.name}"
        tell(place)
        start, cpu_start = time.perf_counter(), time.process_time()
        setting = replace(setting, tell=lambda words, place=place: tell(f"{place}: {words}"))
        found = [replace(finding, name=experiment.name) for finding in experiment.run(setting)]
        wall_s, cpu_s = time.perf_counter() - start, time.process_time() - cpu_start
        say(experiment, found, wall_s)
        found_now += found
        findings = [finding for finding in findings if finding["name"] != experiment.name] + list(map(asdict, found))
        findings.sort(key=lambda finding: _natural(finding["name"]))
        for run in runs:
            run["times"].pop(experiment.name, None)
        runs[-1]["times"][experiment.name] = {"wall_s": round(wall_s, 2), "cpu_s": round(cpu_s, 2)}
        runs = [run for run in runs if run["times"]]
        for name, content in ((FINDINGS, findings), (RUNS, runs)):
            write_json(out / name, content, indent=2)
    return found_now


def read_findings(file: Path) -> list[dict[str, Any]]:
    """The findings that `reproduce` has written, as plain values.

    Raises:
      InputError: the file is damaged.
    """
    try:
        found = json.loads(read_text(file))
    except (OSError, ValueError, RecursionError) as error:
        raise InputError(f"{file}: this file is truncated or damaged; run reproduce again.") from error
    keys = {field.name for field in fields(Finding)}
    if not isinstance(found, list) or not all(isinstance(each, dict) and keys <= set(each) for each in found):
        raise InputError(f"{file}: this is not what reproduce writes.")
    return found


def read_runs(out: Path) -> list[dict[str, Any]]:
    """The origin of the findings in `out`: of each call machine, versions, commit and the times of its experiments.

    `times` has the `wall_s` and `cpu_s` of each experiment by name, the latter of all cores together. An experiment
    stands in the last call that ran it. Empty where there is no such file, or one that is damaged.
    """
    try:
        runs = json.loads(read_text(out / RUNS))
        return [run for run in runs if isinstance(run["times"], dict)]
    except (OSError, ValueError, LookupError, TypeError, RecursionError):
        return []


def _setting(experiment: Experiment, out: Path, overrides: Sequence[str], named: bool) -> Setting:
    """The experiment's config with the overrides; those of keys it lacks are errors only where it was named."""
    config = dict(experiment.config)
    keys = [f"{part}.{name}" for part, values in config.items() for name in values]
    for override in overrides:
        key, sign, _ = override.partition("=")
        if key in (*config, *keys) or not sign:
            apply_override(config, override)
        elif named:
            raise InputError(f"--set {override}: {experiment.name} has no {key}; {known(key, keys or ['none'])}.")
    return Setting(config, out, name=experiment.name)


def _natural(name: str) -> list[Any]:
    """A sort key in which figure-7.2 comes before figure-7.11."""
    pieces = name.replace("-", " ").replace(".", " ").split()
    return [(0, int(piece), "") if piece.isdigit() else (1, 0, piece) for piece in pieces]
