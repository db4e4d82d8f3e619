"""Pages in a real browser: they need no network, run nothing that text brings, and answer to keys."""

import json
import time

import numpy as np
import pytest
from browser import CHROMIUM, browser
from small_sweep import of_rows
from test_page import HOSTILE

from humanoid_mjx.evaluation.film import Film, Push
from humanoid_mjx.report.drawing import CURVES
from humanoid_mjx.report.figures import curved
from humanoid_mjx.report.page import _row
from humanoid_mjx.report.scene import film_data, player
from humanoid_mjx.report.web import contents, page, section, table, text
from humanoid_mjx.robot import make_robot

pytestmark = [pytest.mark.slow, pytest.mark.skipif(CHROMIUM is None, reason="there is no Chromium here")]

SIZES = ((360, 740), (1280, 900))


@pytest.fixture(scope="module")
def address(tmp_path_factory):
    """A page with all its kinds of parts, every text of which would do harm if it were not escaped."""
    model = make_robot("lower_body").spec().compile()
    qpos = np.tile(model.qpos0, (26, 1))
    qpos[:, 8] = np.linspace(0.0, 0.5, 26)
    push = Push(0.2, 0.02, np.array([0.0, 10.0, 0.0]))
    film = Film(model, qpos, 0.04, HOSTILE, ((0.0, HOSTILE), (0.5, "halt")), (push,))
    wide = table([f"learner.{HOSTILE}"] * 12, [[f"{i} {HOSTILE}" for i in range(12)]] * 3)
    body = section(HOSTILE, text(HOSTILE), text("x" * 400, "pre"), wide)
    file = tmp_path_factory.mktemp("page") / "page.html"
    file.write_text(page(HOSTILE, body + section("The robot", player(film_data(film), "<p>No script here.</p>"))))
    return file.as_uri()


def state(opened):
    return json.loads(opened.value("JSON.stringify(document.querySelector('canvas').dataset)"))


def picture(opened):
    return opened.value("document.querySelector('canvas').toDataURL()")


def test_it_needs_nothing_and_runs_nothing_foreign(address):
    with browser() as opened:
        for width, height in SIZES:
            opened.open(address, width, height)
            assert opened.faults == []
            assert [url for url in opened.requests if not url.startswith("data:")] == [address]
            assert opened.value("typeof window.hacked") == "undefined"
            assert opened.value("document.querySelectorAll('canvas').length") == 1
            # Wide tables scroll within themselves.
            assert opened.value("document.documentElement.scrollWidth") <= width
        foreign = (
            "new Promise(done => { const added = document.createElement('script');"
            "added.textContent = 'window.hacked=1'; document.body.append(added);"
            "setTimeout(() => done(typeof window.hacked), 50); })"
        )
        assert opened.value(foreign) == "undefined"


def test_keys_turn_the_view_and_move_the_time(address):
    with browser() as opened:
        opened.open(address)
        opened.value("document.querySelector('canvas').focus()")
        first = picture(opened)
        opened.press("ArrowRight")
        assert float(state(opened)["yaw"]) == pytest.approx(np.radians(130) + 0.12, abs=2e-3)
        turned = picture(opened)
        opened.press("ArrowLeft")
        assert turned != first == picture(opened)
        for _ in range(3):
            opened.press(".")
        assert float(state(opened)["time"]) == pytest.approx(0.12) and picture(opened) != first
        opened.press(" ")
        until = time.monotonic() + 300.0
        while float(state(opened)["time"]) < 1.0 and time.monotonic() < until:
            time.sleep(0.05)
        assert float(state(opened)["time"]) == pytest.approx(1.0)
        assert opened.value("document.querySelector('.told').textContent") == "halt"
        assert opened.faults == []


def test_tables_sort_and_curves_say_their_values(tmp_path):
    """By the numbers in a column, up and down; below the pointer the values of all lines at the nearest place."""
    results = {
        "episode": np.tile([0, 10, 20], 4),
        "point": np.repeat([0, 0, 1, 1], 3),
        "seed": np.repeat([0, 1, 0, 1], 3),
        "learner.epsilon": np.repeat([0.1, 0.1, 0.5, 0.5], 3),
        "steps": np.array([9.0, 4, 3, 9, 4, 3, 8, 7, 6, 8, 7, 6]),
    }
    learned = of_rows(results, ["learner.epsilon"])
    (figure,) = [each for each in curved(learned) if each.title == CURVES["steps"]]
    rows = [("x", "10"), ("y", "9.5 (1 to 20)"), ("z", "1e2")]
    body = contents(["A table"]) + section("A table", table(("name", "n"), rows), *_row(["learner.epsilon"], figure))
    file = tmp_path / "page.html"
    file.write_text(page("t", body))
    column = "[...document.querySelectorAll('tbody tr')].map(row => row.cells[0].textContent).join('')"
    with browser() as opened:
        opened.open(file.as_uri())
        assert opened.value("document.querySelector(document.querySelector('nav a').hash).tagName") == "SECTION"
        for order in ("yxz", "zxy"):
            opened.value("document.querySelectorAll('th button')[1].click()")
            assert opened.value(column) == order
        left, top, width, height = opened.value(
            "(() => { const b = document.querySelector('figure img').getBoundingClientRect();"
            "return [b.left, b.top, b.width, b.height]; })()"
        )
        opened.ask("Input.dispatchMouseEvent", type="mouseMoved", x=left + 0.48 * width, y=top + 0.4 * height)
        assert opened.value("document.querySelector('.tip').textContent") == "at 10\n0.1: 4\n0.5: 7"
        assert opened.faults == []
