"""Run folders of strangers and of odd file systems: links that lead out, pipes, no locks, numbers that are not finite.

A command that opened a pipe would wait forever; the time limit of these tests is the suite's.
"""

import errno
import fcntl
import json
import os
import shutil
import socket
from pathlib import Path

import numpy as np
import pytest
import small_sweep
from small_sweep import assert_same_tables

from humanoid_mjx import InputError, sweep
from humanoid_mjx.evaluation.policy import find_policy, policies_of_best
from humanoid_mjx.files import whole_file
from humanoid_mjx.runs.folder import read_config
from humanoid_mjx.runs.listing import list_runs

CONFIG = small_sweep.CONFIG | {"sweep": {"axes": {"learner.epsilon": [0.2, 0.6]}}, "seeds": 2, "episodes": 20}
PART = "checkpoint/part-00000.npz"
COMMANDS = (
    ["report", "run", "--no-motion"],
    ["plot", "run"],
    ["evaluate", "run"],
    ["play", "run"],
    ["export", "run", "x.npz"],
    ["sweep", "small.yaml", "--resume", "--out", "run"],
)


@pytest.fixture(scope="module")
def finished(tmp_path_factory):
    return sweep(CONFIG, tmp_path_factory.mktemp("foreign") / "run").path


@pytest.fixture
def run(finished, tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    Path("small.yaml").write_text(json.dumps(CONFIG))
    return Path(shutil.copytree(finished, "run"))


def refused(said, words):
    """Every command says the same sentence, and the list of runs goes on."""
    for command in COMMANDS:
        code, _, err = said(*command)
        assert code == 2 and err.startswith(f"error: {words}") and err.count("\n") == 1, (command, err)
    assert [problem.startswith(words) for problem in list_runs(Path())[1]] == [True]


@pytest.mark.parametrize(
    "name", ["checkpoint", PART, "config.yaml", "results.parquet", "provenance.json", ".lock", "figures"]
)
def test_a_link_that_leads_out_of_a_run_folder_is_refused(run, said, name):
    """Nothing is written where it leads."""
    outside = Path(".outside")
    (run / name).rename(outside) if (run / name).exists() else outside.mkdir()
    (run / name).symlink_to(outside.resolve())
    before = sorted(map(str, outside.rglob("*")))
    refused(said, f"run/{name}: this link leads out of run; ")
    assert sorted(map(str, outside.rglob("*"))) == before


def test_links_within_a_run_folder_and_to_one_are_none_of_these(run, finished):
    (run / PART).rename(run / "stored.npz")
    (run / PART).symlink_to("../stored.npz")
    Path("other").symlink_to(run.resolve())
    assert read_config(Path("other")) and find_policy(Path("other"))
    assert_same_tables(sweep(CONFIG, Path("other"), resume=True).path, finished)


@pytest.mark.parametrize("resume", [False, True])
def test_a_folder_that_is_only_begun_holds_no_such_link_either(tmp_path, resume):
    run, outside = tmp_path / "run", tmp_path / "outside"
    for folder in (run, outside):
        folder.mkdir()
    (run / "checkpoint").symlink_to(outside)
    with pytest.raises(InputError, match="run/checkpoint: this link leads out of"):
        sweep(CONFIG, run, resume=resume)
    assert not list(outside.iterdir()) and not (run / "config.yaml").exists()


def test_what_a_kill_left_may_be_a_link_and_is_not_followed(tmp_path):
    """A temporary file, and the file that takes its place."""
    outside, path = tmp_path / "outside", tmp_path / "found.json"
    outside.write_text("mine")
    for link in (tmp_path / ".new-found.json", path):
        link.symlink_to(outside)
    with whole_file(path) as temporary:
        temporary.write_text("new")
    assert outside.read_text() == "mine" and path.read_text() == "new" and not path.is_symlink()


@pytest.mark.parametrize("make", [os.mkfifo, lambda path: socket.socket(socket.AF_UNIX).bind(str(path))])
@pytest.mark.parametrize("name", [PART, "config.yaml", "provenance.json", "summary.parquet", ".lock"])
def test_a_pipe_in_a_run_folder_is_refused(run, said, name, make):
    (run / name).unlink()
    make(run / name)
    refused(said, f"run/{name}: this is a pipe, a socket or a device")


@pytest.mark.parametrize(
    ("command", "words"),
    [
        (["info", "pipe.yaml"], "pipe.yaml: this is a pipe"),
        (["info", "pipe.yaml", "--keys"], "pipe.yaml: this is a pipe"),
        (["info", "pipe.xml"], "pipe.xml: this is a pipe"),
        (["sweep", "pipe.yaml"], "pipe.yaml: this is a pipe"),
        (["sweep", "pipe"], "pipe: this is a pipe"),
        (["evaluate", "pipe.npz"], "pipe.npz: this is a pipe"),
        (["export", "pipe", "x.npz"], "pipe: this is a pipe"),
        (["export", "posture_switch", "pipe.npz"], "pipe.npz: this is a pipe"),
        (["bench", "compare", "pipe", "pipe"], "pipe: not a result of"),
        (["info", "/dev/zero"], "/dev/zero: this is a pipe"),
        (["evaluate", "posture_switch", "--json", "/dev/null"], "--json /dev/null: this is a pipe or device"),
    ],
)
def test_a_pipe_or_device_in_the_place_of_a_file_is_refused(said, tmp_path, monkeypatch, command, words):
    monkeypatch.chdir(tmp_path)
    for name in ("pipe", "pipe.yaml", "pipe.xml", "pipe.npz"):
        os.mkfifo(name)
    code, _, err = said(*command)
    assert code == 2 and err.startswith(f"error: {words}") and err.count("\n") == 1, err


@pytest.mark.parametrize("content", ["name: x".encode("utf-16"), b"\xff\xfe\x00", "naïve: 1".encode("latin-1")])
def test_text_that_is_not_utf_8_is_refused(said, tmp_path, monkeypatch, content):
    monkeypatch.chdir(tmp_path)
    for name in ("x.yaml", "x.json"):
        Path(name).write_bytes(content)
    for command in (["info", "x.yaml"], ["info", "x.yaml", "--keys"], ["sweep", "x.yaml"]):
        code, _, err = said(*command)
        assert code == 2 and err == "error: x.yaml: cannot be read as text: it is not UTF-8; save it as UTF-8.\n", err
    code, _, err = said("bench", "compare", "x.json", "x.json")
    assert code == 2 and err.startswith("error: x.json: not a result of `bench --json`"), err


@pytest.mark.parametrize("code", [errno.ENOLCK, errno.ENOSYS, errno.ENOTSUP])
def test_a_file_system_without_locks_gets_a_warning(tmp_path, monkeypatch, caplog, code):
    def flock(handle, kind):
        raise OSError(code, os.strerror(code))

    monkeypatch.setattr(fcntl, "flock", flock)
    run = sweep(CONFIG, tmp_path / "run").path
    (warning,) = caplog.messages
    assert warning.startswith(f"{run}: this file system has no locks; ") and not list_runs(run)[1]


def test_an_unknown_fault_of_locks_is_no_warning(tmp_path, monkeypatch):
    def flock(handle, kind):
        raise OSError(errno.EIO, os.strerror(errno.EIO))

    monkeypatch.setattr(fcntl, "flock", flock)
    with pytest.raises(InputError, match="run: cannot be written: Input/output error"):
        sweep(CONFIG, tmp_path / "run")


def spoiled(run, **changes):
    """The part of a run folder with other arrays; a function of each gives them."""
    with np.load(run / PART) as file:
        arrays = dict(file)
    for name, change in changes.items():
        (full,) = (each for each in arrays if each.startswith(name.replace("_", ".", 1)))
        arrays[full] = change(arrays[full])
    np.savez(run / PART, **arrays)


def with_nan(policies):
    policies = policies.copy()
    policies.reshape(len(policies), -1)[:, 0] = np.nan
    return policies


def test_policies_that_are_not_finite_are_refused_by_all_that_load_them(run, said):
    """A part of runs that did not diverge is damaged, then; one of runs that did is not."""
    spoiled(run, policy=with_nan)
    words = "run: the run of point "
    for command in (["evaluate", "run"], ["play", "run"], ["export", "run", "x.npz"], ["export", "run", "x.c"]):
        code, _, err = said(*command)
        assert code == 2 and err.startswith(f"error: {words}") and err.count("\n") == 1, err
        assert "holds numbers that are not finite, in policy" in err
    with pytest.raises(InputError, match="holds numbers that are not finite"):
        policies_of_best(run)
    with pytest.raises(
        InputError, match=r"part-00000\.npz: it holds numbers that are not finite, in policy.*remove it"
    ):
        sweep(CONFIG, run, resume=True)
    config = CONFIG | {"learner": CONFIG["learner"] | {"start_from": "run"}}
    with pytest.raises(InputError, match=r"learner\.start_from: run: a policy holds numbers that are not finite"):
        sweep(config, "later")
    spoiled(run, final_diverged=np.ones_like)
    assert (sweep(CONFIG, run, resume=True).summary["greedy_success"] >= 0).all()
