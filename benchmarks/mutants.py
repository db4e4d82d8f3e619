"""Mutation testing: put a fault into a line, run the tests that execute the line, and see whether one fails.

python benchmarks/mutants.py --count 40 --seed 0      # samples all folders; prints what survives
python benchmarks/mutants.py humanoid_mjx/control --workers 12 --seconds 500 --json control.json

A mutant exchanges an operator (+ and -, * and /, < and <=, `and` and `or`), negates a comparison, adds 1 to a number,
or takes back a `not`, `~` or sign. Each is written into a copy of the checkout of its own.

First the calls of pytest in `TESTS` run without a fault, which tells their time and the lines that they execute; tests
that fail there are left out. A mutant meets the calls that execute its statement, the shortest first, or all calls if
none was seen to execute it: Python does not trace threads that XLA starts.
"""

import argparse
import ast
import json
import math
import os
import random
import resource
import shlex
import shutil
import signal
import subprocess
import sys
import tempfile
import time
from collections.abc import Iterator
from copy import deepcopy
from functools import partial
from importlib import import_module
from multiprocessing import get_context
from pathlib import Path
from typing import NamedTuple

import coverage
import pytest

ROOT = Path(__file__).parent.parent
TESTS = {
    "learners": "learners/test_tabular learners/test_approximate learners/test_ppo",
    "control": "control/test_laws control/test_drives "
    "float64/test_controllers float64/test_ground physics/test_physics",
    "tasks": "tasks/test_gait tasks/test_gym tasks/test_leg_reach tasks/test_squat tasks/test_stand tasks/test_legged "
    "tasks/test_own_tasks tasks/test_posture_switch learners/test_tabular",
    "physics": "physics/test_sensors physics/test_physics mechanics/test_tree float64/test_tree float64/test_physics "
    "float64/test_legs float64/test_terrain float64/test_balance as_shipped/test_physics_worlds tasks/test_stand "
    "commands/test_cli",
    "runs": "runs/test_listing runs/test_results runs/test_faults report/test_plot report/test_growing "
    "training/test_cost evaluation/test_evaluate",
}
"""The quick tests of each folder, a call of pytest for each string."""

LIMIT_S, SLOWER = 300, 4
"""Seconds of processor time that a call may take, and how many times longer it may take with a fault, which may loop
for ever. Ten times as long by the clock: other work may run beside."""

EXCHANGED: dict[type, type] = {
    ast.Add: ast.Sub, ast.Sub: ast.Add, ast.Mult: ast.Div, ast.Div: ast.Mult, ast.Lt: ast.LtE, ast.LtE: ast.Lt,
    ast.Gt: ast.GtE, ast.GtE: ast.Gt, ast.Eq: ast.NotEq, ast.NotEq: ast.Eq, ast.And: ast.Or, ast.Or: ast.And,
    ast.BitAnd: ast.BitOr, ast.BitOr: ast.BitAnd,
}  # fmt: skip
IMPORTED = ("jax", "jaxtyping", "beartype", "hypothesis", "optax", "flax.linen", "mujoco", "typer.testing", "yaml")
"""Packages that are imported once, before the children of this process begin; none of them begins to compute."""


class Mutant(NamedTuple):
    """A file with one fault, and the lines of the statement around it."""

    file: Path
    line: int
    change: str
    text: str
    statement: range

    def __str__(self) -> str:
        return f"{self.file}:{self.line}: {self.change}"


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
            line = getattr(node, "lineno", 0)
            yield Mutant(file, line, f"{before}  ->  {after}", ast.unparse(copy), _statement(tree, line))


def _statement(tree: ast.AST, line: int) -> range:
    """The lines of the innermost statement around a line."""
    around = [s for s in ast.walk(tree) if isinstance(s, ast.stmt) and s.lineno <= line <= (s.end_lineno or line)]
    inner = max(around, key=lambda s: s.lineno, default=None)
    return range(inner.lineno, (inner.end_lineno or line) + 1) if inner else range(0)


def _declared(node: ast.AST) -> Iterator[ast.AST]:
    """Annotations, bounds and descriptions of fields, paths: no arithmetic; numbers folded into keys: other numbers."""
    if isinstance(node, ast.BinOp) and isinstance(getattr(node.right, "value", None), str):
        yield node
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


class Call(NamedTuple):
    """A call of pytest on code without a fault, and the lines that it executes in each file of the package."""

    arguments: str
    seconds: float
    code: int | None
    failed: list[str]
    lines: dict[str, list[int]]

    def executes(self, mutant: Mutant) -> bool:
        return not set(mutant.statement).isdisjoint(self.lines.get(str(mutant.file), ()))


class _Failed(list):
    """Plugin of pytest: the names of tests that fail."""

    def pytest_runtest_logreport(self, report):
        self += [report.nodeid] * report.failed


def _run(
    copy: Path, arguments: list[str], limit_s: float, ends: float = float("inf"), record: Path | None = None
) -> tuple[int | None, float]:
    """The exit status of pytest in a copy of the checkout, None where it did not end in time, and its processor time.

    The tests run in a child of this process, which has jax imported already. With `record`, the child writes there the
    names of failed tests and the executed lines of each file.
    """
    if not (child := os.fork()):
        resource.setrlimit(resource.RLIMIT_CPU, (math.ceil(limit_s), math.ceil(limit_s)))
        os.chdir(copy)
        os.dup2(os.dup2(os.open(os.devnull, os.O_WRONLY), 1), 2)
        sys.path[:0] = [str(copy)]
        os.environ["PYTHONPATH"] = os.pathsep.join([str(copy), os.environ.get("PYTHONPATH", "")])
        failed, tracer = _Failed(), coverage.Coverage(data_file=None, include=[f"{copy}/humanoid_mjx/*"])
        if record:
            tracer.start()
        code = pytest.main(["-q", "-n0", "-p", "no:cacheprovider", *arguments], plugins=[failed])
        if record:
            tracer.stop()
            data = tracer.get_data()
            lines = {str(Path(file).relative_to(copy)): data.lines(file) for file in data.measured_files()}
            record.write_text(json.dumps([failed, lines]))
        os._exit(code)
    os.setpgid(child, child)
    ends = min(ends, time.monotonic() + 10 * limit_s)
    done, status, used = 0, 0, None
    while not done and time.monotonic() < ends:
        done, status, used = os.wait4(child, os.WNOHANG)
        time.sleep(0.05)
    if not done:
        os.killpg(child, signal.SIGKILL)
        _, status, used = os.wait4(child, 0)
    code = os.waitstatus_to_exitcode(status)
    return None if code in (-signal.SIGKILL, -signal.SIGXCPU) else code, used.ru_utime + used.ru_stime  # pyright: ignore[reportOptionalMemberAccess]


def without_fault(base: Path, arguments: str) -> Call:
    """A call on the code as it is."""
    record = base.parent / (arguments.replace("/", ".") + ".json")
    code, seconds = _run(base, shlex.split(arguments), LIMIT_S, record=record)
    if not record.exists():
        raise RuntimeError(
            f"{arguments}: the process ended with {code}, whatever the mutant; without a fault it must run"
        )
    return Call(arguments, seconds, code, *json.loads(record.read_text()))


def outcome(base: Path, calls: list[Call], ends: float, mutant: Mutant) -> tuple[Mutant, str]:
    """A mutant, and whether it was killed or survived; an empty word where time was over before."""
    if time.monotonic() >= ends:
        return mutant, ""
    with tempfile.TemporaryDirectory() as folder:
        copy = shutil.copytree(base, Path(folder) / "copy")
        (copy / mutant.file).write_text(mutant.text)
        for call in [call for call in calls if call.executes(mutant)] or calls:
            arguments = ["-x", *shlex.split(call.arguments), *(f"--deselect={name}" for name in call.failed)]
            code, _ = _run(copy, arguments, 60 + SLOWER * call.seconds, ends)
            if code is None and time.monotonic() >= ends:
                return mutant, ""
            if code != 0:
                return mutant, f"killed by {call.arguments}" + (", which did not end" if code is None else "")
    return mutant, "survived"


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("paths", nargs="*", type=Path, help="files or folders; by default all of " + ", ".join(TESTS))
    parser.add_argument("--count", type=int, help="mutants to sample; by default all")
    parser.add_argument("--seed", type=int, default=0)
    parser.add_argument("--json", type=Path, help="where to write the result, after every mutant")
    parser.add_argument("--tests", nargs="+", help="arguments of pytest, a string for each call of it")
    parser.add_argument("--workers", type=int, default=1, help="mutants that are tried at a time")
    parser.add_argument("--seconds", type=float, default=float("inf"), help="when to stop; by default at the end")
    given = parser.parse_args()
    ends = time.monotonic() + given.seconds
    paths = [ROOT / path for path in given.paths or [Path("humanoid_mjx", folder) for folder in TESTS]]
    files = [file.relative_to(ROOT) for path in paths for file in (sorted(path.rglob("*.py")) or [path])]
    every = [mutant for file in files for mutant in mutants(file)]
    chosen = random.Random(given.seed).sample(every, min(given.count or len(every), len(every)))
    wanted = given.tests or dict.fromkeys(f"tests/{call}.py" for file in files for call in TESTS[file.parts[1]].split())
    os.environ |= {
        "JAX_NUM_CPU_DEVICES": "2",
        "JAX_PLATFORMS": "cpu",
        "JAX_PERSISTENT_CACHE_MIN_COMPILE_TIME_SECS": "0.3",
    }
    os.environ.setdefault("JAX_COMPILATION_CACHE_DIR", str(ROOT / ".pytest_cache" / "xla"))
    for name in IMPORTED:
        import_module(name)
    commit = subprocess.getoutput(f"git -C {shlex.quote(str(ROOT))} rev-parse HEAD")
    found: list[dict[str, str]] = []
    result: dict = {"commit": commit, "command": shlex.join(["python", *sys.argv])}
    with tempfile.TemporaryDirectory() as folder, get_context("fork").Pool(given.workers) as pool:
        base = shutil.copytree(ROOT, Path(folder) / "base", ignore=shutil.ignore_patterns(".*", "build"))
        calls = sorted(pool.imap_unordered(partial(without_fault, base), wanted), key=lambda call: call.seconds)
        result["calls"] = {call.arguments: {"seconds": call.seconds, "failed": call.failed} for call in calls}
        calls = [call for call in calls if call.code in (pytest.ExitCode.OK, pytest.ExitCode.TESTS_FAILED)]
        for mutant, word in pool.imap_unordered(partial(outcome, base, calls, ends), chosen):
            if not word:
                break
            found.append({"mutant": str(mutant), "found": word})
            print(f"{len(found)}/{len(chosen)} {mutant}: {word}", flush=True)
            killed = sum(entry["found"] != "survived" for entry in found) / len(found)
            result |= {"of": len(every), "sampled": len(found), "killed": killed, "mutants": found}
            if given.json:
                given.json.write_text(json.dumps(result, indent=1) + "\n")
    print(f"{len(found)} of {len(every)} mutants in {len(files)} files tried, {result.get('killed', 0):.0%} killed")


if __name__ == "__main__":
    main()
