"""Experiments, their findings, and the verdict on a finding."""

import math
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any, Literal

import numpy as np

from humanoid_mjx.files import write_text
from humanoid_mjx.report.style import figure

Verdict = Literal["reproduced", "recovered", "consistent", "differs", "not_reproducible", "cannot_tell", "finding"]

MEANINGS: dict[Verdict, str] = {
    "reproduced": "what is printed comes out",
    "recovered": "it comes out with values that are not the printed ones",
    "consistent": "it agrees, but it could not have differed",
    "differs": "it does not come out",
    "not_reproducible": "no values that are possible could make it come out",
    "cannot_tell": "too few seeds to say whether it comes out",
    "finding": "nothing is printed that it could agree with",
}
"""Meaning of each verdict, in the order in which verdicts are counted."""


@dataclass(frozen=True)
class Finding:
    """One quantity: what is printed, what comes out, and whether they agree."""

    name: str = field(default="", kw_only=True)
    """The experiment; the runner fills it in."""
    quantity: str
    printed: Any
    """A number, numbers, or a statement in words; None where the source says nothing."""
    reproduced: Any
    tolerance: float | str | None
    verdict: Verdict
    why: str

    def __post_init__(self) -> None:
        if (self.printed is None) != (self.verdict == "finding"):
            raise ValueError(f"{self.quantity}: {self.verdict!r}, but printed is {self.printed!r}.")


@dataclass(frozen=True)
class Setting:
    """Surroundings of an experiment: its config with the user's changes, and the folder and name of its files."""

    config: dict[str, Any]
    out: Path
    tell: Callable[[str], None] = lambda words: None
    """Say in a few words what is being computed."""
    name: str = ""

    @contextmanager
    def figure(
        self, rows: int, columns: int, size: tuple[float, float], title: str = "", legend: int = 0, **kwargs: Any
    ) -> Iterator[Any]:
        """The experiment's figure as `report.style.figure` opens it, a title above, and below the legend of the first
        panel in this number of columns."""
        with figure(self.out / f"{self.name}.png", rows, columns, size, **kwargs) as (fig, axes):
            yield fig, axes
            if legend:
                fig.legend(
                    *axes[0, 0].get_legend_handles_labels(), loc="outside lower center", ncols=legend, frameon=False
                )
            fig.suptitle(title, x=0.02, ha="left", fontsize="medium")

    def table(self, heads: Sequence[str], rows: Iterable[Sequence[Any]]) -> None:
        """Write the experiment's table in Markdown."""
        lines = (" | ".join(map(str, row)) for row in (heads, ["---"] * len(heads), *rows))
        write_text(self.out / f"{self.name}.md", "".join(f"| {line} |\n" for line in lines))


Run = Callable[[Setting], Iterable[Finding]]


@dataclass(frozen=True)
class Experiment:
    """A thing to reproduce. `config` holds the values that `--set` may change."""

    name: str
    title: str
    run: Run
    config: Mapping[str, Any]


EXPERIMENTS: dict[str, Experiment] = {}
"""Experiments by name, as far as their modules are imported."""


def experiment(name: str, title: str, config: Mapping[str, Any] | None = None) -> Callable[[Run], Run]:
    """Register a function as the experiment of this name."""

    def register(run: Run) -> Run:
        EXPERIMENTS[name] = Experiment(name, title, run, config or {})
        return run

    return register


def unprinted(quantity: str, found: Any, why: str) -> Finding:
    """A finding where the source prints nothing."""
    return Finding(quantity, None, found, None, "finding", why)


def compare(
    quantity: str, printed: Any, value: Any, tolerance: Any, why: str, digits: int | None = None, **judged: Any
) -> Finding:
    """A finding on numbers: they agree where none is further from its printed one than the tolerance.

    Args:
      printed: a number, or an array or list of them.
      value: numbers shaped as `printed`; a value that is not finite agrees with nothing.
      tolerance: one, or one for each number; the least of them is reported.
      digits: decimal places of the reported value; None reports three significant digits.
      judged: as in `check`.
    """
    agrees = np.all(np.abs(np.asarray(value) - np.asarray(printed)) <= np.asarray(tolerance))
    shown = three_digits(value) if digits is None else (np.round(value, digits) + 0.0).tolist()
    mark = np.asarray(printed).tolist()
    return check(quantity, mark, shown, agrees, why, float(np.min(tolerance)), **judged)


def check(
    quantity: str,
    printed: Any,
    found: Any,
    agrees: Any,
    why: str,
    tolerance: float | str | None = None,
    values: tuple[Mapping[str, Any], Mapping[str, Any]] = ({}, {}),
    possible: Any = True,
    could_differ: Any = True,
) -> Finding:
    """A finding with its verdict.

    Args:
      agrees: True if the result is the printed one, within the tolerance.
      values: the values it was computed with, by name, and those that the thesis prints for the same names.
      possible: False if no values could have made it agree.
      could_differ: False where agreement follows from the construction.
    """
    if not agrees:
        verdict = "differs" if possible else "not_reproducible"
    elif not could_differ:
        verdict = "consistent"
    else:
        verdict = "recovered" if changed(*values) else "reproduced"
    return Finding(quantity, printed, found, tolerance, verdict, why)


def changed(used: Mapping[str, Any], printed: Mapping[str, Any]) -> list[str]:
    """The values used that differ from the printed ones, in words."""
    return [
        f"{name} {value:g} in place of the printed {printed[name]:g}"
        for name, value in used.items()
        if name in printed and not math.isclose(value, printed[name], rel_tol=1e-9)
    ]


def in_words(used: Mapping[str, Any], printed: Mapping[str, Any]) -> str:
    """Differences of the values used from the printed ones, as the start of a sentence."""
    changes = changed(used, printed)
    return "with " + ", ".join(changes) if changes else "with the printed values"


def three_digits(value: Any) -> Any:
    """A number rounded to three significant digits, or a list of such numbers."""
    return [three_digits(x) for x in value] if np.ndim(value) else float(f"{value:.3g}")


def listed(values: Iterable[Any]) -> str:
    """Numbers as words, with commas between them."""
    return ", ".join(f"{value:g}" for value in values)


def as_text(value: Any) -> str:
    """Write a printed or computed value: a number to all digits that are printed anywhere, a list or a mapping."""
    if isinstance(value, (list, tuple)):
        return ", ".join(map(as_text, value))
    if isinstance(value, dict):
        return "; ".join(f"{key}: {as_text(inner)}" for key, inner in value.items() if inner != "")
    return "nothing" if value is None else f"{value:.9g}" if isinstance(value, float) else str(value)
