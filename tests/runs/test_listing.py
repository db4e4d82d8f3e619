"""The list of run folders: finished, under way, killed, foreign and damaged ones."""

import io
import json
import shutil

import numpy as np
import pyarrow as pa
import pyarrow.parquet as pq
import pytest
import small_sweep
from command_line import told
from rich.console import Console

from humanoid_mjx import InputError, sweep
from humanoid_mjx.commands import runs
from humanoid_mjx.config import parse
from humanoid_mjx.runs import listing
from humanoid_mjx.runs.folder import RunFolder, run_path
from humanoid_mjx.runs.listing import list_runs
from humanoid_mjx.training import pool
from humanoid_mjx.training.plan import make_plan

AXES = {"learner.epsilon": [0.1, 0.9], "learner.learning_rate": [0.2, 0.4]}
CONFIG = small_sweep.CONFIG | {"sweep": {"axes": AXES}, "episodes": 40}


@pytest.fixture(scope="module")
def finished(tmp_path_factory):
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(pool, "HARVEST_SHARE", 1.0)  # one part, however busy the machine is
        patch.setattr(pool, "HARVEST_AFTER_S", np.inf)
        return sweep(CONFIG, tmp_path_factory.mktemp("runs") / "small").path


@pytest.fixture
def folder(finished, tmp_path):
    shutil.copytree(finished, tmp_path / "runs" / "small")
    return tmp_path / "runs"


def only(folder):
    found, problems = list_runs(folder)
    assert not problems and len(found) == 1
    return found[0]


def test_a_finished_run_and_its_best_point(folder):
    run, summary = only(folder), sweep(CONFIG, folder / "small", resume=True).summary
    assert (run.config, run.task, run.learner) == ("small", "joint_reach", "tabular_q")
    assert (run.points, run.seeds, run.state, run.share, run.diverged) == (4, 3, "finished", 1.0, 0)
    success = [summary["greedy_success"][summary["point"] == point].mean() for point in range(4)]
    assert run.success == pytest.approx(max(success))
    assert run.size == sum(path.stat().st_size for path in folder.rglob("*") if path.is_file())
    assert only(folder / "small") == run, "the folder itself may be named"
    (folder / "small/provenance.json").unlink()
    assert only(folder).share == 1.0, "the runs of its parts are counted"


def test_names_of_run_folders_count_up(tmp_path):
    for name in ("joint1", "joint1-2", "joint1-3"):
        assert run_path("joint1", root=tmp_path) == tmp_path / name
        (tmp_path / name).mkdir()
        assert run_path("joint1", True, tmp_path) == tmp_path / name
    (tmp_path / "joint1-2").rmdir()
    assert run_path("joint1", root=tmp_path) == tmp_path / "joint1-4"
    assert run_path("joint1", True, tmp_path) == tmp_path / "joint1-3"
    with pytest.raises(InputError, match="joint4: there is no run to resume"):
        run_path("joint4", True, tmp_path)


def test_a_run_that_was_killed_says_how_far_it_is(folder):
    path = folder / "small"
    for name in ("results", "summary", "timing"):
        (path / f"{name}.parquet").unlink()
    (path / "provenance.json").unlink()
    (part,) = (path / "checkpoint").glob("part-*.npz")
    with np.load(part) as file:
        arrays = {name: file[name][:6] if file[name].ndim else file[name] for name in file.files}
    np.savez(part, **arrays)
    done = arrays["point"] * 3 + arrays["seed"]
    others = np.setdiff1d(np.arange(12), done)
    # Two runs half trained, one that the parts hold already, and an idle slot: 6 + 1 of 12.
    slots = np.array([others[0], others[1], done[-1], -1])
    progress = np.array([0.5, 0.5, 1.0, 1.0])
    np.savez(path / "checkpoint/pool-0.npz", slots=slots, progress=progress, config=arrays["config"])
    run = only(folder)
    assert (run.points, run.state, run.share) == (4, "interrupted", 7 / 12)
    assert np.isnan(run.success)


def test_a_pool_whose_runs_end_while_it_is_read_is_no_damage(folder, monkeypatch):
    path = folder / "small"
    (path / "provenance.json").unlink()
    (part,) = (path / "checkpoint").glob("part-*.npz")
    part.unlink()
    monkeypatch.setattr(listing, "pools", lambda path: [path / "checkpoint/pool-0-11.npz"])
    assert only(folder).share == 0.0
    (path / "checkpoint/pool-0-11.npz").write_bytes(b"")
    assert "pool-0-11.npz: this file is truncated or damaged" in "".join(list_runs(folder)[1])


def test_a_run_that_a_process_holds_is_training(folder):
    (folder / "small/provenance.json").write_text(json.dumps({"points": 4, "runs": 12, "runs_finished": 3}))
    (part,) = (folder / "small/checkpoint").glob("part-*.npz")
    part.unlink()
    assert only(folder).state == "interrupted"
    held = RunFolder.resume(folder / "small", make_plan(parse(CONFIG)).resolved())
    assert only(folder).state == "training"
    held.close()


def test_diverged_runs_are_marked(folder):
    file = folder / "small/summary.parquet"
    table = pq.read_table(file)
    column = table.column_names.index("diverged")
    pq.write_table(table.set_column(column, "diverged", pa.array([True, True] + [False] * 10)), file)
    assert only(folder).diverged == 2
    assert "finished, 2 diverged" in told("runs", folder)


def test_foreign_and_damaged_folders_get_a_sentence_each(folder, monkeypatch):
    def copy(name):
        return shutil.copytree(folder / "small", folder / name)

    (folder / "notes").mkdir()
    (folder / "file").write_text("no folder")
    (copy("binary") / "config.yaml").write_bytes(b"\xff\xfe\x00\x81")
    (copy("nested") / "config.yaml").write_text("[" * 5000)
    (copy("other") / "config.yaml").write_text("a: 1\n")
    (copy("short") / "summary.parquet").write_bytes(b"PAR1")
    (copy("words") / "provenance.json").write_text('{"points": "many"}')
    shutil.copy(folder / "small/timing.parquet", copy("mixed") / "summary.parquet")
    found, problems = list_runs(folder)
    assert [run.path.name for run in found] == ["small"]
    for name in ("binary", "mixed", "nested", "notes", "other", "short", "words"):
        assert sum(f"/{name}" in problem for problem in problems) == 1, name
    assert len(problems) == 7 and all(problem.endswith(".") and "\n" not in problem for problem in problems)
    monkeypatch.chdir(folder.parent)
    output = told("runs")
    assert "4 x 3" in output and "notes: this is no run folder" in output


def test_an_empty_folder_and_none(tmp_path):
    assert "no run folder" in told("runs", tmp_path)
    with pytest.raises(InputError, match="there is no such folder"):
        list_runs(tmp_path / "nowhere")


@pytest.mark.parametrize(("width", "last"), [(200, "size"), (74, "success")])
def test_a_narrow_terminal_shows_fewer_columns_rather_than_broken_words(folder, monkeypatch, width, last):
    console = Console(file=io.StringIO(), width=width, force_terminal=True, color_system=None, highlight=False)
    monkeypatch.setattr(runs, "console", console)
    runs.runs(folder)
    headings, row, *_ = console.file.getvalue().splitlines()
    assert headings.split()[-1] == last and {"small", "joint_reach", "tabular_q", "finished"} <= set(row.split())
