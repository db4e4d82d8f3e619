"""Trainings that go on in a changed world: the key `then`."""

import shutil

import numpy as np
import pytest
from command_line import told
from small_sweep import CONFIG, assert_same_tables, write_config

from humanoid_mjx import InputError
from humanoid_mjx.commands import slurm
from humanoid_mjx.commands.info import show_info
from humanoid_mjx.config import parse
from humanoid_mjx.runs.listing import list_runs
from humanoid_mjx.training.sweep import Run, sweep

FURTHER = {"task": {"goal": -15.0}, "learner": {"epsilon_decay": 0.9}, "episodes": 30}
MOVED = CONFIG | {"then": FURTHER}


@pytest.fixture(scope="module")
def moved(tmp_path_factory):
    return sweep(MOVED, tmp_path_factory.mktemp("moved") / "run", quiet=True)


def assert_same_rows(run, other):
    """The tables of two runs hold the same, of configs that begin from the runs of different folders."""
    for one, two in (run.results, other.results), (run.summary, other.summary):
        assert one.keys() == two.keys()
        for name in one.keys() - {"learner.start_from"}:
            np.testing.assert_array_equal(one[name], two[name], name)


def test_it_trains_what_two_sweeps_by_hand_train(moved, tmp_path):
    first = sweep(CONFIG, tmp_path / "first", quiet=True)
    by_hand = {
        "task": CONFIG["task"] | FURTHER["task"],
        "learner": CONFIG["learner"] | FURTHER["learner"] | {"start_from": str(first.path)},
        "episodes": 30,
    }
    assert_same_tables(moved.path, first.path)
    assert_same_rows(moved.later, sweep(CONFIG | by_hand, tmp_path / "second", quiet=True))
    assert first.later is None and moved.config.then == FURTHER and moved.later.config.task["goal"] == -15.0


def test_a_short_training_has_as_many_points_as_it_can():
    further = [parse(CONFIG | {"then": then}).later("run") for then in (FURTHER, {"episodes": 4})]
    assert [(each.record, each.learner["start_from"]) for each in further] == [(10, "run"), (4, "run")]


def test_a_sweep_that_ended_between_both_goes_on_with_the_second(moved, tmp_path):
    shutil.copytree(moved.path, tmp_path / "run")
    shutil.rmtree(tmp_path / "run" / "then")
    again = sweep(MOVED, tmp_path / "run", resume=True, quiet=True)
    assert_same_rows(again.later, moved.later)
    assert_same_rows(sweep(MOVED, again.path, resume=True, quiet=True).later, moved.later)


def test_the_config_of_the_run_folder_resumes_both(moved, tmp_path):
    run = tmp_path / "run"
    shutil.copytree(moved.path, run)
    shutil.rmtree(run / "then")
    (listed,), _ = list_runs(tmp_path)
    assert listed.state == "interrupted"
    told("sweep", run / "config.yaml", "--out", run, "--resume")
    assert_same_rows(Run(run).later, moved.later)
    with pytest.raises(InputError, match=r"made with another config \(then.task.goal differs\)"):
        sweep(CONFIG | {"then": {**FURTHER, "task": {"goal": -10.0}}}, run, resume=True, quiet=True)
    with pytest.raises(InputError, match=r"made with another config \(then differs\)"):
        sweep(CONFIG, run, resume=True, quiet=True)


def test_a_finished_sweep_can_train_on(moved, tmp_path):
    sweep(CONFIG, tmp_path / "run", quiet=True)
    again = sweep(MOVED, tmp_path / "run", resume=True, quiet=True)
    assert_same_rows(again.later, moved.later)
    assert again.config.then == FURTHER


def test_a_run_folder_that_stands_elsewhere_now_is_resumed(moved, tmp_path):
    shutil.copytree(moved.path, tmp_path / "elsewhere")
    again = sweep(MOVED, tmp_path / "elsewhere", resume=True, quiet=True)
    assert_same_rows(again.later, moved.later)
    parts = {name: CONFIG[name] | FURTHER[name] for name in ("task", "learner")}
    other = CONFIG | FURTHER | parts | {"learner": parts["learner"] | {"start_from": str(again.path)}}
    with pytest.raises(InputError, match="made with another config"):
        sweep(other, moved.path / "then", resume=True, quiet=True)


@pytest.mark.parametrize(
    ("then", "words"),
    [
        ({"seeds": 3}, r"then.seeds: unknown key; what may change is task, learner, episodes, total_steps, record"),
        ({"learner": {"epsilon": 0.1}}, r"then.learner.epsilon: is an axis of the sweep; leave it out here or there"),
        ({"learner": 3}, r"then.learner.epsilon: is an axis of the sweep"),
        (
            {"learner": {"start_from": "runs/a"}},
            r"then: goes on from the first training; leave learner.start_from out here and there",
        ),
        ({"task": {"goal": -12.0}}, r"config: then: task: from -20 the goal -12 cannot be hit"),
        ({"task": {"gaol": 5.0}}, r"config: then: task.gaol: unknown key"),
        ({"task": {"states": 14}}, r"config: then: what it learns has another size than before"),
        ({"total_steps": 30}, r"config: then: .*total_steps"),
    ],
)
def test_what_cannot_be_is_said_before_anything_trains(then, words, tmp_path):
    with pytest.raises(InputError, match=words):
        sweep(CONFIG | {"then": then}, tmp_path / "run", quiet=True)
    assert not (tmp_path / "run").exists()
    with pytest.raises(InputError, match=words.removeprefix("config: ")):
        show_info(write_config(tmp_path, then=then), (), False)


def test_an_axis_of_runs_to_start_from_would_undo_it(moved):
    axes = {"learner.start_from": [str(moved.path)]}
    with pytest.raises(
        InputError, match=r"then: goes on from the first training; leave learner.start_from out here and there"
    ):
        parse(MOVED | {"sweep": {"axes": axes}})


def test_a_second_training_that_a_kill_ended_is_listed(moved, tmp_path):
    run = tmp_path / "run"
    shutil.copytree(moved.path, run)
    shutil.rmtree(run / "then" / "checkpoint")
    (run / "then" / "provenance.json").unlink()
    listed, _ = list_runs(tmp_path)
    assert [(each.path, each.state) for each in listed] == [(run, "finished"), (run / "then", "interrupted")]
    assert "run/then (small)" in told("runs", tmp_path)


def test_the_command_tells_of_both_and_slurm_of_neither(tmp_path, monkeypatch):
    config = write_config(tmp_path, then=FURTHER)
    output = told("sweep", config, "--out", tmp_path / "run")
    for run in tmp_path / "run", tmp_path / "run" / "then":
        assert f"{run / 'summary.parquet'}" in output and Run(run).summary["point"].size == 18
    assert f"next: humanoid-mjx report {tmp_path / 'run' / 'then'}" in output
    monkeypatch.setattr(slurm, "package", lambda *_: None)
    with pytest.raises(InputError, match=r"then: --slurm trains one part"):
        slurm.submit_sweep(str(config), tmp_path / "jobs", [], False, [], ["cluster=local"])
