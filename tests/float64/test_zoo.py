"""Robots of others, from the packages that are installed, against native MuJoCo.

`experiments/other_robots.py` compares all that the tree takes; here is one that compiles within seconds.
"""

import json

import pytest
from other_robots import RECORD, difference, file_of, read

from humanoid_mjx.mechanics.tree.folding import fold
from humanoid_mjx.mechanics.tree.reading import read_tree
from humanoid_mjx.mechanics.tree.refusing import faults

ROWS = {row["model"]: row for row in json.loads(RECORD.read_text(encoding="utf-8"))["rows"]}


def model_of(name):
    file = file_of(name)
    if file is None or not file.is_file():
        pytest.skip("its package is not installed")
    return read(file)[0]


@pytest.mark.parametrize("name", ROWS)
def test_models_are_taken_or_refused_as_the_record_says(name):
    assert [fault.what for fault in faults(model_of(name))] == ROWS[name].get("refused", [])


def test_the_record_holds_what_is_said_of_it():
    """All models that are taken move as in MuJoCo, 24 of them in all states: one has states with more contacts between
    bodies than a world has room for, which are left out."""
    taken = [row for row in ROWS.values() if "refused" not in row]
    assert sum(not row["unsettled"] for row in taken) >= 24
    assert {row["model"] for row in taken if row["unsettled"]} <= {"benchmarks/unitree_g1/scene_flat.xml"}
    assert max(max(row["acceleration"], row["velocity"]) for row in taken) < 1e-9


def test_a_model_moves_as_in_mujoco():
    found = difference(model_of("gymnasium/half_cheetah"))
    assert not found["unsettled"] and max(found["acceleration"], found["velocity"]) < 1e-9


def test_legs_on_fixed_bodies_are_lanes():
    """The ant's hips turn against bodies that are fixed to its torso."""
    assert fold(read_tree(model_of("gymnasium/ant"))).lanes == 4
