"""The thesis's Q-learning results: verdicts that are computed, and that turn when the values do."""

import json

import pytest

from humanoid_mjx import InputError, compute
from humanoid_mjx.reproduction import reproduce
from humanoid_mjx.reproduction.findings import check

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


def test_a_second_call_adds_to_the_first(tmp_path):
    reproduce(["table-7.2", "table-7.1"], tmp_path)
    first = json.loads((tmp_path / "reproduce.json").read_text())
    (tmp_path / "reproduce_runs.json").write_text("[]")  # that of an earlier version, say
    told = []
    reproduce(["table-7.3", "table-7.1"], tmp_path, ["learner.learning_rate=0.9"], tell=told.append)
    second = json.loads((tmp_path / "reproduce.json").read_text())
    assert [each["name"] for each in second] == TABLES, "in the order of the thesis, each once"
    assert [each["verdict"] for each in second] == ["differs", "recovered", "differs"]
    assert second[1] == next(each for each in first if each["name"] == "table-7.2")
    assert told == ["1 of 2, table-7.3", "2 of 2, table-7.1"]
    (run,) = json.loads((tmp_path / "reproduce_runs.json").read_text())
    assert run["commit"] == compute.commit() and set(run["times"]) == {"table-7.3", "table-7.1"}
    reproduce(["table-7.3"], tmp_path)
    older, newer = json.loads((tmp_path / "reproduce_runs.json").read_text())
    assert list(older["times"]) == ["table-7.1"] and list(newer["times"]) == ["table-7.3"]
    assert newer["machine"] == compute.machine() and newer["times"]["table-7.3"]["cpu_s"] > 0
    (tmp_path / "reproduce.json").write_text("half of a fi")
    with pytest.raises(InputError, match="truncated or damaged"):
        reproduce(["table-7.1"], tmp_path)


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
    def verdict(agrees, used=None, **judged):
        return check("", 1.0, 1.0, agrees, "", values=({"a": used or 1.0}, {"a": 1.0}), **judged).verdict

    assert verdict(True) == "reproduced" and verdict(True, 2.0) == "recovered"
    assert verdict(False) == "differs" and verdict(False, could_differ=False) == "differs"
    assert verdict(False, possible=False) == "not_reproducible"
    assert verdict(True, could_differ=False) == "consistent"


def test_what_cannot_be_reproduced_is_refused(tmp_path):
    with pytest.raises(InputError, match=r"unknown name 'table-7.9'; did you mean 'table-7\.\d'"):
        reproduce(["table-7.9"], tmp_path)
    with pytest.raises(InputError, match=r"table-7.1 has no learner.rate; .*learner.learning_rate"):
        reproduce(["table-7.1"], tmp_path, ["learner.rate=0.9"])
    assert not list(tmp_path.iterdir())
