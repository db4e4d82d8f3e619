"""The page of a sweep that grows while it trains: what it shows, and to whom."""

import json
import re
import urllib.error
import urllib.request

import numpy as np
import pytest
from small_sweep import CONFIG
from typer.testing import CliRunner

from humanoid_mjx import InputError, sweep
from humanoid_mjx.cli import app
from humanoid_mjx.report.growing import Growing, best_so_far, results_so_far, served
from humanoid_mjx.training import events, pool
from humanoid_mjx.training.events import Curves
from humanoid_mjx.training.progress import State

SMALL = CONFIG | {"sweep": {"axes": {"learner.epsilon": [0.2, 0.6]}}}


def get(address, **headers):
    with urllib.request.urlopen(urllib.request.Request(address, headers=headers)) as answer:
        return answer.read().decode()


def test_the_page_grows_and_ends_as_the_report(tmp_path, monkeypatch):
    monkeypatch.setattr(events, "LOOK_EVERY_S", 0.0)
    monkeypatch.setattr(pool, "MAX_STEPS", 64)
    growing, known = Growing(), []
    look = Curves.look

    def looked(self, pool):
        look(self, pool)
        if results := results_so_far(self):
            known.append(np.isfinite(results["steps"]).mean())
            if len(known) == 2:  # as a browser would, while it trains, once the first page is old
                growing._drawn = None
                pages.append(get(address))

    monkeypatch.setattr(Curves, "look", looked)
    pages = []
    with served(growing, browse=False) as address:
        first = get(address)
        run = sweep(SMALL, tmp_path / "run", reporter=growing, watch=growing.watch)
        growing.finish(run.path)
        last = get(address)
    assert "starting" in first and 'content="5"' in first and "<table>" not in first
    (grown,) = pages
    assert "Best so far" in grown and "learner.epsilon" in grown and "data:image/svg" in grown
    assert known[0] < 1.0 == known[-1], "it grows"
    assert "Run it again" in last and 'http-equiv="refresh"' not in last

    whole = results_so_far(growing.curves)
    for name in ("point", "seed", "episode", "learner.epsilon", "steps", "success", "return"):
        np.testing.assert_allclose(whole[name], run.results[name], rtol=1e-6, err_msg=name)
    growing.report = growing._drawn = None
    growing.phase("training")
    growing.update(State(30.0, 120.0, "episodes", 1234.5, 100.0))
    assert "training: 25% trained at 1,234 episodes a second; about 2 min left" in growing.page().decode()
    headings, rows = best_so_far(growing.curves)
    assert headings[:2] == ["point", "learner.epsilon"] and len(rows) == 2
    shares = [float(row[headings.index("success")]) for row in rows]
    assert shares == sorted(shares, reverse=True)


@pytest.mark.parametrize(
    ("path", "headers", "status"),
    [("", {"Host": "evil.example"}, 403), ("", {"Origin": "http://evil.example"}, 403), ("etc/passwd", {}, 404)],
)
def test_nothing_but_the_page_is_served_and_to_this_machine_alone(path, headers, status):
    with served(Growing(), browse=False) as address:
        assert re.fullmatch(r"http://127\.0\.0\.1:\d+/", address)
        with pytest.raises(urllib.error.HTTPError) as caught:
            get(address + path, **headers)
    assert caught.value.code == status


def test_what_another_machine_trains_has_no_page_here():
    with pytest.raises(InputError, match="--view: this machine does not train what --slurm hands over"):
        CliRunner().invoke(app, ["sweep", "joint1", "--view", "--slurm", "nodes=2"], catch_exceptions=False)


def test_the_command_shows_the_page_and_at_the_end_the_report(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    pages, opened = [], []

    def interrupted():
        pages.append(get(opened[0]))
        raise KeyboardInterrupt

    monkeypatch.setattr("webbrowser.open", opened.append)
    monkeypatch.setattr("signal.pause", interrupted)
    (tmp_path / "small.yaml").write_text(json.dumps(SMALL))
    done = CliRunner().invoke(app, ["sweep", "small.yaml", "--view"], catch_exceptions=False)
    assert done.exit_code == 0 and opened[0] in done.output and "Ctrl-C ends it" in done.output
    assert "Run it again" in pages[0]
