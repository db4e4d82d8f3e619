"""Pages in a real browser: they need no network, run nothing that text brings, and answer to keys."""

import json
import time

import numpy as np
import pytest
from browser import CHROMIUM, browser
from test_page import HOSTILE

from humanoid_mjx.evaluation.film import Film, Push
from humanoid_mjx.report.player import player
from humanoid_mjx.report.web import page, section, table, text
from humanoid_mjx.robot import make_robot

pytestmark = [
    pytest.mark.slow,
    pytest.mark.skipif(CHROMIUM is None, reason="there is no Chromium here"),
]

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
    file.write_text(page(HOSTILE, body + section("The robot", player(film, still="<p>No script here.</p>"))))
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
        until = time.monotonic() + 30.0
        while float(state(opened)["time"]) < 1.0 and time.monotonic() < until:
            time.sleep(0.05)
        assert float(state(opened)["time"]) == pytest.approx(1.0)
        assert opened.value("document.querySelector('.told').textContent") == "halt"
        assert opened.faults == []


FOCUSED = """(() => {
    const element = document.activeElement, style = getComputedStyle(element), box = element.getBoundingClientRect();
    const shown = style.outlineStyle === "solid" && box.bottom > 0 && box.top < innerHeight;
    return [element.tagName, element.getAttribute("aria-label") || element.textContent, shown];
})()"""
"""What has the focus, its name, and whether a reader sees that."""


def test_tab_leads_to_every_control_and_keys_work_it(address):
    with browser() as opened:
        opened.open(address)
        first = state(opened)
        found = []
        while not found or found[-1][0] != "BODY":
            opened.press("Tab")
            found.append(opened.value(FOCUSED))
            match found[-1][1]:
                case "Time in seconds":
                    opened.press("ArrowRight")
                    assert float(state(opened)["time"]) == pytest.approx(0.04)
                case "Speed":
                    opened.press("ArrowUp")
                    assert opened.value("document.activeElement.value") == "0.5"
                case "Reset view":
                    opened.value("document.querySelector('figure.player canvas').focus()")
                    opened.press("ArrowLeft")
                    assert state(opened)["yaw"] != first["yaw"]
                    opened.value("document.querySelectorAll('.controls button')[2].focus()")
                    opened.press(" ")
                    assert state(opened)["yaw"] == first["yaw"]
        assert [tag for tag, _, _ in found] == [
            "DIV",
            "CANVAS",
            "BUTTON",
            "INPUT",
            "SELECT",
            "BUTTON",
            "BUTTON",
            "BODY",
        ]
        assert all(name and shown for _, name, shown in found[:-1])


def test_everything_but_the_motion_is_there_without_javascript_and_on_paper(address, tmp_path):
    with browser(javascript=False) as opened:
        opened.open(address)
        shown = opened.ask("DOM.getDocument", depth=-1)
        words = json.dumps(shown)
        assert "No script here." in words and '"CANVAS"' not in words
        opened.ask("Emulation.setEmulatedMedia", media="print")
        opened.size(690, 980)  # what the margins leave of a sheet, at 96 pixels an inch
        assert opened.value("document.documentElement.scrollWidth") <= 690  # what is wider would be cut off
        assert opened.value("getComputedStyle(document.querySelector('.player')).display") == "none"
        opened.pdf(tmp_path / "page.pdf")
        assert (tmp_path / "page.pdf").read_bytes().startswith(b"%PDF")
