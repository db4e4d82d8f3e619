"""Tasks and learners of a user's own, named by their import path."""

import json
import shutil
import subprocess
import sys
from pathlib import Path
from typing import ClassVar

import jax
import jax.numpy as jnp
import pytest
from command_line import told
from hop import Hop

from humanoid_mjx import InputError, spec
from humanoid_mjx.spec import traced
from humanoid_mjx.tasks.check import check_task
from humanoid_mjx.tasks.continuous import ContinuousTask

DATA = Path(__file__).parents[1] / "data"
LEARNER = {"name": "hop:BoldQ", "envs": 16, "rollout": 8, "discount": 0.9, "evaluations": 2, "learning_rate": 0.01}
CONFIG = {"name": "hop", "task": {"name": "hop:Hop"}, "learner": LEARNER, "total_steps": 1024, "record": 1, "seeds": 1}
SCRIPT = Path(sys.executable).parent / "humanoid-mjx"


def command(folder, *words):
    """A command typed in a folder, in a process of its own, whose Python does not know the modules of the tests."""
    return subprocess.run([SCRIPT, *words], cwd=folder, capture_output=True, text=True)


@pytest.fixture(scope="module")
def own(tmp_path_factory):
    """A folder with a user's own module and config, and the run folder and policy that were made there."""
    folder = tmp_path_factory.mktemp("own")
    shutil.copy(DATA / "hop.py", folder / "hop.py")
    (folder / "my.yaml").write_text(json.dumps(CONFIG))
    for words in (("sweep", "my.yaml", "--out", "run"), ("export", "run", "hop.npz")):
        done = command(folder, *words)
        assert done.returncode == 0, done.stderr
    return folder


def test_what_they_learned_is_found_again_from_any_folder(own, tmp_path):
    """In one's own folder by itself, as the fixture has exported; elsewhere where one says so."""
    few, again = ("--episodes", "2"), str(tmp_path / "again.npz")
    run, policy = str(own / "run"), str(own / "hop.npz")
    for words in (("export", run, again), ("evaluate", policy, *few)):
        done = command(tmp_path, *words, "--trust")
        assert done.returncode == 0, done.stderr
    for folder, words, code in (
        (own, ("evaluate", "hop.npz", *few), 0),
        (tmp_path, ("export", run, again), 2), (tmp_path, ("evaluate", policy, *few), 2),
    ):  # fmt: skip
        done = command(folder, *words)
        assert done.returncode == code and ("'hop:Hop' is code that is neither" in done.stderr) == bool(code)
    done = command(tmp_path, "sweep", str(own / "my.yaml"), "--resume", "--out", str(own / "run"))
    assert done.returncode == 0, done.stderr


@pytest.mark.parametrize(
    ("name", "inside", "runs"),
    [
        ("humanoid_mjx.tasks.joint_reach:JointReach", "", True),
        ("mine:Task", "", True),
        ("pack.deep.mine:Task", "", True),
        ("mine:Task", "run", False),  # comes with the run folder
        ("antigravity:Task", "", False),
        ("numpy.testing:Task", "", False),
        ("os:Task", "", False),
        ("__main__:Task", "", False),
        ("nowhere:Task", "", True),  # and then cannot be imported
    ],
)
def test_only_ones_own_modules_are_run(name, inside, runs, tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    monkeypatch.setattr(sys, "path", list(sys.path))
    place = tmp_path / inside / name.partition(":")[0].replace(".", "/")
    if name.startswith(("mine", "pack")):
        place.parent.mkdir(parents=True, exist_ok=True)
        place.with_suffix(".py").write_text("raise SystemExit('it ran')")
    (tmp_path / "run").mkdir(exist_ok=True)
    refused = "neither this package's nor below the working directory; add --trust"
    with spec.own_modules_only(tmp_path / "run"), spec.modules_in(str(tmp_path / inside)):
        with pytest.raises((InputError, SystemExit)) as caught:
            spec.find("task", {}, ContinuousTask, name)
        assert (refused in str(caught.value)) == (not runs)
        assert "antigravity" not in sys.modules
    sys.modules.pop("pack", None), sys.modules.pop("pack.deep", None)


def test_a_config_that_one_looks_at_runs_nothing_from_elsewhere(tmp_path, monkeypatch):
    (tmp_path / "there").mkdir()
    (tmp_path / "here").mkdir()
    monkeypatch.chdir(tmp_path / "here")
    (tmp_path / "there/nasty.py").write_text("open('ran', 'w')")
    task = {"name": "nasty:Task"}
    (tmp_path / "there/x.yaml").write_text(json.dumps(CONFIG | {"task": task}))
    for words in (["info", "../there/x.yaml"], ["info", "../there/x.yaml", "--keys"]):
        with pytest.raises(InputError, match="add --trust"):
            told(*words)
    assert not Path("ran").exists()
    help_text = told("--help")
    assert "--trust" in help_text and "may name code" in help_text


def test_import_paths_are_searched_in_the_working_directory_and_the_error_says_where(own, tmp_path):
    shown = command(own, "info", "hop:Hop", "--keys")
    assert shown.returncode == 0 and "task.stride" in shown.stdout, shown.stderr
    refused = command(tmp_path, "info", "hop:Hop", "--keys")
    assert refused.returncode == 2
    assert f"No module named 'hop' on Python's path or in {tmp_path}." in refused.stderr


class WrongSize(Hop):
    observation_size: ClassVar = 2


class NoState(Hop):
    def step(self, state, action, key):
        return state.data


class OtherDtype(Hop):
    def step(self, state, action, key):
        after = super().step(state, action, key)
        return after._replace(data=(after.data[0], after.data[1].astype(jnp.float32)))


class OtherTerms(Hop):
    def step(self, state, action, key):
        return super().step(state, action, key)._replace(metrics={})


class NoStep(Hop):
    step = Hop.__base__.step


class ShapedByAValue(Hop):
    hops: int = traced(3)

    def step(self, state, action, key):
        return super().step(state, action, key)._replace(reward=jnp.ones(self.hops).sum())


class BranchOnAValue(Hop):
    def step(self, state, action, key):
        if self.stride > 0.1:
            return super().step(state, action, key)
        return state


FAULTS = {
    ShapedByAValue: r"ShapedByAValue lets an array's shape or a Python branch depend on a traced value .* make that",
    BranchOnAValue: r"BranchOnAValue lets .* \(test_own_tasks.py, line \d+: if self.stride > 0.1:\)",
    WrongSize: r"WrongSize.reset must return obs of shape \(2,\), got \(1,\)",
    NoState: r"NoState.step must return a State, got a tuple",
    OtherDtype: r"OtherDtype.step must return data\[1\] as reset does, int32\[\], got float32\[\]",
    OtherTerms: r"OtherTerms.step must return a state of the structure that reset returns",
    NoStep: r"NoStep must implement step",
}


@pytest.mark.parametrize("fault", FAULTS, ids=lambda cls: cls.__name__)
def test_a_task_that_breaks_the_protocol_gets_one_sentence(fault):
    check_task(Hop())
    with pytest.raises(InputError, match=FAULTS[fault]) as caught:
        check_task(fault())
    assert "\n" not in str(caught.value) and str(caught.value).endswith(".")


def test_an_episode_begins_with_nothing_won():
    state = Hop().reset(jax.random.key(0))
    assert state.reward == state.metrics["ahead"] == 0.0 and not (state.terminated | state.truncated | state.success)


class OfTheirOwn(Hop):
    def step(self, state, action, key):
        return state.data[0] + None


def test_errors_of_other_kinds_are_left_as_they_are():
    with pytest.raises(TypeError, match="NoneType"):
        check_task(OfTheirOwn())
