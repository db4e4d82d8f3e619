"""The documentation: what a reader types works, links lead somewhere, and figures are those of their records."""

import ast
import importlib.util
import json
import math
import os
import re
import shutil
import subprocess
import sys
from pathlib import Path

import pyarrow.parquet as pq
import pytest
from docs_reader import Reader, blocks, commands, type_commands

from humanoid_mjx import compute
from humanoid_mjx.spec import InputError

ROOT = Path(__file__).parent.parent
DOCS = ROOT / "docs"
PAGES = {
    str(path.relative_to(ROOT)): path for path in (*DOCS.rglob("*.md"), ROOT / "README.md", ROOT / "CONTRIBUTING.md")
}
TEXTS = {name: path.read_text(encoding="utf-8") for name, path in PAGES.items()}
TYPED = [name for name, text in TEXTS.items() if "```" in text or "`humanoid-mjx " in text]
COMMANDS_ONLY = {"docs/results.md"}
"""Pages whose Python needs packages that are not installed here."""


def build_module():
    sys.path.append(str(DOCS))  # where it finds its own modules
    spec = importlib.util.spec_from_file_location("docs_build", DOCS / "build.py")
    module = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(module)
    return module


def test_figures_of_pages_are_those_of_the_records():
    build = build_module()
    assert [name for name, text in TEXTS.items() if build.written(text) != text] == []
    assert set(re.findall(r"<!-- record: (\w+) -->", "".join(TEXTS.values()))) == set(build.FIGURES)


def test_speeds_are_compared_with_the_first_of_their_group():
    rows = [("a", 8, 100.0), ("a", 2, 7.0), ("b mujoco", 1, 25.0), ("c", 8, 400.0), ("g", 2, 1.0)]
    failed = {"d": "numba is not installed", "e": "took longer than 9 s"}
    found = {
        "records": [dict(zip(("subject", "batch", "value"), row, strict=True)) for row in rows],
        "failed": [{"subject": name, "why": why} for name, why in failed.items()],
    }
    cells = build_module().tables._rates(found, 8, {name: name for name in ("a", "b mujoco", "c", "d", "e", "f", "g")})
    expected = ["100", "25 (4.0 times slower)", "400 (4.0 times faster)", "not installed", "not measured", "", ""]
    assert cells == expected


def test_records_older_than_what_they_measure_are_found(tmp_path):
    stale = build_module().stale
    records = {path.stem: path.read_text(encoding="utf-8") for path in (DOCS / "bench").glob("*.json")}
    paths = {path for name in records for path in stale.paths_of(name)}
    assert [path for path in paths if not (ROOT / path).exists()] == []
    if shutil.which("git") is None:
        pytest.skip("there is no git here")

    def git(*words):
        given = ["git", "-c", "user.name=a", "-c", "user.email=a@b", *words]
        return subprocess.run(given, cwd=tmp_path, check=True, capture_output=True, text=True).stdout.strip()

    git("init", "-q")
    commits = []
    for path in ("learners/a.py", "report/b.py", "mechanics/c.py"):
        (tmp_path / "humanoid_mjx" / path).parent.mkdir(parents=True)
        (tmp_path / "humanoid_mjx" / path).write_text(path)
        git("add", "-A")
        git("commit", "-q", "-m", path)
        commits.append(git("rev-parse", "HEAD"))
    first, second, last = (f'"commit": "{commit}"' for commit in commits)
    old = {"walk": first, "parity": first, "stand": second + last, "squat": last, "other": '"commit": "0000000"'}
    lost = {"other": ("0000000", math.inf)}
    assert stale.stale(tmp_path, old) == {"walk": (commits[0], 1), "stand": (commits[1], 1)} | lost


def test_the_notebook_holds_what_its_page_runs():
    """`test_python_of_a_page_works` runs the page, in the order of the notebook's cells."""
    build = build_module()
    text = (DOCS / "notebook.ipynb").read_text(encoding="utf-8")
    assert text == build.notebook()
    cells = ["".join(cell["source"]) for cell in json.loads(text)["cells"] if cell["cell_type"] == "code"]
    run = [block.text.strip() for block in blocks(TEXTS["docs/ten_lines.md"]) if not block.title]
    assert cells == run and len(cells) == 6


RUN = [name for name in TYPED if re.search(r"```python|title=", TEXTS[name]) and name not in COMMANDS_ONLY]
"""Pages whose Python is run."""


@pytest.fixture(scope="module")
def readings(tmp_path_factory):
    """The exit code of a reader of each page in `RUN`, and what the reader saw. The page's Python begins with no name
    defined, and with nothing of the package imported but the command line."""
    folder = tmp_path_factory.mktemp("pages")
    run_alone([str(ROOT / "tests" / "docs_reader.py"), str(folder), *(str(PAGES[name]) for name in RUN)], folder)
    places = [folder / str(number) for number in range(len(RUN))]
    return {
        name: [(place / file).read_text() for file in ("code", "said")] for name, place in zip(RUN, places, strict=True)
    }


@pytest.mark.parametrize("name", RUN)
def test_python_of_a_page_works(name, readings):
    code, said = readings[name]
    assert code == "0", said[-5000:]


@pytest.mark.parametrize("name", [name for name in TYPED if name not in RUN])
def test_commands_of_a_page_exist(name, tmp_path, monkeypatch):
    if name == "docs/robots.md":
        pytest.importorskip("mujoco_playground", reason="its robots are those of MuJoCo Playground")
    monkeypatch.chdir(tmp_path)
    monkeypatch.setattr(compute, "start", lambda **_: None)
    type_commands(TEXTS[name])
    for block in blocks(TEXTS[name]):
        if block.language == "python":
            ast.parse(block.text, name)


def run_alone(arguments, folder):
    environment = os.environ | {"PYTHONPATH": str(ROOT), "MPLBACKEND": "Agg"}
    command = [sys.executable, *arguments]
    done = subprocess.run(command, cwd=folder, env=environment, capture_output=True, text=True, check=False)
    assert done.returncode == 0, f"{done.stdout[-2000:]}\n{done.stderr[-3000:]}"


OPTUNA = """
class Study:
    told, ask = {}, lambda self: self
    TPESampler = staticmethod(lambda constant_liar: None)
    best_params, best_value = property(lambda self: len(self.told)), property(lambda self: min(self.told.values()))
    def suggest_float(self, name, low, high, log=False):
        return low + (high - low) * (0.1 + len(self.told)) / 10
    def tell(self, trial, value):
        self.told[len(self.told)] = value
samplers, create_study = Study, lambda sampler: Study()
"""
"""A package of the name of Optuna, with what the page uses of it."""


def test_a_search_of_the_page_asks_for_batches_and_tells_what_they_reached(tmp_path):
    (study,) = (block.text for block in blocks(TEXTS["docs/sweeps.md"]) if block.title == "study.py")
    for long, short in (("range(10)", "range(2)"), ("range(100)", "range(3)"), ('"episodes": 400', '"episodes": 4')):
        assert study.count(long) == 1
        study = study.replace(long, short)
    (tmp_path / "study.py").write_text(study + "assert study.best_params == 6 and 0 < study.best_value <= 100\n")
    (tmp_path / "optuna.py").write_text(OPTUNA)
    run_alone(["study.py"], tmp_path)
    assert pq.read_table(tmp_path / "runs/study-1/summary.parquet")["point"].to_numpy().max() == 2


@pytest.mark.slow
def test_the_cart_pole_of_the_page_learns_to_balance(tmp_path):
    """By the page's two files and its command; here one learning rate, one seed and half as many steps."""
    for block in blocks(TEXTS["docs/own.md"]):
        if (block.title or "").startswith("cart_pole."):
            (tmp_path / block.title).write_text(block.text)
    changes = "learner.learning_rate=0.001", "seeds=1", "total_steps=100_000"
    settings = [word for change in changes for word in ("--set", change)]
    run_alone(["-m", "humanoid_mjx", "sweep", "cart_pole.yaml", *settings], tmp_path)
    assert pq.read_table(tmp_path / "runs/cart_pole/summary.parquet")["greedy_success"].to_numpy().max() > 0.9


@pytest.mark.parametrize(
    "line",
    [
        *("humanoid-mjx swep joint1", "humanoid-mjx sweep joint_one", "humanoid-mjx sweep joint1 --sets seeds=1"),
        *("humanoid-mjx sweep joint1 --set learner.epsilom=1", "humanoid-mjx evaluate runs/never_trained"),
        *("humanoid-mjx reproduce table-9.9", "humanoid-mjx bench compare old.json new.json", "rm -r runs"),
    ],
)
def test_the_reader_refuses_what_is_wrong(line):
    (words,) = commands(f"```bash\n{line}\n```\n")
    with pytest.raises((AssertionError, InputError)):
        Reader().type(words)


def anchors(markdown):
    """The identifiers of a page's headings."""
    for heading in re.findall(r"^#+ (.+)$", re.sub(r"^```.*?^```", "", markdown, flags=re.M | re.S), re.M):
        named = re.findall(r"\{ #([\w-]+) \}", heading)
        yield named[0] if named else re.sub(r"[^\w]+", "-", heading.lower()).strip("-")


@pytest.mark.parametrize("name", TEXTS)
def test_links_and_pictures_lead_somewhere(name):
    folder = PAGES[name].parent
    for target in re.findall(r"\]\(([^)\s]+)\)", re.sub(r"^```.*?^```", "", TEXTS[name], flags=re.M | re.S)):
        path, _, anchor = target.partition("#")
        place = Path(os.path.normpath(folder / path)) if path else PAGES[name]
        assert place.exists(), f"{name}: {target}"
        if anchor:
            assert anchor in set(anchors(place.read_text(encoding="utf-8"))), f"{name}: {target}"
