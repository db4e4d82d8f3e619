"""The matrix of docs/faults.md is what its record says, and nothing in the record went wrong."""

import re

from text_claims import RECORDS, ROOT, tables

ROWS = RECORDS["faults.json"]["rows"]


def test_the_page_says_what_the_record_says():
    page = (ROOT / "docs" / "faults.md").read_text(encoding="utf-8")
    (rows,) = (rows for rows in tables(page) if rows[0][0] == "fault")
    printed = {(row[0], row[1]): (row[2], row[3]) for row in rows[1:]}
    assert len(printed) == len(rows) - 1 == len(ROWS)
    for row in ROWS:
        tries, ends = printed[row["fault"], row["subject"]]
        assert tries == f"{row['tries']:,}"
        found = re.findall(r"(\d[\d,]*) (\D+?)(?:, (?=\d)|$)", ends)
        assert {words: int(count.replace(",", "")) for count, words in found} == row["outcomes"], row


def test_every_try_has_an_outcome_and_none_went_wrong():
    for row in ROWS:
        assert sum(row["outcomes"].values()) == row["tries"] > 0
        assert not row["wrong"] and not {"wrong", "traceback", "crashed", "hung", "other bits"} & set(row["outcomes"])


def test_what_was_killed_came_back():
    killed = {row["subject"]: row for row in ROWS if row["fault"].startswith("kill -9")}
    assert all(list(row["outcomes"]) == ["resumed to the same bits"] for row in killed.values())
    assert {learner for learner, row in killed.items() if row["tries"] >= 50} >= {"tabular_q", "linear_q", "brax_ppo"}
