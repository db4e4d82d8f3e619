"""A list of all findings of `reproduce`, `data/findings.json`, and what turns the verdict of each.

Where numbers are compared within a tolerance, another number does, and is tried here on every finding. The verdict on
each other claim is turned by a test that is named here. `python tests/reproduction/test_turns.py FOLDER` writes the
list anew from what `reproduce --out FOLDER` found.
"""

import json
import sys
from pathlib import Path

import numpy as np
import pytest

from humanoid_mjx.reproduction import errata, load_experiments, reproduce
from humanoid_mjx.reproduction.findings import compare

TESTS = Path(__file__).parents[1]
LIST = TESTS / "data" / "findings.json"
FINDINGS = json.loads(LIST.read_text())

ANOTHER_VALUE = "test_another_value_turns_the_verdict"
TURNED_BY = {
    ("control-7d", "errors"): "test_a_controller_that_leaves_nothing_agrees_with_errors_of_nothing",
    ("epsilon-7e", ""): "test_the_pooled_marks_tell_epsilon",
    ("errata", ""): "test_a_printed_formula_that_is_right_is_reproduced",
    ("figure-7.2", "straight walking: how thick"): "test_a_hemisphere_would_be_seen",
    ("figure-7.3", "sudden turn: share"): "test_a_hemisphere_would_be_seen",
    **{
        (f"figure-7.{n}", f"joint {n - 5}: overshoot"): "test_other_gains_are_no_longer_the_printed_ones"
        for n in range(6, 11)
    },
    **{(f"figure-7.{n}", ""): ANOTHER_VALUE for n in (11, 12, 13, 14, 15, 16, 17)},
    ("figure-7.18", "section 7H: goal of the right knee"): "test_the_sign_of_the_knee",
    **{
        ("figure-7.18", f"section {section}: settling time, s, and energy"): (
            "test_dynamics_are_involved_unless_the_mass_changes_nothing"
        )
        for section in ("6.4", "7H")
    },
    # Postures are judged in one way at the start and at the goal.
    ("figure-7.18", "section 6.4: joints of both legs outside"): ANOTHER_VALUE,
    ("figure-7.18", "section 7H: joints of both legs outside"): ANOTHER_VALUE,
    ("finding-decay", ""): "test_the_declared_decay_never_arrives",
    ("finding-negative-reward", ""): "test_stepping_back_turns_with_the_share_that_does_not",
    ("finding-singularity", "the least stiffness"): "test_a_straight_leg_locks_where_nothing_pushes_it_aside",
    **{("finding-singularity", begin): ANOTHER_VALUE for begin in ("walking straight", "the sudden turn", "share of")},
    ("finding-waiting", ""): "test_waiting_turns_with_the_share_that_arrives",
    ("gaits-4.8", ""): "test_gaits_that_walk_and_turn_are_reproduced",
    ("ground-control", ""): "test_rolls_that_help_against_pushes_from_the_side_would_be_found",
    ("motor-sizing", ""): ANOTHER_VALUE,
    ("resonance-5.6", ""): "test_gains_against_their_bound",
    ("responses-5.2", ""): "test_critical_damping_is_the_fastest_without_overshoot",
    ("robustness-5.7", ""): "test_computed_torque_can_lose",
}
"""Tests by experiment and the beginning of a quantity."""


def numeric(finding):
    """True if numbers of one shape are compared within a tolerance."""
    try:
        printed, found = (np.array(finding[key], float) for key in ("printed", "reproduced"))
    except (TypeError, ValueError):
        return False
    return printed.shape == found.shape and bool(finding["tolerance"])


def names_of_tests():
    return {line[4:].partition("(")[0] for file in TESTS.rglob("test_*.py") for line in file.read_text().splitlines()}


@pytest.mark.parametrize("name", dict.fromkeys(finding["name"] for finding in FINDINGS))
def test_every_finding_has_something_that_turns_it(name):
    exist = names_of_tests()
    for finding in (finding for finding in FINDINGS if finding["name"] == name and finding["verdict"] != "finding"):
        by = [test for (experiment, begin), test in TURNED_BY.items()
              if experiment == name and finding["quantity"].startswith(begin)]  # fmt: skip
        assert numeric(finding) or (len(by) == 1 and by[0] in exist), finding["quantity"]


@pytest.mark.parametrize(
    "finding", [f for f in FINDINGS if numeric(f)], ids=lambda f: f"{f['name']} {f['quantity']}"[:60]
)
def test_another_number_turns_the_verdict(finding):
    printed, tolerance = np.array(finding["printed"], float), finding["tolerance"]
    agreed = finding["verdict"] in ("reproduced", "recovered", "consistent")
    assert compare("", printed, printed, tolerance, "").verdict == "reproduced"
    moved = printed.copy()
    moved.flat[-1] += 1.01 * tolerance
    assert compare("", printed, moved, tolerance, "").verdict == "differs"
    # The list rounds what was found, at most to the last of three digits.
    away = np.abs(np.array(finding["reproduced"], float) - printed).max()
    assert (away <= tolerance) if agreed else (away >= 0.99 * tolerance)


def test_the_list_has_what_the_experiments_find(tmp_path):
    assert {finding["name"] for finding in FINDINGS} == set(load_experiments())
    cheap = ["workspace-7b", "figure-7.1", "table-5.1", "resonance-5.6", "responses-5.2", "table-7.1", "figure-7.12"]
    live = {(f.name, f.quantity, f.verdict) for f in reproduce([*cheap, "table-4.2", "figure-7.17"], tmp_path)}
    listed = {(f["name"], f["quantity"], f["verdict"]) for f in FINDINGS}
    assert live == {each for each in listed if each[0] in {name for name, *_ in live}}
    assert {q for name, q, _ in listed if name == "errata"} == {entry.place for entry in errata.ENTRIES}


if __name__ == "__main__":
    rows = json.loads((Path(sys.argv[1]) / "reproduce.json").read_text())
    kept = [{key: value for key, value in row.items() if key != "why"} for row in rows]
    LIST.write_text("[\n" + ",\n".join(map(json.dumps, kept)) + "\n]\n")
