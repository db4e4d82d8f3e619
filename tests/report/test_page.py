"""The report of a run folder and of `reproduce`: what stands in it, what never gets into it."""

import base64
import json
import re
import shutil
from html import unescape
from html.parser import HTMLParser
from pathlib import Path

import numpy as np
import pytest
from command_line import told
from small_sweep import CONFIG

import humanoid_mjx
from humanoid_mjx import compute
from humanoid_mjx.config import dump_yaml
from humanoid_mjx.evaluation.film import Film
from humanoid_mjx.report.scene import film_data
from humanoid_mjx.reproduction.findings import Setting
from humanoid_mjx.robot import make_robot
from humanoid_mjx.runs.folder import read_config
from humanoid_mjx.spec import InputError
from humanoid_mjx.training.sweep import sweep

HOSTILE = "</pre></script><script>window.hacked=1</script><img src=x onerror=\"window.hacked=1\"> $x_{ & 'q' \u202e"

FINDING = {"name": "table-7.1", "quantity": "steps, joint 1", "printed": [23, 1e-7], "reproduced": {"steps": 24.0}}
FINDING |= {"tolerance": 0.5, "verdict": "differs", "why": "as computed"}


class Parts(HTMLParser):
    """The tags of a page with their attributes, and the text of each script that would run."""

    def __init__(self, html):
        super().__init__()
        self.tags, self.scripts, self._runs = [], [], False
        self.feed(html)

    def handle_starttag(self, tag, attrs):
        self.tags.append((tag, dict(attrs)))
        self._runs = tag == "script" and dict(attrs).get("type") != "application/json"

    def handle_endtag(self, tag):
        self._runs = False

    def handle_data(self, data):
        if self._runs:
            self.scripts.append(data)

    def addresses(self):
        return [value for _, attrs in self.tags for name, value in attrs.items() if name in ("src", "href")]


def report(folder, *arguments):
    told("report", folder, *arguments)
    return (folder / "report.html").read_text()


def assert_nothing_gets_in(html):
    parts = Parts(html)
    assert len(parts.scripts) == 1 and "window.hacked" not in parts.scripts[0]
    assert not [attrs for _, attrs in parts.tags if any(name.startswith("on") for name in attrs)]
    assert all(address.startswith(("data:", "#")) for address in parts.addresses())
    assert not [tag for tag, _ in parts.tags if tag in ("iframe", "object", "embed", "form")]


@pytest.fixture(scope="module")
def swept(tmp_path_factory):
    axes = {"learner.epsilon": [0.1, 0.5], "learner.discount": [0.5, 0.9]}
    return sweep(
        CONFIG | {"name": "tiny", "sweep": {"axes": axes}, "episodes": 40}, tmp_path_factory.mktemp("page") / "run"
    ).path


@pytest.fixture(scope="module")
def html(swept):
    return report(swept)


def test_a_run_is_told_from_beginning_to_end(swept, html):
    assert_nothing_gets_in(html)
    for words in ("4 points, 3 seeds each, 40 episodes a run", "All 4 points, best first", "Save as tiny.yaml"):
        assert words in html
    provenance = json.loads((swept / "provenance.json").read_text())
    assert f"jax=={provenance['versions']['jax']}" in html and "humanoid-mjx sweep tiny.yaml --out tiny-again" in html
    assert provenance["commit"] == compute.commit()
    assert dump_yaml(read_config(swept)).splitlines()[0] in html
    # Two swept parameters: a curve of each measure by each, and a heat map of what differs between points.
    alts = [attrs["alt"] for tag, attrs in Parts(html).tags if tag == "img"]
    assert any(re.match(r"return per episode .* by learner.epsilon; at the end 0.1: \d", alt) for alt in alts)
    # The goal's row of the table is never visited, and JSON has no NaN.
    lines = [attrs["data-lines"] for _, attrs in Parts(html).tags if "data-lines" in attrs]
    assert "visits: moves made in each state" in " ".join(alts) and "NaN" not in " ".join(lines)
    # The task moves no robot.
    assert "<h2>The robot" not in html and '<figure class="player"' not in html


def test_a_page_of_many_points_says_how_to_list_all(swept, tmp_path, monkeypatch):
    monkeypatch.setattr("humanoid_mjx.report.page._row", lambda *_: [])  # no figures, which take seconds
    monkeypatch.setattr("humanoid_mjx.report.page.ROWS", 3)
    folder = Path(shutil.copytree(swept, tmp_path / "run"))
    ((caption, rows),) = re.findall(r"<caption>(The best.*?)</caption>.*?<tbody>(.*?)</tbody>", report(folder))
    (words,) = re.findall(r"The best 3 of 4 points; (humanoid_mjx\..*) lists all, best first", unescape(caption))
    every = eval(words, {"humanoid_mjx": humanoid_mjx})
    points = [int(row) for row in re.findall(r'<tr><td class="number">(\d+)<', rows)]
    assert points == [each["point"] for each in every][:3] and len(every) == 4


@pytest.mark.parametrize(
    ("commit", "commands"),
    [
        ("0" * 40, f"git checkout {'0' * 40}\npip install -e . jax==1.0"),
        (f"{'0' * 40}-dirty", f"git checkout {'0' * 40}\npip install -e . jax==1.0"),
        (None, "pip install humanoid-mjx==0.1.0 jax==1.0"),
        ("main; reboot", "pip install humanoid-mjx==0.1.0 jax==1.0"),
    ],
)
def test_a_page_says_which_code_to_run_again(swept, tmp_path, monkeypatch, commit, commands):
    monkeypatch.setattr("humanoid_mjx.report.page._row", lambda *_: [])  # no figures, which take seconds
    folder = tmp_path / "run"
    shutil.copytree(swept, folder)
    versions = {"humanoid-mjx": "0.1.0", "jax": "1.0"}
    (folder / "provenance.json").write_text(json.dumps({"versions": versions, "commit": commit}))
    html = report(folder)
    assert f"<pre>{commands}\nhumanoid-mjx sweep" in html
    assert ("Files differed from that commit" in html) == str(commit).endswith("-dirty")


def test_the_config_that_a_page_offers_runs_the_same_sweep(swept, html, tmp_path):
    (address,) = [attrs["href"] for _, attrs in Parts(html).tags if attrs.get("download") == "tiny.yaml"]
    (tmp_path / "tiny.yaml").write_bytes(base64.b64decode(address.partition("base64,")[2]))
    again = sweep(str(tmp_path / "tiny.yaml"), tmp_path / "again").path
    assert (again / "results.parquet").read_bytes() == (swept / "results.parquet").read_bytes()


def test_hostile_text_of_a_run_is_text(swept, tmp_path, monkeypatch):
    """A config that holds such text is refused; the page does not rely on that."""
    folder = tmp_path / "run <b> $a$ & co"
    shutil.copytree(swept, folder)
    config = read_config(folder)
    changed = config | {"task": config["task"] | {"name": HOSTILE}}
    monkeypatch.setattr("humanoid_mjx.report.page.read_config", lambda path: changed | {"name": HOSTILE})
    (folder / "provenance.json").write_text(json.dumps({"seed": HOSTILE, "versions": {"jax": HOSTILE, HOSTILE: 1}}))
    html = report(folder)
    assert_nothing_gets_in(html)
    assert "&lt;script&gt;window.hacked=1" in html


def test_findings_are_compared_and_their_figures_shown(tmp_path):
    others = [FINDING | {"name": HOSTILE, "quantity": HOSTILE, "why": HOSTILE, "printed": HOSTILE, "verdict": HOSTILE}]
    (tmp_path / "reproduce.json").write_text(json.dumps([FINDING, *others]))
    for name in ("table-7.1-way.png", "other.png"):
        (tmp_path / name).write_bytes(b"\x89PNG")
    Setting({}, tmp_path, name="table-7.1").table(("state", ""), [("a & b", 1.5), ("", 2.5)])
    runs = [{"machine": {"cpu": HOSTILE}, "versions": {"jax": "9.9"}, "commit": "f" * 40}]
    runs[0]["times"] = {"table-7.1": {"wall_s": 1.25, "cpu_s": 2.0}}
    (tmp_path / "reproduce_runs.json").write_text(json.dumps(runs))
    html = report(tmp_path)
    assert_nothing_gets_in(html)
    for words in (
        *("23, 1e-07", "steps: 24", "1 differs", "table-7.1-way.png", "More figures", "<td>a &amp; b</td><td"),
        *("humanoid-mjx reproduce table-7.1", "<caption>table-7.1.md</caption>"),
        *("<dd>1.2</dd>", f"<dd>{'f' * 40}</dd>", "<dd>9.9</dd>"),
    ):
        assert words in html
    assert html.index("table-7.1-way.png") < html.index("More figures") < html.index("other.png")


@pytest.mark.parametrize("content", ["", "{}", '[{"name": "table-7.1"}]', "[1]"])
def test_damaged_findings(tmp_path, content):
    (tmp_path / "reproduce.json").write_text(content)
    with pytest.raises(InputError, match=r"reproduce\.json: this "):
        report(tmp_path)


def test_what_cannot_be_reported(tmp_path, swept, monkeypatch):
    (tmp_path / "empty").mkdir()
    with pytest.raises(InputError, match=r"neither a run folder .* nor what reproduce has written"):
        report(tmp_path / "empty")
    with pytest.raises(InputError, match="there is no such folder"):
        report(tmp_path / "none", "--out", str(tmp_path / "x.html"))
    with pytest.raises(InputError, match="there is no folder"):
        report(swept, "--out", str(tmp_path / "none" / "x.html"))
    # Where a run has only been called by its name, its folder is said.
    (tmp_path / "runs").symlink_to(swept.parent)
    monkeypatch.chdir(tmp_path)
    with pytest.raises(InputError, match=f"there is no such folder, but runs/{swept.name} is one"):
        report(Path(swept.name))


def test_a_film_as_data_is_the_motion():
    model = make_robot("lower_body").spec().compile()
    qpos = np.tile(model.qpos0, (5, 1))
    qpos[:, 0] = np.linspace(0.0, 0.4, 5)
    data = film_data(Film(model, qpos, 0.04))
    torso = next(i for i, shape in enumerate(data["shapes"]) if shape["color"] == [0.6, 0.6, 0.6])
    np.testing.assert_allclose([frame[torso][0] for frame in data["frames"]], qpos[:, 0], atol=1e-4)
    np.testing.assert_allclose([frame[torso][3:] for frame in data["frames"]], [[1, 0, 0, 0]] * 5, atol=1e-4)
    assert data["grid"] and len(data["frames"]) == 5
