"""Two results of `bench --json` side by side: what became slower beyond the noise."""

import json
import math
from pathlib import Path
from typing import Any, NamedTuple

from rich.table import Column, Table

from humanoid_mjx.files import read_text
from humanoid_mjx.spec import InputError

SAME = ("bench", "subject", "device", "batch", "beside", "unit")
"""Keys by which a record is found in both results; `beside` only where a record has it."""

COSTS = ("s", "processor", "steps")
"""Units of which less is better, by their first word."""

LEAST_NOISE = 0.05
"""Medians of the same code in two runs differ by as much, whatever the spread within each."""

UNKNOWN_SPREAD = 0.2
"""The spread that is assumed of a record with one repeat, or from before spreads were written."""


class Change(NamedTuple):
    """A figure in both results."""

    key: tuple[Any, ...]
    """The values of `SAME`."""
    before: float
    after: float
    noise: float
    """The share by which the figure changes where nothing did."""

    @property
    def factor(self) -> float:
        """Ratio of the figures: above 1 is better, also where a unit is seconds or steps to success."""
        cost = str(self.key[-1]).split()[0] in COSTS
        better, worse = (self.before, self.after) if cost else (self.after, self.before)
        return better / worse if worse else math.inf

    @property
    def regressed(self) -> bool:
        return self.factor < 1.0 - self.noise


def read_result(path: Path) -> dict[str, Any]:
    """A result of `bench --json`.

    Raises:
      InputError: the file is something else.
    """
    try:
        result = json.loads(read_text(path))
        if not all(_key(record) and float(record["value"]) >= 0.0 for record in result["records"]):
            raise ValueError("values are rates, shares or costs, none of them negative")
    except (OSError, ValueError, LookupError, TypeError, AttributeError, RecursionError) as error:
        raise InputError(f"{path}: not a result of `bench --json`.") from error
    return result


def changes(before: dict[str, Any], after: dict[str, Any]) -> list[Change]:
    """Figures that both results have but for shares, in the order of the second; of figures of one key the last."""
    old, new = ({_key(record): record for record in result["records"]} for result in (before, after))
    pairs = [(key, old[key], new[key]) for key in new if key in old and not key[-1].startswith("share of")]
    return [Change(key, a["value"], b["value"], noise(a, b)) for key, a, b in pairs]


def noise(before: dict[str, Any], after: dict[str, Any]) -> float:
    """The share that lies within the spreads of the repeats of both, taken together as independent."""
    spreads = [record.get("spread") for record in (before, after)]
    return max(LEAST_NOISE, math.hypot(*(UNKNOWN_SPREAD if spread is None else spread for spread in spreads)))


def table(found: list[Change]) -> Table:
    """A row for each figure, regressions marked."""
    numbers = (Column(heading, justify="right") for heading in ("before", "after", "times", "noise"))
    shown = Table(*SAME[:3], Column("batch", justify="right"), "unit", *numbers, "")
    for change in found:
        bench, subject, device, batch, beside, unit = change.key
        subject += f" beside {beside:,}" if beside else ""
        figures = f"{change.before:.3e}", f"{change.after:.3e}", f"{change.factor:.2f}", f"{change.noise:.0%}"
        shown.add_row(bench, subject, device, f"{batch:,}", unit, *figures, "SLOWER" if change.regressed else "")
    return shown


def verdict(found: list[Change]) -> str:
    """One sentence about all figures."""
    slower = sum(change.regressed for change in found)
    return f"{slower or 'None'} of {len(found)} figures became worse beyond the noise."


def warnings(before: dict[str, Any], after: dict[str, Any]) -> list[str]:
    """Why the two results may not be comparable: other machines or versions, and figures that are missing."""
    lines: list[str] = []
    if before.get("commit") != after.get("commit"):
        lines.append(f"commit was {before.get('commit')}, is {after.get('commit')}")
    for part in ("machine", "versions"):
        old, new = before.get(part, {}), after.get(part, {})
        differing = [name for name in sorted({*old, *new}) if old.get(name) != new.get(name)]
        lines += [f"{part}: {name} was {old.get(name)}, is {new.get(name)}" for name in differing]
    keys = [{_key(record) for record in result["records"]} for result in (before, after)]
    if missing := len(keys[0] - keys[1]):
        lines.append(f"{missing} of the first result's figures are not in the second.")
    return lines


def _key(record: dict[str, Any]) -> tuple[Any, ...]:
    return tuple(record.get(name) if name == "beside" else record[name] for name in SAME)
