"""The table of docs/tasks.md: what policies reach on the physics that they were not trained on."""

import re
from typing import get_args

import pytest
from text_claims import NUMBER, RECORDS, ROOT, Claim, tables

from humanoid_mjx.tasks import make_task

NAME = "cpu_2_cores_other_physics.json"
RESULTS = RECORDS[NAME]["results"]
COLUMNS = (("greedy", "success", 100.0), ("greedy", "return", 1.0), ("random", "success", 100.0))


def table():
    """The rows: policy, physics, whether it was trained there, and a cell for each of `COLUMNS`."""
    page = (ROOT / "docs" / "tasks.md").read_text(encoding="utf-8")
    (rows,) = (rows for rows in tables(page) if rows[0][:2] == ["policy of", "physics"])
    for policy, physics, *cells in rows[1:]:
        name, _, own = physics.partition(", ")
        yield policy.strip("`"), name.strip("`"), own == "its own", cells


def test_the_table_says_what_the_record_says():
    """Each figure and both ends of its interval, of every physics that was measured."""
    measured = {(row["policy"], row["physics"]): row for row in RESULTS if "agents" in row}
    assert [row[:2] for row in table()] == list(measured)
    for policy, physics, own, cells in table():
        row = measured[policy, physics]
        assert own == (row["trained_on"] == physics)
        for cell, (agent, name, factor) in zip(cells, COLUMNS, strict=True):
            found = row["agents"][agent]
            values = [found[name], *found[f"{name}_interval"]]
            for text, value in zip(re.findall(NUMBER, cell), values, strict=True):
                assert Claim(NAME, f"{policy} on {physics}", text, factor * value).holds, (policy, physics, cell)


@pytest.mark.parametrize("task", ["posture_switch", "leg_reach", "stand"])
def test_every_physics_of_a_task_is_in_the_record(task):
    offered = get_args(type(make_task(task)).model_fields["physics"].annotation)
    rows = {row["physics"]: row for row in RESULTS if row["policy"] == task}
    assert set(rows) == set(offered)
    assert all("agents" in row or (name == "mjx-warp" and row["not_measured"]) for name, row in rows.items())
