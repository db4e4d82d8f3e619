"""A reader of pages of the documentation, who types all that stands there: `python docs_reader.py FOLDER PAGE ...`.

Each page is read by a process of its own, in a folder of its own below FOLDER. The processes are copies of one that
has imported jax and computed nothing. Files that the page names are written there, Python is run, and commands are
read as the command line reads them, without being carried out: their options, and the names of configs, policies, run
folders, experiments and benchmarks must exist.
"""

import contextlib
import os
import re
import shlex
import subprocess
import sys
import traceback
from pathlib import Path
from typing import NamedTuple

import typer

from humanoid_mjx.cli import app, spelled
from humanoid_mjx.files import names

ROOT = Path(__file__).parent.parent
SHELL = {"bash", "sh"}
OTHER_COMMANDS = {"python3", "python", "source", "pip", "pytest", "ruff", "pyright", "pre-commit"}
OTHER_COMMANDS |= {"kubectl", "ray", "sbatch", "sky"}


class Block(NamedTuple):
    """A fenced block of a page."""

    language: str
    title: str | None
    text: str


def blocks(markdown):
    """The fenced blocks of a page, in their order."""
    found = re.findall(r"^```(\w*)([^\n]*)\n(.*?)^```", markdown, re.MULTILINE | re.DOTALL)
    return [
        Block(language, (re.findall(r'title="([^"]+)"', rest) or [None])[0], text) for language, rest, text in found
    ]


def commands(markdown):
    """Every command of a page, in blocks and within its text; none with words that stand for others, such as NAME."""
    lines = [line for block in blocks(markdown) if block.language in SHELL for line in block.text.splitlines()]
    prose = re.sub(r"^```.*?^```", "", markdown, flags=re.MULTILINE | re.DOTALL)
    mentioned = re.findall(r"`(humanoid-mjx\s\w+\s[^`]+)`", prose)
    lines += [" ".join(code.split()) for code in mentioned if not re.search(r"\b[A-Z]{3,}\b|\||\[", code)]
    for line in lines:
        for command in line.partition(" #")[0].split("&&"):
            if words := shlex.split(command):
                yield [Path(words[0]).name, *words[1:]]


class Reader:
    """What a reader has after the commands so far."""

    def __init__(self):
        self.group = typer.main.get_command(app)
        self.there = {"reproduced", *names("policies", ".npz"), *(f"runs/{name}" for name in names("configs", ".yaml"))}
        """Run folders, policies and files."""

    def type(self, words):
        """Check a command, and note what it would leave behind."""
        program, *arguments = words
        if program != "humanoid-mjx":
            assert program in OTHER_COMMANDS, f"{program}: an unknown program"
            scripts = [word for word in arguments if word.endswith(".py")]
            if scripts and Path(scripts[0]).is_file():  # the page's own
                subprocess.run([sys.executable, *arguments], check=True)
            else:
                assert all((ROOT / script).is_file() for script in scripts), f"{scripts}: no such file"
        elif arguments[0].startswith("-"):
            self.group.make_context(program, arguments)
        else:
            name, *rest = spelled(arguments)
            assert name in self.group.commands, f"{name}: no such command"
            try:
                context = self.group.commands[name].make_context(name, rest)
            except Exception as error:  # typer brings a click of its own, whose errors have no public name
                raise AssertionError(f"{shlex.join(words)}: {error}") from error
            if name == "info":
                context.params["time"] = False  # which only trains a piece of what `sweep` trains
                with contextlib.suppress(typer.Exit):
                    self.group.commands[name].invoke(context)
            else:
                getattr(self, name)(**context.params)

    def sweep(self, config, out, set_, resume, **options):
        from humanoid_mjx.config import load
        from humanoid_mjx.training.plan import make_plan

        name = make_plan(load(config, set_ or [])).config.name
        folder = str(out or f"runs/{name}")
        assert not resume or folder in self.there, f"{folder}: nothing to be resumed"
        self.there.add(folder)

    def reproduce(self, names, **options):
        from humanoid_mjx.reproduction import load_experiments

        assert set(names or []) <= set(load_experiments())

    def bench(self, names, json, **options):
        from humanoid_mjx.commands.bench import BENCHES

        known = self.there if names and names[0] == "compare" else {*BENCHES, "all"}
        assert {*(names or [])} - {"compare"} <= known, names
        self.there.add(str(json))

    def evaluate(self, policies, set_, physics, **options):
        for policy in policies:
            self.play(policy, set_, physics)

    def play(self, policy, set_, physics, **options):
        from humanoid_mjx.evaluation.policy import find_policy, in_world

        if policy in names("robots", ".yaml") or (policy.endswith(".yaml") and Path(policy).is_file()):
            return
        self.has(policy)
        if policy in names("policies", ".npz"):
            in_world(find_policy(policy), None, [*(set_ or []), *([f"task.physics={physics}"] if physics else [])])

    def demo(self, port):
        pass

    def plot(self, run, **options):
        self.has(*run)

    def report(self, run, **options):
        self.has(run)

    def export(self, what, file, **options):
        from humanoid_mjx.robot import ROBOTS

        assert file.suffix in (".xml", ".npz", ".c", ".onnx"), file
        if what not in ROBOTS or file.suffix != ".xml":
            self.has(what)
        self.there.add(str(file))

    def runs(self, folder):
        assert str(folder) == "runs", folder

    def has(self, *names):
        assert {*map(str, names)} <= self.there, f"{names}: not there yet"


def type_commands(markdown):
    """Type the commands of a page, one after another."""
    reader = Reader()
    for words in commands(markdown):
        print("$", shlex.join(words))
        reader.type(words)


def train_shortly():
    """Have `humanoid_mjx` train a small part of a shipped config or of a table: a page shows them at full length."""
    import humanoid_mjx

    whole, make_whole = humanoid_mjx.sweep, humanoid_mjx.make_learner

    def sweep(config, *arguments, overrides=(), **options):
        shorter = {"seeds": 1, "episodes": 20, "record": 2} if isinstance(config, str) else {}
        others = [override for override in overrides if override.partition("=")[0] not in shorter]
        own = [f"{key}={value}" for key, value in shorter.items()]
        return whole(config, *arguments, overrides=[*others, *own], **options)

    def make_learner(*given, **fields):
        return make_whole(*given, **fields | ({"episodes": 20} if fields.get("episodes", 0) > 20 else {}))

    humanoid_mjx.sweep, humanoid_mjx.make_learner = sweep, make_learner


def read(page):
    """Type all that stands on a page."""
    train_shortly()
    markdown = page.read_text(encoding="utf-8")
    found = blocks(markdown)
    for block in found:
        if block.title:
            Path(block.title).write_text(block.text, encoding="utf-8")
    sys.path.insert(0, "")
    type_commands(markdown)
    variables = {"__name__": "__main__"}
    for block in found:
        if block.language == "python" and not block.title:
            print(block.text)
            exec(compile(block.text, f"{page.name}, a block", "exec"), variables)


def read_each(folder, pages):
    """Read each page in `folder`/NUMBER, and write there what happened: into `code` and `said`."""
    import jax  # noqa: F401
    import matplotlib  # noqa: F401
    import mujoco  # noqa: F401

    for number, page in enumerate(pages):
        place = folder / str(number)
        place.mkdir()
        if not os.fork():
            os.chdir(place)
            with open("said", "w") as said:
                for stream in (1, 2):
                    os.dup2(said.fileno(), stream)
            code = 1
            try:
                read(page)
                code = 0
            except BaseException:
                traceback.print_exc()
            finally:
                sys.stdout.flush()
                sys.stderr.flush()
                os._exit(code)
        (place / "code").write_text(str(os.waitstatus_to_exitcode(os.wait()[1])))


if __name__ == "__main__":
    read_each(Path(sys.argv[1]), [Path(page) for page in sys.argv[2:]])
