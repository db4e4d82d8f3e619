"""Mutation testing: put a fault into a line, run the tests that concern its file, and see whether one fails.

python benchmarks/mutants.py --count 40 --seed 0                   # samples all folders; prints what survives
python benchmarks/mutants.py humanoid_mjx/learners/targets.py      # all mutants of a file
python benchmarks/mutants.py humanoid_mjx/learners/*.py --count 40 --tests "tests/learners/test_tabular.py -k terminal"

A mutant exchanges an operator (+ and -, * and /, < and <=, `and` and `or`), negates a comparison, adds 1 to a number,
or takes back a `not`, `~` or sign. It is written into a copy of the package. The tests are those that import the file's
module, and those whose name holds it, or those of `--tests`; a mutant whose tests pass has survived. Files that no test
names are left out.
"""

import argparse
import ast
import json
import os
import random
import shlex
import shutil
import signal
import sys
import tempfile
import time
from collections.abc import Iterator
from copy import deepcopy
from importlib import import_module
from pathlib import Path
from typing import NamedTuple

import pytest

ROOT = Path(__file__).parent.parent
FOLDERS = ("learners", "control", "tasks", "physics", "runs")
LIMIT_S = 900
"""Seconds after which tests are stopped, which counts as a failure: a mutant may loop for ever."""

EXCHANGED: dict[type, type] = {
    ast.Add: ast.Sub, ast.Sub: ast.Add, ast.Mult: ast.Div, ast.Div: ast.Mult, ast.Lt: ast.LtE, ast.LtE: ast.Lt,
    ast.Gt: ast.GtE, ast.GtE: ast.Gt, ast.Eq: ast.NotEq, ast.NotEq: ast.Eq, ast.And: ast.Or, ast.Or: ast.And,
    ast.BitAnd: ast.BitOr, ast.BitOr: ast.BitAnd,
}  # fmt: skip


IMPORTED = ("jax", "jaxtyping", "beartype", "hypothesis", "optax", "flax.linen", "mujoco", "typer.testing", "yaml")
"""Packages that are imported once, before the children of this process begin; none of them begins to compute."""


class Mutant(NamedTuple):
    """A file with one fault."""

    file: Path
    line: int
    change: str
    text: str


def mutants(file: Path) -> Iterator[Mutant]:
    """All mutants of a file, relative to the root of the checkout."""
    tree = ast.parse((ROOT / file).read_text())
    skipped = {id(part) for node in ast.walk(tree) for part in _declared(node)}
    for index, node in enumerate(ast.walk(tree)):
        if id(node) in skipped:
            continue
        for change in _changes(node):
            copy = deepcopy(tree)
            fault = next(other for place, other in enumerate(ast.walk(copy)) if place == index)
            before = ast.unparse(node)
            change(fault)
            after = ast.unparse(fault)
            yield Mutant(file, getattr(node, "lineno", 0), f"{before}  ->  {after}", ast.unparse(copy))


def _declared(node: ast.AST) -> Iterator[ast.AST]:
    """Annotations, bounds and descriptions of fields: no arithmetic; numbers folded into keys: other random numbers."""
    declared = [getattr(node, name, None) for name in ("annotation", "returns")]
    called = (getattr(node.func, "id", ""), getattr(node.func, "attr", "")) if isinstance(node, ast.Call) else ()
    if isinstance(node, ast.Call) and {"Field", "traced", "fold_in"} & set(called):
        declared += [*node.args, *(keyword.value for keyword in node.keywords)]
    for part in filter(None, declared):
        yield from ast.walk(part)


def _changes(node: ast.AST) -> Iterator:
    if isinstance(node, (ast.BinOp, ast.BoolOp, ast.AugAssign)) and type(node.op) in EXCHANGED:
        yield lambda n: setattr(n, "op", EXCHANGED[type(n.op)]())
    if isinstance(node, ast.Compare) and type(node.ops[0]) in EXCHANGED:
        yield lambda n: n.ops.__setitem__(0, EXCHANGED[type(n.ops[0])]())
    if isinstance(node, ast.UnaryOp):
        yield lambda n: setattr(n, "operand", ast.UnaryOp(n.op, n.operand))
    if isinstance(node, ast.Constant) and type(node.value) in (int, float):
        yield lambda n: setattr(n, "value", n.value + 1)


def tests_of(file: Path) -> list[str]:
    """The test files that import a module, or are named after it, those of the fewest lines first."""
    module, found = ".".join(file.with_suffix("").parts), []
    package, _, name = module.rpartition(".")
    for test in sorted((ROOT / "tests").rglob("test_*.py")):
        text = test.read_text()
        imported = module in text or any(
            line.startswith(f"from {package} import") and name in line for line in text.splitlines()
        )
        if imported or name in test.stem:
            found.append((len(text), str(test.relative_to(ROOT))))
    return [test for _, test in sorted(found)]


def survives(mutant: Mutant, tests: list[str]) -> bool:
    """Whether all tests pass with the fault in a copy of the package."""
    with tempfile.TemporaryDirectory() as folder:
        copy = Path(folder)
        for name in ("humanoid_mjx", "configs", "tests", "docs", "experiments", "benchmarks"):
            shutil.copytree(ROOT / name, copy / name, symlinks=True)
        for name in ("pyproject.toml", "README.md"):
            shutil.copy(ROOT / name, copy / name)
        (copy / mutant.file).write_text(mutant.text)
        return all(_pass(copy, test) for test in tests)


def _pass(copy: Path, test: str) -> bool:
    """Whether a test passes in a copy of the checkout, in a child of this process, which has jax imported already."""
    if not (child := os.fork()):
        os.chdir(copy)
        os.dup2(os.open(os.devnull, os.O_WRONLY), 1)
        os.dup2(1, 2)
        sys.path[:0] = [str(copy)]
        os._exit(pytest.main(["-q", "-x", "-n0", "-p", "no:cacheprovider", *shlex.split(test)]))
    ends = time.monotonic() + LIMIT_S
    while time.monotonic() < ends:
        done, status = os.waitpid(child, os.WNOHANG)
        if done:
            return os.waitstatus_to_exitcode(status) == 0
        time.sleep(0.05)
    os.kill(child, signal.SIGKILL)
    os.waitpid(child, 0)
    return False


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("files", nargs="*", type=Path, help="by default all of " + ", ".join(FOLDERS))
    parser.add_argument("--count", type=int, help="mutants to sample; by default all")
    parser.add_argument("--seed", type=int, default=0)
    parser.add_argument("--json", type=Path, help="where to write the result")
    parser.add_argument("--tests", nargs="+", help="arguments of pytest, a string for each call of it")
    given = parser.parse_args()
    folders = [ROOT / "humanoid_mjx" / folder for folder in FOLDERS]
    files = given.files or [path.relative_to(ROOT) for folder in folders for path in sorted(folder.rglob("*.py"))]
    every = [(mutant, tests) for file in files if (tests := given.tests or tests_of(file)) for mutant in mutants(file)]
    chosen = random.Random(given.seed).sample(every, min(given.count or len(every), len(every)))
    os.environ |= {"JAX_NUM_CPU_DEVICES": "2", "JAX_PLATFORMS": "cpu"}
    os.environ.setdefault("JAX_COMPILATION_CACHE_DIR", str(ROOT / ".pytest_cache" / "xla"))
    os.environ.setdefault("JAX_PERSISTENT_CACHE_MIN_COMPILE_TIME_SECS", "0.3")
    for name in IMPORTED:
        import_module(name)
    alive = []
    for number, (mutant, tests) in enumerate(chosen, 1):
        survived = survives(mutant, tests)
        alive += [mutant] * survived
        word = "SURVIVED" if survived else "killed"
        print(f"{number}/{len(chosen)} {word}: {mutant.file}:{mutant.line}: {mutant.change}", flush=True)
    share = 1 - len(alive) / max(len(chosen), 1)
    print(f"{share:.0%} of {len(chosen)} mutants killed, of {len(every)} in {len(files)} files")
    if given.json:
        lines = [f"{mutant.file}:{mutant.line}: {mutant.change}" for mutant in alive]
        given.json.write_text(json.dumps({"killed": share, "sampled": len(chosen), "survived": lines}, indent=1) + "\n")


if __name__ == "__main__":
    main()
