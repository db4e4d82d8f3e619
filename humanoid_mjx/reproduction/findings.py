"""What an experiment is, what it finds, and how a verdict is computed."""

import math
from collections.abc import Callable, Iterable, Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any, Literal

Verdict = Literal["reproduced", "recovered", "differs", "not_reproducible", "finding"]
"""`reproduced`: what is printed comes out. `recovered`: it does with values that are not the printed ones. `differs`:
it does not. `not_reproducible`: no values that are possible could make it. `finding`: nothing is printed, so there is
nothing to agree with."""


@dataclass(frozen=True)
class Finding:
    """One quantity: what is printed, what comes out, and whether they agree."""

    name: str
    """The experiment."""
    quantity: str
    printed: Any
    """A number, numbers, or a statement in words; None where the source says nothing."""
    reproduced: Any
    tolerance: float | None
    verdict: Verdict
    why: str

    def __post_init__(self) -> None:
        if (self.printed is None) != (self.verdict == "finding"):
            raise ValueError(f"{self.name}, {self.quantity}: {self.verdict!r}, but printed is {self.printed!r}.")


def _ignore(words: str) -> None:
    """Discard progress: the default where nobody watches."""


@dataclass(frozen=True)
class Setting:
    """What an experiment may use: its config with the user's changes, and a folder for its figures."""

    config: dict[str, Any]
    out: Path
    tell: Callable[[str], None] = _ignore
    """Say in a few words what is being computed."""


@dataclass(frozen=True)
class Experiment:
    """A thing to reproduce. `config` holds the values that `--set` may change."""

    name: str
    title: str
    run: Callable[[Setting], list[Finding]]
    config: Mapping[str, Any] = field(default_factory=dict)


def unprinted(name: str, quantity: str, reproduced: Any, why: str, tolerance: float | None = None) -> Finding:
    """What comes out where the source prints nothing."""
    return Finding(name, quantity, None, reproduced, tolerance, "finding", why)


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
    """The values used that differ from the printed ones, in words."""
    return [
        f"{name} {value:g} in place of the printed {printed[name]:g}"
        for name, value in used.items()
        if name in printed and not math.isclose(value, printed[name], rel_tol=1e-9)
    ]


def in_words(used: Mapping[str, Any], printed: Mapping[str, Any]) -> str:
    """How the values used differ from the printed ones, as the start of a sentence."""
    changes = departures(used, printed)
    return "with " + ", ".join(changes) if changes else "with the printed values"


def three_digits(value: Any) -> float:
    """A number rounded to three significant digits."""
    return float(f"{value:.3g}")


def listed(values: Iterable[Any]) -> str:
    """Numbers as words, with commas between them."""
    return ", ".join(f"{value:g}" for value in values)
