"""Faults of files, memory and machines: nothing is lost, nothing is taken for something else, one sentence each.

`experiments/faults.py` tries many more of them; these are the ones that once got by, on small trainings.
"""

import errno
import io
import json
import os
import re
import shutil
import threading
from collections import deque
from pathlib import Path

import jax
import numpy as np
import pyarrow.parquet as pq
import pytest
import small_sweep
from fault_configs import bomb_texts
from small_sweep import assert_same_tables

from humanoid_mjx import InputError, sweep
from humanoid_mjx.config import config_digest, load, parse, parse_yaml
from humanoid_mjx.evaluation.policy import find_policy
from humanoid_mjx.files import whole_file
from humanoid_mjx.report.style import figure
from humanoid_mjx.runs.archive import DAMAGE, read_archive
from humanoid_mjx.runs.folder import RunFolder, read_arrays, read_config, read_provenance
from humanoid_mjx.runs.listing import list_runs
from humanoid_mjx.runs.tables import column_names, read_table
from humanoid_mjx.training import pool as pool_module
from humanoid_mjx.training.plan import make_plan, resolved
from humanoid_mjx.training.pool import Pool
from humanoid_mjx.training.progress import Reporter

CONFIG = small_sweep.CONFIG | {"sweep": {"axes": {"learner.epsilon": [0.2, 0.6]}}, "seeds": 4, "episodes": 40}


@pytest.fixture(scope="module")
def finished(tmp_path_factory):
    return sweep(CONFIG, tmp_path_factory.mktemp("faults") / "run").path


@pytest.fixture
def run(finished, tmp_path):
    return Path(shutil.copytree(finished, tmp_path / "run"))


def test_an_array_that_became_shorter_is_damaged(tmp_path):
    """One bit makes (1014,) of (9014,), and numpy reads no further."""
    path = tmp_path / "part.npz"
    np.savez(path, point=np.arange(9014, dtype=np.int32))
    data = path.read_bytes()
    assert data.count(b"(9014,)") == 1
    path.write_bytes(data.replace(b"(9014,)", b"(1014,)"))
    assert len(np.load(path)["point"]) == 1014, "numpy notices by itself"
    with pytest.raises(DAMAGE):
        read_archive(path)
    np.savez(path, a=np.zeros((2, 3), order="F"), b=np.array("text"), c=np.zeros((0, 2)), d=np.float32(2.0))
    read, wanted = read_archive(path), dict(np.load(path))
    assert {name: (a.shape, a.dtype, a.tobytes()) for name, a in read.items()} == {
        name: (a.shape, a.dtype, a.tobytes()) for name, a in wanted.items()
    }


def test_a_table_with_a_flipped_bit_is_damaged(run):
    """Without sums of its pages parquet gives other numbers. Every tenth byte of what is not the footer."""
    path = run / "results.parquet"
    whole, expected = path.read_bytes(), read_table(path)
    footer = int.from_bytes(whole[-8:-4], "little") + 8
    for place in range(4, len(whole) - footer, 10):
        data = bytearray(whole)
        data[place] ^= 8
        path.write_bytes(bytes(data))
        try:
            found = read_table(path)
        except InputError:
            continue
        assert all(found[name].tolist() == expected[name].tolist() for name in expected if name != "steps")


def test_what_a_kill_leaves_before_the_config_is_no_obstacle(tmp_path):
    for number, resume in enumerate((True, False)):
        run = tmp_path / f"run-{number}"
        (run / "checkpoint").mkdir(parents=True)
        (run / ".lock").touch()
        (run / ".new-config.yaml").write_text("name: sm")
        assert len(sweep(CONFIG, run, resume=resume).summary["point"]) == 8
    (tmp_path / "mine/checkpoint").mkdir(parents=True)
    (tmp_path / "mine/notes.txt").touch()
    with pytest.raises(InputError, match="already exists and is no run folder"):
        sweep(CONFIG, tmp_path / "mine")


def test_a_run_folder_that_is_gone_is_not_made_anew(tmp_path):
    run = RunFolder.create(tmp_path / "run", {"name": "x"})
    run.path.rename(tmp_path / "gone")
    with pytest.raises(FileNotFoundError):
        run.write_json("provenance.json", {})
    with pytest.raises(FileNotFoundError):
        run.write_arrays("checkpoint/part-00000.npz", {})
    with pytest.raises(FileNotFoundError), figure(run.path / "figures" / "curves.png", 1, 1):
        pass
    assert not run.path.exists()
    run.close()


def test_two_sweeps_that_choose_the_same_place_get_one_each(tmp_path, monkeypatch):
    from humanoid_mjx.training import sweep as module

    monkeypatch.chdir(tmp_path)
    first = RunFolder.create(Path("runs/small"), resolved(parse(CONFIG)))
    places = iter([Path("runs/small"), Path("runs/small-2")])  # as if the first had come between
    monkeypatch.setattr(module, "run_path", lambda *_: next(places, Path("runs/small-2")))
    assert sweep(CONFIG).path == Path("runs/small-2")
    first.close()


def test_runs_that_are_lost_are_missed_by_all_that_look_for_one(tmp_path):
    """A part of the checkpoint is gone, and the tables have its runs."""
    path = sweep(CONFIG, tmp_path / "run", pool_size=1).path
    first, *others = sorted(path.glob("checkpoint/part-*"))
    best = find_policy(path)
    first.unlink()
    assert others
    words = r"checkpoint: lacks \d of the runs of summary.parquet; --resume trains them"
    with pytest.raises(InputError, match=words):
        find_policy(path)
    further = CONFIG | {"learner": CONFIG["learner"] | {"start_from": str(path)}}
    with pytest.raises(InputError, match=words):
        sweep(further, tmp_path / "further")
    again = find_policy(sweep(CONFIG, path, resume=True).path)
    assert (again.point, again.seed) == (best.point, best.seed)
    np.testing.assert_array_equal(again.policy, best.policy)


PART = "checkpoint/part-00009.npz"


@pytest.mark.parametrize(
    ("file", "spoil", "words"),
    [
        (PART, lambda run: next(run.glob("checkpoint/part-*")).read_bytes(), "another one holds"),
        (PART, lambda run: saved(x=np.zeros(3)), "does not say which run it belongs to"),
        (PART, lambda run: saved(run, x=np.zeros(3)), "another training"),
        (PART, lambda run: saved(run, point=np.int32([0]), seed=np.int32([77])), "does not fit"),
        ("checkpoint/part-x.npz", lambda run: b"notes", None),
        ("summary.parquet", lambda run: (run / "timing.parquet").read_bytes(), None),
        ("results.parquet", lambda run: (run / "summary.parquet").read_bytes(), None),
        ("results.parquet", lambda run: (run / "timing.parquet").read_bytes(), None),
        ("config.yaml", lambda run: b"name: small\ntask: reach\nlearner: {name: q}\n", "task must be a mapping"),
    ],
)
def test_foreign_files_in_a_run_folder(run, finished, said, file, spoil, words):
    """Every command says a sentence at most, and resuming ends with the same tables."""
    (run / file).write_bytes(spoil(run))
    config = run.parent / "small.yaml"
    config.write_text(json.dumps(CONFIG))
    for command in (["runs", run], ["report", run, "--no-motion"], ["export", run, run.parent / "x.npz"]):
        code, _, err = said(*command)
        assert code == 0 or (code == 2 and err.startswith("error: ") and err.count("\n") == 1), err
    if words:
        with pytest.raises(InputError, match=words):
            sweep(CONFIG, run, resume=True)
        return
    sweep(CONFIG, run, resume=True)
    assert_same_tables(run, finished)
    assert read_provenance(run)["runs_finished"] == 8


def test_what_is_stored_while_the_beginning_compiles_holds_no_run(monkeypatch):
    """Such a run had zeros for its state, and a sweep that was stopped then went on from these."""
    group, held = make_plan(parse(CONFIG)).groups[0], []
    pool = Pool(group, deque(group.runs.tolist()), 4, jax.local_devices()[:1], 0)
    call = Pool._call
    monkeypatch.setattr(Pool, "_call", lambda self, *given: (held.append(self.state()), call(self, *given))[1])
    pool.fill()
    assert pool.busy.all() and (held[0]["slots"] == pool_module.IDLE).all() and (pool.state()["slots"] >= 0).all()


@pytest.fixture(scope="module")
def others(tmp_path_factory):
    """Run folders that differ in the discount alone: one finished, one that was stopped with a run under way."""

    seen = threading.Event()

    class Stops(Reporter):
        def update(self, state):
            if state.done > 0:
                seen.set()
                raise KeyboardInterrupt

    def train(self, train=Pool.train):
        train(self)
        if self.progress.any():  # what trains waits to be seen, however quick it is
            seen.wait(60)

    place = tmp_path_factory.mktemp("others")
    config = CONFIG | {"learner": CONFIG["learner"] | {"discount": 0.5}}
    with pytest.raises(KeyboardInterrupt), pytest.MonkeyPatch.context() as patch:
        patch.setattr(pool_module, "MAX_STEPS", 8)
        patch.setattr(Pool, "train", train)
        sweep(config, place / "stopped", pool_size=1, reporter=Stops())
    return sweep(config, place / "finished").path, place / "stopped"


REPORT, SWEEP = ["report", "run", "--no-motion"], ["sweep", "small.yaml", "--resume", "--out", "run"]


@pytest.mark.parametrize(
    ("file", "commands", "listed"),
    [
        ("results.parquet", [REPORT, ["plot", "run"]], False),
        ("summary.parquet", [REPORT, ["plot", "run", "--x", "learner.epsilon"]], True),
        ("timing.parquet", [["plot", "run", "--x", "wall_s"]], False),
        ("checkpoint/part-00000.npz", [SWEEP, ["evaluate", "run"], ["export", "run", "x.npz"]], True),
        ("checkpoint/part-00000.npz", [["play", "run", "--out", "x.png"]], True),
        ("checkpoint/pool-0-0.npz", [SWEEP], True),
    ],
)
def test_a_file_of_another_run_is_refused(run, finished, others, said, monkeypatch, file, commands, listed):
    """By the commands that read it; resuming writes a table anew, and all of them where a stored state is removed."""
    monkeypatch.chdir(run.parent)
    Path("small.yaml").write_text(json.dumps(CONFIG))
    stored = file.startswith("checkpoint")
    if stored:  # as where a kill came before the end: the list counts the runs that are stored
        Path("run/provenance.json").unlink()
    if "pool" in file:
        Path("run/checkpoint/part-00000.npz").unlink()
    shutil.copy(others["pool" in file] / file, Path("run", file))
    words = f"run/{file}: this file belongs to another run, or config.yaml was edited (then undo that); "
    words += "remove it" if stored else "--resume"
    for command in commands:
        code, _, err = said(*command)
        assert code == 2 and err.startswith(f"error: {words}") and err.count("\n") == 1, (command, err)
    assert [problem.startswith(words) for problem in list_runs(Path("run"))[1]] == [True] * listed
    if stored:
        Path("run", file).unlink()
    else:
        for read in (read_table, column_names):
            with pytest.raises(InputError, match=re.escape(words)):
                read(Path("run", file))
    sweep(CONFIG, run, resume=True)
    assert_same_tables(run, finished)


@pytest.mark.parametrize("content", [b"[" * 100_000, b'{"sessions": [5]}', b"\xff", b"[1]", b'{"config": "other"}'])
def test_a_provenance_that_is_damaged_or_of_another_run_is_refused(run, said, content):
    """By the commands that read it; resuming writes it anew."""
    file = run / "provenance.json"
    file.write_bytes(content)
    for command in (["report", run, "--no-motion"], ["export", run, run.parent / "x.npz"]):
        code, _, err = said(*command)
        assert code == 2 and err.startswith(f"error: {file}: this file ") and err.count("\n") == 1, err
        assert err.endswith("--resume the run to write it again.\n")
    assert [problem.startswith(f"{file}: this file ") for problem in list_runs(run)[1]] == [True]
    sweep(CONFIG, run, resume=True)
    assert read_provenance(run)["runs_finished"] == 8


def test_a_number_changed_in_the_provenance_is_noticed(run):
    file = run / "provenance.json"
    file.write_text(re.sub(r'"runs_finished": \d+', '"runs_finished": 7', file.read_text()))
    with pytest.raises(InputError, match=r"provenance\.json: this file is truncated or damaged"):
        read_provenance(run)


def test_another_table_of_the_run_in_the_place_of_one_is_noticed(run):
    """Also by `plot`, which reads only columns that it draws."""
    shutil.copy(run / "results.parquet", run / "timing.parquet")
    with pytest.raises(InputError, match=r"timing\.parquet: this file is another one"):
        column_names(run / "timing.parquet")


def test_a_table_without_a_digest_is_damaged(run):
    file = run / "summary.parquet"
    pq.write_table(pq.read_table(file).replace_schema_metadata(None), file)
    with pytest.raises(InputError, match="damaged: it does not say which run it belongs to; --resume the run"):
        read_table(file)


def test_a_run_belongs_to_a_config_whatever_its_name_and_the_layout_of_the_file(run):
    config = read_config(run)
    (run / "config.yaml").write_text(json.dumps(dict(reversed(config.items())) | {"name": "other"}))
    assert len(read_table(run / "summary.parquet")["point"]) == 8 and find_policy(run)
    (run / "config.yaml").write_text(json.dumps(config | {"seed": 1}))
    assert "config.yaml was edited" in list_runs(run)[1][0]


def saved(run=None, **arrays):
    """An archive; one of a run folder where that is given."""
    file = io.BytesIO()
    np.savez(file, **arrays, **({"config": np.array(config_digest(read_config(run)))} if run else {}))
    return file.getvalue()


def test_a_damaged_policy_is_found_when_a_run_is_resumed(run):
    (part,) = run.glob("checkpoint/part-*.npz")
    data = bytearray(part.read_bytes())
    data[data.rindex(b"policy", 0, data.index(b"PK\x01\x02")) + 400] ^= 1
    part.write_bytes(bytes(data))
    assert read_arrays(part, ("point", "seed"))
    with pytest.raises(InputError, match=r"part-00000.npz: this file is truncated or damaged; remove it"):
        sweep(CONFIG, run, resume=True)


def test_a_resumed_pool_goes_on_whatever_its_arrays_hold():
    """The chain's world has an array without entries; of these jax forgets over which devices they lie."""
    learner = {"name": "linear_q", "envs": 2, "rollout": 4, "resolution": 2, "tilings": 1, "order": 1}
    task = {"name": "leg_reach", "physics": "chain", "duration": 0.4, "bins": 3}
    config = {"name": "leg", "task": task, "learner": learner | {"evaluation_envs": 2}, "seeds": 2, "total_steps": 640}
    (group,) = make_plan(parse(config)).groups
    assert any(0 in leaf.shape for leaf in jax.tree.leaves(group.one_run)) and len(jax.local_devices()) > 1

    def pool():
        return Pool(group, deque(group.runs.tolist()), 1, jax.local_devices()[:2], 0)

    first, again = pool(), pool()
    first.fill()
    first.train()
    again.restore({name: np.array(x) for name, x in first.state().items()}, "stored")
    for _ in range(2):  # the state that the first leaves is what the second was not compiled for
        again.train()
    assert (again.progress > 0).all()


def test_yaml_bombs_get_one_sentence(tmp_path):
    path = tmp_path / "bomb.yaml"
    for text in bomb_texts():
        path.write_text(text, errors="replace")
        with pytest.raises(InputError) as caught:
            make_plan(load(path))
        assert "\n" not in str(caught.value) and len(str(caught.value)) < 1000, text[:100]
    assert parse_yaml("a: &x [1, 2]\nb: [*x, *x]", "here") == {"a": [1, 2], "b": [[1, 2], [1, 2]]}


@pytest.mark.parametrize(
    "change",
    [
        {"sweep": {"axes": {"learner.record": [1, 2]}}},
        {"sweep": {"axes": {"learner.task.states": [5]}}},
        {"sweep": {"axes": {"learner.epsilon": {"linspace": [0, 10**400, 3]}}}},
        {"sweep": {"mode": "random", "points": 2, "axes": {"task.states": {"integers": [2, 10**30]}}}},
        {"seeds": 1_000_000, "sweep": {"axes": {"learner.epsilon": {"linspace": [0, 1, 11]}}}},
        {"task": CONFIG["task"] | {"joint": [1]}},
        {"task": CONFIG["task"] | {"start": 0.0, "goal": 1e300, "action": 1e-300}},
        {"task": {"name": ":Task"}},
        {"task": {"name": ".mine:Task"}},
        {"task": {"name": "leg_reach", "control": {"name": {}}}},
    ],
)
def test_values_that_no_config_may_have(change):
    with pytest.raises(InputError) as caught:
        make_plan(parse(CONFIG | change))
    assert "\n" not in str(caught.value) and len(str(caught.value)) < 1000


def test_a_module_that_cannot_be_read_is_named(tmp_path):
    (tmp_path / "broken_module_of_mine.py").write_text("class Task(\n")
    (tmp_path / "c.yaml").write_text(json.dumps(CONFIG | {"task": {"name": "broken_module_of_mine:Task"}}))
    with pytest.raises(InputError, match=r"a module that it names cannot be used: SyntaxError.*mine.py, line 1"):
        make_plan(load(tmp_path / "c.yaml"))


@pytest.mark.parametrize(
    ("error", "words"),
    [
        (OSError(errno.ENOENT, "x", "runs/a"), "error: runs/a: No such file or directory.\n"),
        (OSError(errno.EFBIG, "x", "runs/a"), "error: runs/a: File too large.\n"),
        (OSError(errno.ENOSPC, "x"), "error: No space left on device.\n"),
        (OSError(errno.EEXIST, "x", "figures"), "error: figures: a file stands where a folder is wanted.\n"),
        (MemoryError(), "error: the memory does not suffice"),
        (jax.errors.JaxRuntimeError("RESOURCE_EXHAUSTED: Out of memory"), "error: the memory does not suffice"),
        (InputError("task.a\nb\x1b[31m: unknown."), "error: task.a\\nb\\x1b[31m: unknown.\n"),
    ],
)
def test_errors_of_the_machine_get_one_line(said, monkeypatch, error, words):
    def fails(folder):
        raise error

    monkeypatch.setattr("humanoid_mjx.runs.listing.list_runs", fails)
    code, _, err = said("runs")
    assert code == 2 and err.startswith(words) and err.count("\n") == 1


def test_a_disk_that_fills_up_gets_one_sentence_and_what_is_stored_stays(said, tmp_path, monkeypatch):
    def full(*given, **arrays):
        raise OSError(errno.ENOSPC, "No space left on device")

    monkeypatch.chdir(tmp_path)
    Path("small.yaml").write_text(json.dumps(CONFIG))
    with monkeypatch.context() as patch:
        patch.setattr(np, "savez", full)
        code, _, err = said("sweep", "small.yaml", "--out", "run")
    assert code == 2 and err.count("\n") == 1, err
    assert err.startswith("error: run/checkpoint/part-00000.npz: No space left on device; what is stored is")
    assert said("sweep", "small.yaml", "--out", "run", "--resume")[0] == 0


def test_names_are_not_taken_for_markup(run, said):
    odd = run.rename(run.parent / "[red]a:bug:[")
    code, _, err = said("runs", run.parent)
    assert code == 0 and not err
    assert find_policy(odd).name == "[red]a:bug:["
    assert said("evaluate", odd, "--episodes", 2, "--json", run.parent / "[b].json")[0] == 0
    assert (run.parent / "[b].json").exists()


def test_a_file_that_cannot_be_written_whole_leaves_the_old_one(tmp_path):
    path = tmp_path / "found.json"
    path.write_text("old")
    with pytest.raises(OSError), whole_file(path) as temporary:
        temporary.write_text("half")
        raise OSError(errno.ENOSPC, os.strerror(errno.ENOSPC))
    assert path.read_text() == "old" and os.listdir(tmp_path) == ["found.json"]
