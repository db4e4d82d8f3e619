"""`benchmarks/mutants.py` makes faults where there is arithmetic, each one alone."""

from pathlib import Path

import mutants
import pytest

SOURCE = """
class Task:
    size: int = Field(3, ge=1)

    def step(self, x: "Array[3]") -> int:
        return x + 2 if not x < 1 else -x
"""


def test_every_mutant_has_one_fault(tmp_path, monkeypatch):
    monkeypatch.setattr(mutants, "ROOT", tmp_path)
    (tmp_path / "task.py").write_text(SOURCE)
    found = list(mutants.mutants(Path("task.py")))
    assert {mutant.change for mutant in found} == {
        "x + 2  ->  x - 2",
        "2  ->  3",
        "not x < 1  ->  not not x < 1",
        "x < 1  ->  x <= 1",
        "1  ->  2",
        "-x  ->  --x",
    }
    assert len({mutant.text for mutant in found}) == len(found)


@pytest.mark.parametrize("file", ["learners/targets.py", "tasks/legged/events.py"])
def test_a_file_is_tested_by_those_that_import_it(file):
    assert set(mutants.tests_of(Path("humanoid_mjx") / file)) & {"tests/test_approximate.py", "tests/test_legged.py"}
