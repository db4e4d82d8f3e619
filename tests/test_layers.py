"""The structure that CONTRIBUTING draws: nothing imports from its right, and no modules form a circle."""

import ast
import re
from graphlib import TopologicalSorter
from pathlib import Path

ROOT = Path(__file__).parent.parent
PACKAGE = "humanoid_mjx"


def modules():
    """The file of each module, by its dotted name."""
    files = (ROOT / PACKAGE).rglob("*.py")
    dotted = {".".join(file.relative_to(ROOT).with_suffix("").parts): file for file in files}
    return {name.removesuffix(".__init__"): file for name, file in dotted.items()}


def imports(tree, known):
    """The modules among the known that a module imports anywhere, at its head or in a function."""
    for node in ast.walk(tree):
        if isinstance(node, ast.ImportFrom) and (node.module or "").startswith(PACKAGE):
            for alias in node.names:
                inner = f"{node.module}.{alias.name}"
                yield inner if inner in known else node.module
        elif isinstance(node, ast.Import):
            yield from (alias.name for alias in node.names if alias.name in known)


def back_arrows(arrows, layers):
    """Imports from the right: `layers` names groups of folders, from left to right."""
    rank = {name: place for place, group in enumerate(layers) for name in group}
    found = []
    for one, others in arrows.items():
        for other in others:
            source, target = (f"{name}.".split(".")[1] for name in (one, other))
            if source != target and rank.get(target, -1) >= rank.get(source, len(layers)):
                found.append((one, other))
    return found


def drawn():
    (line,) = re.findall(r"^ +(config -> .+)$", (ROOT / "CONTRIBUTING.md").read_text(encoding="utf-8"), re.M)
    return [group.split(", ") for group in line.split(" -> ")]


def test_nothing_imports_from_its_right_or_in_a_circle():
    files, layers = modules(), drawn()
    arrows = {name: set(imports(ast.parse(file.read_text()), files)) for name, file in files.items()}
    assert {folder.name for folder in (ROOT / PACKAGE).iterdir() if (folder / "__init__.py").exists()} <= {
        name for group in layers for name in group
    }
    assert sum(map(len, arrows.values())) > 500
    assert back_arrows(arrows, layers) == []
    TopologicalSorter(arrows).prepare()  # raises CycleError


def test_a_back_arrow_is_seen():
    layers = [["robot"], ["tasks"], ["bench", "report"]]
    arrows = {f"{PACKAGE}.tasks.walk": {f"{PACKAGE}.robot", f"{PACKAGE}.spec"}}
    assert back_arrows(arrows, layers) == []
    arrows[f"{PACKAGE}.bench.legs"] = {f"{PACKAGE}.report.page"}
    arrows[f"{PACKAGE}.robot"] = {f"{PACKAGE}.tasks"}
    assert len(back_arrows(arrows, layers)) == 2


def test_docstrings_begin_with_a_noun_or_an_imperative():
    begin = re.compile(r'"""(what|how|whether|which|where|who|it|they|that|this|these)\b.*', re.IGNORECASE)
    assert not [found[0] for file in modules().values() for found in begin.finditer(file.read_text(encoding="utf-8"))]
