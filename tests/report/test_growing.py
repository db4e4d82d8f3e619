"""The page of a sweep that grows while it trains: what it shows."""

import json
import re

import numpy as np
import pytest
from command_line import told
from small_sweep import CONFIG

from humanoid_mjx import InputError, sweep
from humanoid_mjx.config import parse
from humanoid_mjx.report import growing
from humanoid_mjx.report.growing import Growing, best_so_far, learning_so_far
from humanoid_mjx.runs.folder import RunFolder
from humanoid_mjx.training import chunks, pool
from humanoid_mjx.training.curves import Curves
from humanoid_mjx.training.plan import make_plan, resolved
from humanoid_mjx.training.progress import Reporter, State

SMALL = CONFIG | {"sweep": {"axes": {"learner.epsilon": [0.2, 0.6]}}}


@pytest.fixture(autouse=True)
def opened(monkeypatch):
    """The addresses that a browser was to open."""
    addresses = []
    monkeypatch.setattr("webbrowser.open", addresses.append)
    return addresses


def test_the_page_grows_and_ends_as_the_report(tmp_path, monkeypatch):
    monkeypatch.setattr(chunks, "CURVES_EVERY_S", 0.0)
    monkeypatch.setattr(pool, "MAX_STEPS", 256)
    growing, known, pages = Growing(Reporter()), [], []
    grow = Curves.grow

    def grows(self, *given):
        grow(self, *given)
        learning = learning_so_far(self)
        if learning and "steps" in learning.names:
            known.append(np.isfinite(learning.read("steps")).mean())
            if len(known) == 3:
                growing.write()
                pages.append(growing.file.read_text())

    monkeypatch.setattr(Curves, "grow", grows)

    def watched(*args):
        found = growing.watch(*args)
        pages.append(growing.file.read_text())
        return found

    with growing:
        run = sweep(SMALL, tmp_path / "run", reporter=growing, watch=[watched])
    first, grown, last = *pages, growing.file.read_text()
    assert "starting" in first and 'content="5"' in first and "<table>" not in first
    assert "Best so far" in grown and "learner.epsilon" in grown and "data:image/svg" in grown
    assert known[0] < 1.0 == known[-1], "it grows"
    assert "Run it again" in last and 'http-equiv="refresh"' not in last

    whole = learning_so_far(growing.curves)
    assert whole is not None and whole.seeds == SMALL["seeds"] and list(whole.points) == [0, 1]
    np.testing.assert_allclose(np.tile(whole.places, 6), run.results["episode"])
    np.testing.assert_allclose(whole.axes["learner.epsilon"], [0.2, 0.6])
    for name in ("steps", "success", "return"):
        np.testing.assert_allclose(whole.read(name).ravel(), run.results[name], rtol=1e-6, err_msg=name)
    growing.phase("training")
    growing.update(State(30.0, 120.0, "episodes", 1234.5, 100.0))
    assert "training, 25% trained at 1,234 episodes a second; about 2 min left" in growing.html()
    headings, rows = best_so_far(growing.curves)
    assert headings[:2] == ["point", "learner.epsilon"] and len(rows) == 2
    shares = [float(row[headings.index("success")]) for row in rows]
    assert shares == sorted(shares, reverse=True)


def test_of_points_that_succeed_alike_the_quickest_is_the_best_so_far(tmp_path, monkeypatch):
    """Though waiting may be paid, as it is here: the slower point has the higher return."""
    plan = make_plan(parse(SMALL))
    curves = Curves(RunFolder.create(tmp_path / "run", resolved(plan.config)), plan, 2)
    shape = len(plan.points), curves.seeds, len(curves.places)
    slow = np.broadcast_to(np.array([40.0, 20.0])[:, None, None], shape)
    measures = {"success": np.ones(shape), "return": 100.0 + slow, "steps": slow}
    monkeypatch.setattr(growing, "_measured", lambda _: (measures, np.full(shape[:2], shape[2])))
    _, rows = best_so_far(curves)
    assert [row[0] for row in rows] == ["1", "0"] and [row[-1] for row in rows] == ["20", "40"]


def test_what_no_episode_has_told_yet_is_neither_nan_nor_an_empty_figure(tmp_path, monkeypatch):
    """With a single record point, of which only the error is known, and then two with an episode in the first."""
    plan = make_plan(parse(SMALL))
    page = Growing(Reporter())
    folder = RunFolder.create(tmp_path / "run", resolved(plan.config))
    page.curves, page.file = Curves(folder, plan, 2), tmp_path / "run" / "report.html"
    shape = len(plan.points), page.curves.seeds, len(page.curves.places)
    unknown, known = np.full(shape, np.nan), 1
    page.curves.measures = {"steps": unknown, "td_error": np.ones(shape)}
    monkeypatch.setattr(growing, "_measured", lambda curves: (curves.measures, np.full(shape[:2], known)))
    assert "No episode has ended yet." in page.html() and "svg" not in page.html() and "nan" not in page.html()
    unknown[..., 0], known = 31.0, 2
    assert "data:image/svg" in page.html() and "TD error" in page.html() and "Steps per episode" not in page.html()
    assert best_so_far(page.curves)[1][0][-1] == "31"


def test_what_another_machine_trains_has_no_page_here():
    with pytest.raises(InputError, match="--view: this machine does not train what --slurm hands over"):
        told("sweep", "joint1", "--view", "--slurm", "nodes=2")


def test_the_command_opens_the_page_which_ends_as_the_report(tmp_path, monkeypatch, opened):
    monkeypatch.chdir(tmp_path)
    (tmp_path / "small.yaml").write_text(json.dumps(SMALL))
    assert "runs/small/report.html" in told("sweep", "small.yaml", "--view")
    file = tmp_path / "runs" / "small" / "report.html"
    assert opened == [file.as_uri()]
    assert "Run it again" in file.read_text()


def test_a_page_of_a_sweep_that_ends_early_says_so_and_is_loaded_no_more(tmp_path):
    plan = make_plan(parse(SMALL))
    folder = RunFolder.create(tmp_path / "run", resolved(plan.config))
    with pytest.raises(KeyboardInterrupt), Growing(Reporter()) as growing:
        growing.watch(folder, plan)
        raise KeyboardInterrupt
    folder.close()
    assert re.search(r"\d\d:\d\d:\d\d: stopped", page := growing.file.read_text()) and "refresh" not in page
