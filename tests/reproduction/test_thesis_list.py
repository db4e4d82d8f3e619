"""docs/thesis.md: every figure, table and numbered equation once, and every experiment named."""

import re
from pathlib import Path

from humanoid_mjx.reproduction import load_experiments

DOCS = Path(__file__).parents[2] / "docs"
TEXT = (DOCS / "thesis.md").read_text(encoding="utf-8")

FIGURES = {3: 9, 4: 2, 5: 11, 6: 3, 7: 18}
TABLES = {3: 2, 4: 7, 5: 1, 7: 3}
EQUATIONS = {4: 39, 5: 49}
"""How many each chapter has, by the thesis's own lists and numbers."""


def rows(heading):
    """The cells of a section's table, without its head."""
    section = TEXT.split(f"## {heading}\n")[1].split("\n## ")[0]
    lines = [line for line in section.splitlines() if line.startswith("|")][2:]
    return [[cell.strip() for cell in line.strip("|").split(" | ")] for line in lines]


def numbers(heading):
    """All numbers that a section's first column names, ranges and pairs written out."""
    for first, *_ in rows(heading):
        ends = re.findall(r"(\d+)\.(\d+)", first)
        chapter, low, high = int(ends[0][0]), int(ends[0][1]), int(ends[-1][1])
        assert len(ends) == 1 or ends[0][0] == ends[1][0], first
        yield from ((chapter, number) for number in range(low, high + 1))


def everything(counts):
    return [(chapter, number) for chapter, count in counts.items() for number in range(1, count + 1)]


def test_nothing_is_missing_or_named_twice():
    assert list(numbers("Figures")) == everything(FIGURES)
    assert list(numbers("Tables")) == everything(TABLES)
    assert list(numbers("Equations")) == everything(EQUATIONS)


def test_every_experiment_is_named_and_every_name_is_one():
    named = set(re.findall(r"`([a-z]+(?:-[a-z0-9.]+)+|errata)`", TEXT))
    assert named == set(load_experiments())
