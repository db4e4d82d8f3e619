"""The documentation: what a reader types works, links lead somewhere, and tables say what the code says."""

import ast
import importlib
import importlib.util
import json
import os
import pydoc
import re
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest
import yaml
from docs_reader import Reader, blocks, commands, type_commands

from humanoid_mjx import compute
from humanoid_mjx.bench import BENCHES
from humanoid_mjx.control.laws import LAWS
from humanoid_mjx.keys import keys_of
from humanoid_mjx.learners import LEARNERS, Learner
from humanoid_mjx.robot import make_robot
from humanoid_mjx.robot.lower_body import JOINTS
from humanoid_mjx.spec import InputError, find
from humanoid_mjx.tasks import TASKS
from humanoid_mjx.tasks.base import Task
from humanoid_mjx.tasks.legged.gait import GAITS

ROOT = Path(__file__).parent.parent
DOCS = ROOT / "docs"
PAGES = {
    str(path.relative_to(ROOT)): path for path in (*DOCS.rglob("*.md"), ROOT / "README.md", ROOT / "CONTRIBUTING.md")
}
COMMANDS_ONLY = {"docs/results.md"}
"""Pages whose Python `test_results_doc.py` runs."""


def build_module():
    sys.path.append(str(DOCS))  # where it finds its own modules
    spec = importlib.util.spec_from_file_location("docs_build", DOCS / "build.py")
    module = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(module)
    return module


BUILD = build_module()
GENERATED = BUILD.pages()
TEXTS = {name: path.read_text(encoding="utf-8") for name, path in PAGES.items()}
TYPED = [name for name, text in TEXTS.items() if "```" in text or "`humanoid-mjx " in text]


def test_figures_of_pages_are_those_of_the_records():
    assert [name for name, text in TEXTS.items() if BUILD.written(text) != text] == []
    assert not re.search(r"^<!-- record: \w+ -->.", "\n".join(TEXTS.values()), re.M), "it would end the paragraph"
    assert set(re.findall(r"<!-- record: (\w+) -->", "".join(TEXTS.values()))) == set(BUILD.FIGURES)


@pytest.mark.parametrize("name", BUILD.FIGURES)
def test_a_record_that_changes_changes_the_page(name, monkeypatch):
    def changed(of):
        """The record with other numbers, but for sizes, by which rows are found."""
        text, tripled = (DOCS / "bench" / f"{of}.json").read_text(), (lambda x: int(x) * (3 if len(x) < 4 else 1))
        return json.loads(text, parse_float=lambda x: 2 * float(x) + 1, parse_int=tripled)

    before = BUILD.FIGURES[name]()
    for module in (BUILD.tables, BUILD.walking_tables):
        monkeypatch.setattr(module, "record", changed)
    assert BUILD.FIGURES[name]() != before


def test_what_was_tried_went_well():
    rows = BUILD.tables.record("faults")["rows"]
    assert all(sum(row["outcomes"].values()) == row["tries"] > 0 and not row["wrong"] for row in rows)
    killed = [row for row in rows if row["fault"].startswith("kill -9")]
    assert {row["subject"] for row in killed if set(row["outcomes"]) == {"resumed to the same bits"}} == set(LEARNERS)


@pytest.mark.parametrize("name", TYPED)
def test_what_a_reader_types_works(name, tmp_path, monkeypatch):
    if re.search(r"```python|title=", TEXTS[name]) and name not in COMMANDS_ONLY:
        in_a_process_of_its_own(PAGES[name], tmp_path)
    else:
        monkeypatch.chdir(tmp_path)
        monkeypatch.setattr(compute, "start", lambda **_: None)
        type_commands(TEXTS[name])


@pytest.mark.parametrize("name", [name for name, text in TEXTS.items() if "```python" in text])
def test_python_of_a_page_parses(name):
    for block in blocks(TEXTS[name]):
        if block.language == "python":
            ast.parse(block.text, name)


def in_a_process_of_its_own(page, folder):
    """A reader's: with the page's Python, where nothing is imported yet."""
    script = ROOT / "tests" / "docs_reader.py"
    environment = os.environ | {"PYTHONPATH": str(ROOT), "MPLBACKEND": "Agg"}
    command = [sys.executable, str(script), str(page)]
    done = subprocess.run(command, cwd=folder, env=environment, capture_output=True, text=True, check=False)
    assert done.returncode == 0, f"{done.stdout[-2000:]}\n{done.stderr[-3000:]}"


def test_the_reader_sees_what_is_wrong():
    """Each of these is refused, so that a page with one would be found."""
    wrong = (
        "humanoid-mjx swep joint1",
        "humanoid-mjx sweep joint_one",
        "humanoid-mjx sweep joint1 --sets seeds=1",
        "humanoid-mjx sweep joint1 --set learner.epsilom=1",
        "humanoid-mjx evaluate runs/never_trained",
        "humanoid-mjx evaluate stand --physics newton",
        "humanoid-mjx reproduce table-9.9",
        "humanoid-mjx bench compare old.json new.json",
        "rm -r runs",
    )
    for line in wrong:
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
        assert "://" not in target, "this site names no addresses"
        path, _, anchor = target.partition("#")
        place = Path(os.path.normpath(folder / path)) if path else PAGES[name]
        assert place.exists(), f"{name}: {target}"
        if anchor:
            assert anchor in set(anchors(place.read_text(encoding="utf-8"))), f"{name}: {target}"


@pytest.mark.parametrize("name", [name for name, text in TEXTS.items() if "][humanoid_mjx" in text])
def test_names_that_lead_into_the_reference_exist(name):
    for dotted in re.findall(r"\]\[(humanoid_mjx[\w.]*)\]", TEXTS[name]):
        assert pydoc.locate(dotted) is not None, dotted


def test_links_to_the_code_lead_into_the_reference():
    markdown = "[a](../humanoid_mjx/control/pd.py), [b](../humanoid_mjx/control), [c](../../humanoid_mjx/control/)"
    wanted = "[a][humanoid_mjx.control.pd], [b][humanoid_mjx.control], [c][humanoid_mjx.control]"
    assert BUILD.source_links(markdown) == wanted
    for text in TEXTS.values():
        for dotted in re.findall(r"\]\[(humanoid_mjx[\w.]*)\]", BUILD.source_links(text)):
            page = next((p for p, t in GENERATED.items() if f"::: {dotted}\n" in t), None)
            assert page or "." in dotted.removeprefix("humanoid_mjx."), dotted


def test_on_the_site_names_and_titles_lead_to_the_pages_that_follow_from_the_code():
    text = BUILD.generated_links(TEXTS["docs/tasks.md"], "tasks.md")
    links = set(re.findall(r"\]\(keys\.md#([\w-]+)\)", text))
    kinds = {"task": TASKS, "learner": LEARNERS, "control": LAWS, "gait": GAITS}
    assert links == {f"{kind}-{name}" for kind, names in kinds.items() for name in names}
    assert links <= set(anchors(GENERATED["keys.md"]))
    linked = "".join(BUILD.generated_links(text, name) for name, text in TEXTS.items())
    assert "[Every key of a config](keys.md)" in linked and "[Errata of the thesis](errata.md)" in linked


def test_every_page_has_its_place_in_the_navigation():
    def leaves(entry):
        if isinstance(entry, str):
            return [entry]
        return [leaf for part in (entry.values() if isinstance(entry, dict) else entry) for leaf in leaves(part)]

    config = yaml.safe_load((ROOT / "mkdocs.yml").read_text(encoding="utf-8"))
    written = {str(path.relative_to(DOCS)) for path in DOCS.rglob("*.md")}
    assert sorted(leaves(config["nav"])) == sorted(written | set(GENERATED))


@pytest.mark.parametrize("name", [*TASKS, *LEARNERS])
def test_the_page_of_keys_has_them_all(name):
    kind, registry, base = ("learner", LEARNERS, Learner) if name in LEARNERS else ("task", TASKS, Task)
    section = GENERATED["keys.md"].split(f"{{ #{kind}-{name} }}\n")[1].split("\n### ")[0]
    for key in keys_of(find(kind, registry, base, name), kind):
        assert f"| `{key.name}` | {f'`{key.default}`' if key.default else ''} | " in section


def test_the_page_of_keys_has_what_is_off_by_default_every_law_and_every_gait():
    text = GENERATED["keys.md"]
    assert "`task.randomise.friction`" in text
    assert all(f"{{ #control-{name} }}" in text for name in LAWS)
    assert all(f"{{ #gait-{name} }}" in text for name in GAITS)


def test_errata_are_those_that_are_computed():
    from humanoid_mjx.reproduction.errata import ENTRIES

    rows = [line for line in GENERATED["errata.md"].splitlines() if line.startswith(("| ", "* "))]
    assert len(rows) == len(ENTRIES) + 1


def test_constants_are_those_of_the_code():
    found = re.findall(r"`([a-z_.]+)\.([A-Z_]+) = ([^`]+)`", TEXTS["docs/open.md"])
    assert len(found) > 8
    for module, name, value in found:
        assert getattr(importlib.import_module(f"humanoid_mjx.{module}"), name) == ast.literal_eval(value), name


def test_records_hold_what_is_said_of_them():
    rows = re.findall(r"^\| \[(\w+\.json)\]\(bench/\1\) \| (.+) \|$", TEXTS["docs/benchmarks.md"], re.M)
    assert {name for name, _ in rows} == {path.name for path in (DOCS / "bench").iterdir()}
    for name, words in rows:
        held = {record["bench"] for record in json.loads((DOCS / "bench" / name).read_text()).get("records", [])}
        assert set(re.findall(r"`(\w+)`", words)) & set(BENCHES) == held & set(BENCHES), name


def test_axes_are_those_of_the_robot():
    model = make_robot("lower_body").spec().compile()
    rows = re.findall(r"^\| `(\w+)` \| [^|]+ \| ([+-][xyz]) \| ([+-][xyz]) \|$", TEXTS["docs/robot.md"], re.M)
    assert [f"{side}_{row[0]}" for side in ("right", "left") for row in rows] == list(JOINTS)
    for joint, *axes in rows:
        for side, axis in zip(("right", "left"), axes, strict=True):
            wanted = np.eye(3)["xyz".index(axis[1])] * (1 if axis[0] == "+" else -1)
            np.testing.assert_array_equal(model.joint(f"{side}_{joint}").axis, wanted)


def test_what_a_page_loads_from_elsewhere_is_found(tmp_path):
    (tmp_path / "fine.html").write_text('<a href="https://there">x</a><img src="here.png"><link href="site.css">')
    assert not BUILD.loaded_from_elsewhere(tmp_path)
    (tmp_path / "page.html").write_text('<script src="https://there/x.js"></script><link rel="x" href="//there/y">')
    assert BUILD.loaded_from_elsewhere(tmp_path) == ["page.html: //there/y", "page.html: https://there/x.js"]
