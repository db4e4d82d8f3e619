"""The lines of docs/results.md: each gives the same means, by whichever of its tools is installed."""

import re
from pathlib import Path

import numpy as np
import pytest
from docs_reader import blocks

from humanoid_mjx import sweep

TEXT = (Path(__file__).parent.parent / "docs" / "results.md").read_text(encoding="utf-8")
LINES = {block.text.partition(".")[0]: block.text.strip() for block in blocks(TEXT)}

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


@pytest.mark.parametrize("name", VALUES)
def test_each_line_gives_the_means(run, name, monkeypatch):
    tool = pytest.importorskip({"pq": "pyarrow.parquet"}.get(name, name))
    monkeypatch.chdir(run.path.parent.parent)
    epsilon, success = VALUES[name](eval(LINES[name], {name: tool}))
    values = np.unique(run.summary["learner.epsilon"])
    means = [run.summary["greedy_success"][run.summary["learner.epsilon"] == value].mean() for value in values]
    assert len(set(means)) > 1, "the run tells the values apart"
    order = np.argsort(epsilon)  # most of them keep none
    np.testing.assert_allclose(np.asarray(epsilon)[order], values)
    np.testing.assert_allclose(np.asarray(success)[order], means, rtol=1e-6)  # some add in single precision


def test_the_columns_that_the_page_names_are_there(run):
    for name in ("results", "summary", "timing"):
        (row,) = re.findall(rf"^\| `{name}.parquet`.*$", TEXT, re.MULTILINE)
        assert set(re.findall(r"`([a-z_]+)`", row)) <= set(getattr(run, name))
