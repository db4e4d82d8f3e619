"""The thesis's Q-learning results: verdicts that are computed, and that turn when the values do."""

import ast
import json
from pathlib import Path

import pytest

import humanoid_mjx
from humanoid_mjx import InputError
from humanoid_mjx.reproduction import judge, load_experiments, reproduce
from humanoid_mjx.reproduction.runner import MODULES

TABLES = ["table-7.1", "table-7.2", "table-7.3"]


def verdicts(findings):
    return [finding.verdict for finding in findings]


def test_the_tables_come_out_with_the_recovered_rate(tmp_path):
    findings = reproduce(TABLES, tmp_path)
    assert verdicts(findings) == ["recovered"] * 3
    for finding, corner in zip(findings, (117.91, 121.692, 106.564), strict=True):
        assert finding.reproduced[-1][-1] == pytest.approx(corner, abs=5e-4)
        assert "learning_rate 0.99 in place of the printed 0.9" in finding.why
    stored = json.loads((tmp_path / "reproduce.json").read_text())
    assert [entry["verdict"] for entry in stored] == ["recovered"] * 3
    assert set(stored[0]) == {"name", "quantity", "printed", "reproduced", "tolerance", "verdict", "why"}


def test_verdicts_of_earlier_calls_stay(tmp_path):
    reproduce(["table-7.2"], tmp_path)
    reproduce(["table-7.1"], tmp_path, ["learner.learning_rate=0.9"])
    reproduce(["table-7.1"], tmp_path)
    stored = json.loads((tmp_path / "reproduce.json").read_text())
    assert [(entry["name"], entry["verdict"]) for entry in stored] == [
        ("table-7.1", "recovered"), ("table-7.2", "recovered")
    ]  # fmt: skip
    assert set(json.loads((tmp_path / "reproduce_times.json").read_text())) == {"table-7.1", "table-7.2"}
    (tmp_path / "reproduce.json").write_text('{"half')
    reproduce(["table-7.1"], tmp_path)
    assert len(json.loads((tmp_path / "reproduce.json").read_text())) == 1


def test_the_tables_do_not_come_out_with_the_printed_rate(tmp_path):
    assert verdicts(reproduce(TABLES, tmp_path, ["learner.learning_rate=0.9"])) == ["differs"] * 3


def test_the_ways_to_the_goal_are_among_many_runs(tmp_path):
    findings = reproduce(["figure-7.11", "figure-7.14"], tmp_path)
    assert all(finding.verdict in ("reproduced", "recovered") for finding in findings), findings
    assert (tmp_path / "figure-7.11.png").is_file() and (tmp_path / "figure-7.14.png").is_file()


def test_the_declared_decay_never_arrives(tmp_path):
    findings = reproduce(["finding-decay"], tmp_path)
    assert verdicts(findings) == ["not_reproducible"] * 3
    assert [finding.reproduced for finding in findings] == [0, 0, 0]
    assert verdicts(reproduce(["finding-decay"], tmp_path, ["learner.epsilon_decay=1.0"])) == ["reproduced"] * 3


def test_judgement():
    assert judge(True, {"a": 1.0}, {"a": 1.0}) == "reproduced"
    assert judge(True, {"a": 2.0}, {"a": 1.0}) == "recovered"
    assert judge(False, {"a": 1.0}, {"a": 1.0}) == "differs"
    assert judge(False, {}, {}, possible=False) == "not_reproducible"


def test_what_cannot_be_reproduced_is_refused(tmp_path):
    with pytest.raises(InputError, match=r"unknown name 'table-7.9'; did you mean 'table-7\.\d'"):
        reproduce(["table-7.9"], tmp_path)
    with pytest.raises(InputError, match=r"table-7.1 has no learner.rate; .*learner.learning_rate"):
        reproduce(["table-7.1"], tmp_path, ["learner.rate=0.9"])
    assert not list(tmp_path.iterdir())


def test_names_are_in_the_order_of_the_thesis():
    figures = [name for name in load_experiments() if name.startswith("figure-7")]
    assert figures == sorted(figures, key=lambda name: int(name.partition(".")[2]))


def test_no_posture_of_the_switch_lies_in_the_ranges(tmp_path):
    findings = reproduce(["figure-7.17"], tmp_path)
    assert verdicts(findings) == ["differs"] * 2
    assert "right hip -20 of -15 to 100, right knee -10 of 0 to 120" in findings[0].why
    assert (tmp_path / "figure-7.17.png").is_file()


PACKAGE = Path(humanoid_mjx.__file__).parent
BELOW = ("thesis", "robot", "mechanics", "control", "physics", "tasks", "learners", "training", "results")


def imported(path):
    """The names of the modules that a file imports, wherever in it."""
    for node in ast.walk(ast.parse(path.read_text())):
        if isinstance(node, ast.ImportFrom):
            yield from (f"{node.module}.{alias.name}" for alias in node.names)
        elif isinstance(node, ast.Import):
            yield from (alias.name for alias in node.names)


def test_nothing_below_imports_from_reproduction():
    files = [path for layer in BELOW for path in (PACKAGE / layer).rglob("*.py")]
    assert len(files) > 50
    wrong = [path.name for path in files if any("humanoid_mjx.reproduction" in name for name in imported(path))]
    assert not wrong


def test_every_module_with_experiments_is_listed():
    holding = [p.stem for p in (PACKAGE / "reproduction").glob("*.py") if "\nEXPERIMENTS = [" in p.read_text()]
    assert sorted(holding) == sorted(MODULES)
