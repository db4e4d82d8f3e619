"""Build the documentation, with the pages that follow from the code and the figures that follow from records.

python docs/build.py          # into build/site; fails at a link that leads nowhere
python docs/build.py serve    # on this machine, at the address that it prints
python docs/build.py tables   # only writes the figures of README.md and docs/*.md, as the two above do first, and draws
                              # docs/throughput.png
"""

import json
import re
import shutil
import subprocess
import sys
from collections.abc import Iterable
from pathlib import Path
from typing import Any

DOCS = Path(__file__).parent
ROOT = DOCS.parent
sys.path.append(str(ROOT / "experiments"))  # tables of verdicts are made by what computes these

import stale  # noqa: E402, F401
import tables  # noqa: E402
import throughput  # noqa: E402
import walking_tables  # noqa: E402

PACKAGE = ROOT / "humanoid_mjx"

NOT_DOCUMENTED = {"__init__", "__main__", "cli", "commands"}
"""Modules and folders that the reference leaves out: the command line documents itself."""

FIGURES = tables.TABLES | walking_tables.TABLES
"""What makes each table and number that follows from records, by the name between its marks."""


def written(page: str) -> str:
    """Return the text of a page with all figures between its marks written anew from their records."""

    def place(match: re.Match[str]) -> str:
        text = FIGURES[match[2]]()
        return match[1] + (f"\n\n{text}\n\n" if "\n" in text else text) + match[3]

    return re.sub(r"(<!-- record: (\w+) -->).*?(<!-- end -->)", place, page, flags=re.DOTALL)


def write_tables() -> None:
    """Write the figures of README.md and of every page in `docs/`."""
    for path in (ROOT / "README.md", *DOCS.glob("*.md")):
        path.write_text(written(path.read_text(encoding="utf-8")), encoding="utf-8")
    (DOCS / "notebook.ipynb").write_text(notebook(), encoding="utf-8")


def notebook() -> str:
    """Return a notebook of the text and the Python of docs/ten_lines.md up to what needs other packages."""
    text = (DOCS / "ten_lines.md").read_text(encoding="utf-8").partition("## An environment of gymnax")[0]
    cells: list[dict[str, Any]] = []
    for number, part in enumerate(re.split(r"^```(?:python)?\n", text, flags=re.MULTILINE)):
        kind = (
            {"cell_type": "code", "execution_count": None, "outputs": []} if number % 2 else {"cell_type": "markdown"}
        )
        words = re.sub(r"^!\[.*\n|\]\([^)]*\.md[^)]*\)", lambda m: "]" * (m[0][0] == "]"), part, flags=re.MULTILINE)
        lines = (words if number % 2 == 0 else part).strip().splitlines(keepends=True)
        cells.append(kind | {"id": f"cell-{number}", "metadata": {}, "source": lines})
    kernel = {"kernelspec": {"display_name": "Python 3", "language": "python", "name": "python3"}}
    found = {"cells": cells, "metadata": kernel, "nbformat": 4, "nbformat_minor": 5}
    return json.dumps(found, indent=1, ensure_ascii=False) + "\n"


def pages() -> dict[str, str]:
    """The Markdown of every generated page, by its path in `docs/`."""
    return {"keys.md": keys_page(), "errata.md": errata_page()} | reference_pages()


def keys_page() -> str:
    """Every key of a config, as `humanoid-mjx info NAME --keys` shows them task by task."""
    from humanoid_mjx.config import Config
    from humanoid_mjx.control.drives import DRIVES, Drive
    from humanoid_mjx.control.laws import LAWS, Law
    from humanoid_mjx.keys import keys_of
    from humanoid_mjx.learners import LEARNERS, Learner
    from humanoid_mjx.robot.declared import Declaration
    from humanoid_mjx.spec import find
    from humanoid_mjx.tasks import TASKS
    from humanoid_mjx.tasks.base import Task
    from humanoid_mjx.tasks.legged.gait import GAITS, Gait

    parts = [KEYS_HEAD, _top_level(Config)]
    laws = "## Control laws\n\nA task of a robot takes each of them by its name: `control: {name: pd}`.\n"
    gaits = "## Gaits\n\n`walk` takes each of them by its name: `gait: {name: clock}`.\n"
    drives = "## Actuators\n\n`stand` and `walk` take each of them by its name: `actuator: {name: dc_motor}`.\n"
    for kind, heading, registry, base in (
        ("task", "## Tasks\n", TASKS, Task),
        ("learner", "## Learners\n", LEARNERS, Learner),
        ("control", laws, LAWS, Law),
        ("gait", gaits, GAITS, Gait),
        ("actuator", drives, DRIVES, Drive),
    ):
        parts.append(heading)
        for name in registry:
            cls = find(kind, registry, base, name)
            parts.append(f"### {name} {{ #{kind}-{name} }}\n\n{_first_sentence(cls)}\n\n{_table(keys_of(cls, kind))}")
    keys = [key._replace(name=key.name.removeprefix("robot.")) for key in keys_of(Declaration, "robot")]
    parts.append(f"## Robots\n\nThe keys of a robot's YAML; see [Your robot](your_robot.md).\n\n{_table(keys)}")
    return "\n".join(parts)


KEYS_HEAD = """# Every key of a config

This page is made from the classes that check a config. The command line shows the same, for one task or learner, with
`humanoid-mjx info NAME --keys`.

*Traced* keys are data of the compiled program: a sweep over them compiles once. *Static* keys shape the program: points
that differ in them compile apart. A key without a default is required, or follows from others.
"""


def _top_level(config: Any) -> str:
    """The keys beside `task` and `learner`."""
    meanings = {
        "name": "names the run folder",
        "task": "what there is to learn: its `name` and keys",
        "learner": "how to learn it: its `name` and keys",
        "sweep": "`mode`, `axes` and, in mode `random`, `points`; see [Sweeps](sweeps.md)",
        "seeds": "runs of every point",
        "seed": "the seed from which all others follow",
        "record": "points of a learning curve",
    }
    lines = ["## The top level\n", "| key | default | meaning |", "|---|---|---|"]
    for name, field in config.model_fields.items():
        default = "" if field.is_required() or field.default is None else f"`{field.default}`"
        lines.append(f"| `{name}` | {default} | {field.description or meanings[name]} |")
    return "\n".join(lines) + "\n"


def _table(keys: Iterable[Any]) -> str:
    lines = ["| key | default | meaning, and what it may be |", "|---|---|---|"]
    for key in keys:
        default = f"`{key.default}`" if key.default else ""
        meaning = f"{_escaped(key.meaning)}<br>" if key.meaning else ""
        values = f"*{_escaped(key.allowed)}; {'traced' if key.traced else 'static'}*"
        lines.append(f"| `{key.name}` | {default} | {meaning}{values} |")
    return "\n".join(lines) + "\n"


def _first_sentence(cls: Any) -> str:
    return (cls.__doc__ or "").strip().split("\n\n")[0].replace("\n", " ")


def _escaped(text: str) -> str:
    """Text that may stand in a cell of a table."""
    return text.replace("|", "\\|").replace("*", "\\*")


def errata_page() -> str:
    """The printed formulas that can be evaluated, with the fault of each."""
    from humanoid_mjx.reproduction.errata import ENTRIES

    wrong = [entry for entry in ENTRIES if entry.fault != "none"]
    right = [entry for entry in ENTRIES if entry.fault == "none"]
    lines = [ERRATA_HEAD, "| where | what is wrong | what it should be |", "|---|---|---|"]
    lines += [f"| {_escaped(e.place)} | {_escaped(e.fault)} | {_escaped(e.fix)} |" for e in wrong]
    lines += ["\n## Right as printed\n", *(f"* {_escaped(e.place)}" for e in right)]
    return "\n".join(lines) + "\n"


ERRATA_HEAD = """# Errata of the thesis

Each formula of the thesis that can be evaluated is kept *as printed* in
[reproduction/printed/](../humanoid_mjx/reproduction/printed) and compared with a right one at random postures. Nothing
else uses the printed ones. This page is made from that list. How far each is off, in numbers, is what the command
computes; it writes `reproduced/errata.md`:

```bash
humanoid-mjx reproduce errata
```

Tables, figures and statements that disagree with what is computed have a verdict of their own: see
[Every figure, table and equation](thesis.md).
"""


def reference_pages() -> dict[str, str]:
    """A page for each folder of the package, whose text mkdocstrings takes from the docstrings."""
    found = {}
    for folder in (file.parent for file in PACKAGE.rglob("__init__.py") if file.parent.name not in NOT_DOCUMENTED):
        name, modules = _dotted(folder), sorted(file.stem for file in folder.glob("*.py"))
        # Names that a folder only passes on are documented in their modules.
        passes_on = "__all__" in (folder / "__init__.py").read_text()
        own = [] if folder == PACKAGE else [f"::: {name}" + "\n    options: {members: []}" * passes_on]
        blocks = [f"::: {name}.{module}" for module in modules if module not in NOT_DOCUMENTED]
        found[f"reference/{name}.md"] = "\n\n".join([f"# {name}", *own, *blocks]) + "\n"
    return found


def _dotted(path: Path) -> str:
    """The import path of a folder or a module."""
    return ".".join(path.relative_to(PACKAGE.parent).with_suffix("").parts)


def source_links(markdown: str) -> str:
    """Markdown whose links to files of the package lead to their place in the reference."""

    def place(match: re.Match[str]) -> str:
        return f"][humanoid_mjx.{_dotted(PACKAGE / match['path']).partition('.')[2]}]"

    return re.sub(r"\]\((?:\.\./)+humanoid_mjx/(?P<path>[^)#]+?)/?\)", place, markdown)


NAMES = "tasks.md"
"""The page whose tables name tasks, learners, control laws and gaits."""


def generated_links(markdown: str, page: str) -> str:
    """Markdown that leads to the pages that follow from the code, which a checkout does not have: from their titles,
    which stand emphasised, and on the page of names from the first column of its tables."""
    made = pages()
    for path, text in made.items():
        title = text.partition("\n")[0].removeprefix("# ")
        markdown = markdown.replace(f"*{title}*", f"[{title}]({path})")
    if page == NAMES:
        anchors = {name: kind for kind, name in re.findall(r"\{ #(\w+)-(\w+) \}", made["keys.md"])}
        for name, kind in anchors.items():
            markdown = markdown.replace(f"\n| `{name}` |", f"\n| [`{name}`](keys.md#{kind}-{name}) |")
    return markdown


def stage(folder: Path) -> None:
    """Put all that the site is made of into `folder`: the pages of `docs/`, those that follow from the code, pictures.

    Links to files of the package lead into the reference there, and pages to those that follow from the code. What
    `folder` held before is gone.
    """
    shutil.rmtree(folder, ignore_errors=True)
    shutil.copytree(DOCS, folder, ignore=shutil.ignore_patterns("*.py", "__pycache__"))
    for path, text in pages().items():
        (folder / path).write_text(text, encoding="utf-8")
    for page in folder.rglob("*.md"):
        text = generated_links(page.read_text(encoding="utf-8"), str(page.relative_to(folder)))
        page.write_text(source_links(text), encoding="utf-8")


def loaded_from_elsewhere(folder: Path) -> list[str]:
    """What the pages in `folder` load from other machines; links that a reader may follow are none of it."""
    tags = re.compile(r"<(?:script|img|link|iframe|source)\b[^>]*?(?:src|href)=[\"']?((?:https?:)?//[^\"'\s>]+)")
    found = [(page, match) for page in folder.rglob("*.html") for match in tags.findall(page.read_text("utf-8"))]
    return sorted(f"{page.relative_to(folder)}: {address}" for page, address in found)


def main() -> None:
    """Write the figures; then build the site, or with `serve` show it while it is written."""
    write_tables()
    if sys.argv[1:] == ["tables"]:
        throughput.draw(DOCS / "throughput.png")
        return
    stage(ROOT / "build" / "docs")
    arguments = sys.argv[1:] or ["build", "--clean", "--strict"]
    done = subprocess.run([sys.executable, "-m", "zensical", *arguments], cwd=ROOT, check=False)
    if foreign := loaded_from_elsewhere(ROOT / "build" / "site"):
        sys.exit("\n".join(["The site must work offline, but loads from elsewhere:", *foreign]))
    sys.exit(done.returncode)


if __name__ == "__main__":
    main()
