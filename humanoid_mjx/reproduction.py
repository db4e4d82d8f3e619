"""Reproduce the thesis: experiments that compare what is printed with what comes out, and judge it by computing."""

import importlib.util
import json
import math
from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import asdict, dataclass, field
from pathlib import Path
from typing import Any, Literal

from humanoid_mjx.config import apply_override
from humanoid_mjx.data import folder
from humanoid_mjx.spec import InputError, known

Verdict = Literal["reproduced", "recovered", "differs", "not_reproducible"]


@dataclass(frozen=True)
class Finding:
    """One quantity: what is printed, what comes out, and whether they agree."""

    name: str
    """The experiment."""
    quantity: str
    printed: Any
    reproduced: Any
    tolerance: float | None
    verdict: Verdict
    why: str


@dataclass(frozen=True)
class Setting:
    """What an experiment may use: its config with the user's changes, and a folder for its figures."""

    config: dict[str, Any]
    out: Path


@dataclass(frozen=True)
class Experiment:
    """A thing to reproduce. `config` holds the values that `--set` may change."""

    name: str
    title: str
    run: Callable[[Setting], list[Finding]]
    config: Mapping[str, Any] = field(default_factory=dict)


def judge(agrees: bool, used: Mapping[str, Any], printed: Mapping[str, Any], *, possible: bool = True) -> Verdict:
    """The verdict on a quantity.

    Args:
      agrees: whether what came out is what is printed, within the tolerance.
      used: the values it was computed with, by name.
      printed: the values that the thesis prints for the same names.
      possible: whether any values could have made it come out.
    """
    if agrees:
        return "reproduced" if not departures(used, printed) else "recovered"
    return "differs" if possible else "not_reproducible"


def departures(used: Mapping[str, Any], printed: Mapping[str, Any]) -> list[str]:
    """The values used that are not as printed, as words."""
    return [
        f"{name} {value:g} in place of the printed {printed[name]:g}"
        for name, value in used.items()
        if name in printed and not math.isclose(value, printed[name], rel_tol=1e-9)
    ]


def in_words(used: Mapping[str, Any], printed: Mapping[str, Any]) -> str:
    """How the values used differ from the printed ones, as the start of a sentence."""
    changes = departures(used, printed)
    return "with " + ", ".join(changes) if changes else "with the printed values"


def load_experiments(where: Path | None = None) -> dict[str, Experiment]:
    """All experiments of the folder `experiments`, by name."""
    found: dict[str, Experiment] = {}
    for path in sorted((where or folder("experiments")).glob("*.py")):
        spec = importlib.util.spec_from_file_location(f"humanoid_mjx_experiments_{path.stem}", path)
        if spec is None or spec.loader is None:
            continue
        module = importlib.util.module_from_spec(spec)
        spec.loader.exec_module(module)
        found |= {experiment.name: experiment for experiment in getattr(module, "EXPERIMENTS", ())}
    return dict(sorted(found.items(), key=lambda item: _natural(item[0])))


def reproduce(
    names: Sequence[str],
    out: Path,
    overrides: Sequence[str] = (),
    say: Callable[[Experiment, list[Finding]], None] = lambda experiment, findings: None,
) -> list[Finding]:
    """Run experiments (all, if none is named) and write `reproduce.json` and their figures into `out`.

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
    findings: list[Finding] = []
    for experiment, setting in zip(chosen, settings, strict=True):
        found = experiment.run(setting)
        say(experiment, found)
        findings += found
    write_findings(out / "reproduce.json", findings)
    return findings


def write_findings(path: Path, findings: Iterable[Finding]) -> None:
    path.write_text(json.dumps([asdict(finding) for finding in findings], indent=2) + "\n", encoding="utf-8")


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
    return Setting(config, out)


def _natural(name: str) -> list[Any]:
    """A sort key in which figure-7.2 comes before figure-7.11."""
    pieces = name.replace("-", " ").replace(".", " ").split()
    return [(0, int(piece), "") if piece.isdigit() else (1, 0, piece) for piece in pieces]
