"""The lines of docs/results.md: each gives the same means, by whichever of its tools is installed."""

import re
from pathlib import Path

import numpy as np
import pytest

from humanoid_mjx import sweep

TEXT = (Path(__file__).parent.parent / "docs" / "results.md").read_text(encoding="utf-8")
LINES = [line.strip() for line in re.findall(r"```python\n(.*?)```", TEXT, re.DOTALL)]

VALUES = {
    "pandas": lambda found: (found.index.to_numpy(), found.to_numpy()),
    "polars": lambda found: (found["learner.epsilon"].to_numpy(), found["greedy_success"].to_numpy()),
    "duckdb": lambda found: tuple(np.array(found.fetchall()).T),
    "pq": lambda found: (found["learner.epsilon"].to_numpy(), found["greedy_success_mean"].to_numpy()),
}


@pytest.fixture(scope="module")
def run(tmp_path_factory):
    config = {
        "name": "joint1",
        "task": {"name": "joint_reach", "joint": 4, "states": 11, "max_episode_steps": 41},
        "learner": {"name": "tabular_q", "epsilon_decay": 0.99},
        "sweep": {"axes": {"learner.epsilon": [0.1, 0.5, 0.9], "learner.learning_rate": [0.05, 0.5]}},
        "seeds": 4,
        "episodes": 60,
    }
    return sweep(config, tmp_path_factory.mktemp("doc") / "runs" / "joint1")


@pytest.mark.parametrize("line", LINES, ids=[line.partition(".")[0] for line in LINES])
def test_each_line_gives_the_means(run, line, monkeypatch):
    name = line.partition(".")[0]
    tool = pytest.importorskip({"pq": "pyarrow.parquet"}.get(name, name))
    monkeypatch.chdir(run.path.parent.parent)
    epsilon, success = VALUES[name](eval(line, {name: tool}))
    summary = run.summary
    values = np.unique(summary["learner.epsilon"])
    means = [summary["greedy_success"][summary["learner.epsilon"] == value].mean() for value in values]
    assert len(set(means)) > 1, "the run tells the values apart"
    order = np.argsort(epsilon)  # most of them keep none
    np.testing.assert_allclose(np.asarray(epsilon)[order], values)
    np.testing.assert_allclose(np.asarray(success)[order], means, rtol=1e-6)  # some add in single precision


def test_every_tool_has_its_line_and_columns_are_there(run):
    assert [line.partition(".")[0] for line in LINES] == list(VALUES)
    for name, table in (("results", run.results), ("summary", run.summary), ("timing", run.timing)):
        (row,) = re.findall(rf"^\| `{name}.parquet`.*$", TEXT, re.MULTILINE)
        named = set(re.findall(r"`([a-z_]+)`", row))
        assert named <= set(table), named - set(table)
