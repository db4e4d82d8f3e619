"""The table of docs/tasks.md: what policies reach on the physics that they were not trained on."""

import re
from typing import get_args

import pytest
from text_claims import NUMBER, RECORDS, ROOT, Claim, tables

from humanoid_mjx.tasks import make_task

NAME = "cpu_2_cores_other_physics.json"
RESULTS = RECORDS[NAME]["results"]
MEASURED = {(row["policy"], row["physics"]): row["agents"] for row in RESULTS if "agents" in row}


def claims(page):
    """The success, in per cent, and the return of each row, each with its interval."""
    (rows,) = (rows for rows in tables(page) if rows[0][:2] == ["policy of", "physics"])
    for policy, physics, *cells in rows[1:]:
        found = MEASURED[policy.strip("`"), physics.partition(",")[0].strip("`")]
        for cell, (agent, name, factor) in zip(
            cells, (("greedy", "success", 100.0), ("greedy", "return", 1.0), ("random", "success", 100.0)), strict=True
        ):
            values = [found[agent][name], *found[agent][f"{name}_interval"]]
            printed = re.findall(NUMBER, cell)
            assert len(printed) in (1, 3), cell
            for text, value in zip(printed, values, strict=False):
                yield Claim(NAME, f"{policy} on {physics}, {agent} {name}", text, factor * value)


def test_the_table_says_what_the_record_says():
    page = (ROOT / "docs" / "tasks.md").read_text(encoding="utf-8")
    found = list(claims(page))
    assert len({claim.place.partition(",")[0] for claim in found}) >= 3
    assert not [claim for claim in found if not claim.holds]
    assert len([claim for claim in found if claim.printed == "100" and "greedy success" in claim.place])


@pytest.mark.parametrize("task", ["posture_switch", "leg_reach", "stand"])
def test_every_physics_of_a_task_is_in_the_record(task):
    offered = get_args(type(make_task(task)).model_fields["physics"].annotation)
    rows = {row["physics"]: row for row in RESULTS if row["policy"] == task}
    assert set(rows) == set(offered)
    assert all("agents" in row or (name == "mjx-warp" and row["not_measured"]) for name, row in rows.items())
