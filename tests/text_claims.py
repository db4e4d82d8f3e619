"""Figures that are printed in a page, and the records in `docs/bench` that they are compared with."""

import json
import re
from collections.abc import Iterator
from decimal import Decimal
from pathlib import Path
from typing import Any, NamedTuple

ROOT = Path(__file__).parent.parent
RECORDS = {path.name: json.loads(path.read_text()) for path in (ROOT / "docs" / "bench").glob("*.json")}
NUMBER = r"-?\d[\d,]*(?:\.\d+)?(?:e\d+)?"


class Claim(NamedTuple):
    """A figure of the text beside what the record says."""

    record: str
    place: str
    printed: str
    value: float

    @property
    def holds(self) -> bool:
        """Whether the record's value, rounded to the digits printed, is what is printed."""
        number = Decimal(self.printed.replace(",", ""))
        half = 0.5 * 10.0 ** int(number.as_tuple().exponent)
        return abs(self.value - float(number)) <= half * (1 + 1e-6)


def tables(markdown: str) -> Iterator[list[list[str]]]:
    """The tables of a page as rows of cells, the ruler left out."""
    for block in re.findall(r"(?:^\|.*\|\n)+", markdown, re.M):
        rows = [[cell.strip() for cell in line.strip("|").split("|")] for line in block.splitlines()]
        yield [rows[0], *rows[2:]]


def greedy_gaits(record: Any, result: int = 0) -> dict[str, Any]:
    """The figures of the trained policies in a result of a record of `evaluate --gait`, by scenario."""
    gaits = record["results"][result]["gaits"]
    return {gait["scenario"]: gait["figures"] for gait in gaits if gait["agent"] == "greedy"}
