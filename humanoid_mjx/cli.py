"""The command line. Heavy imports wait until a command needs them."""

import errno
import os
import re
import sys
from contextlib import suppress
from pathlib import Path
from typing import Annotated, Any, NoReturn

import typer
from typer import Argument, Option

from humanoid_mjx.commands import CONFIGS, Override, Trust, trusting
from humanoid_mjx.commands.bench import bench
from humanoid_mjx.commands.evaluate import evaluate
from humanoid_mjx.commands.export import export
from humanoid_mjx.commands.film import demo, play
from humanoid_mjx.commands.reproduce import reproduce
from humanoid_mjx.commands.runs import plot, report, runs

ABOUT = (
    "Batched simulation and Q-learning for the lower body of a humanoid, in JAX.\n\n"
    "Configs and policies may name code, which runs with your rights. Commands that only read them run modules below "
    "the working directory and no others, unless you add --trust."
)

app = typer.Typer(add_completion=True, no_args_is_help=True, pretty_exceptions_enable=False, help=ABOUT)


@app.command()
def sweep(
    config: Annotated[str, Argument(help="A path, or a config that ships.", autocompletion=CONFIGS)],
    out: Annotated[Path | None, Option(help="The run folder; by default the next free runs/NAME.")] = None,
    set_: Override = None,
    resume: Annotated[bool, Option("--resume", help="Complete an interrupted run.")] = False,
    tensorboard: Annotated[bool, Option("--tensorboard", help="Write event files into RUN/tensorboard.")] = False,
    tracker: Annotated[
        list[str] | None, Option(metavar="NAME", help="Also log to wandb, mlflow or your own module:Class.")
    ] = None,
    view: Annotated[bool, Option("--view", help="Open a page that grows while it trains: RUN/report.html.")] = False,
    ray: Annotated[
        str | None,
        Option(metavar="[HOST:PORT]", help="Train on a Ray cluster; without an address on one of this machine."),
    ] = None,
    slurm: Annotated[
        list[str] | None,
        Option(metavar="KEY=VALUE", help="Submit it to Slurm: jobs=8, partition=gpu, gpus_per_node=1, ..."),
    ] = None,
) -> None:
    """Train every point of a sweep; write a run folder with tables and figures."""
    if slurm and (odd := [name for name, given in (("--view", view), ("--ray", ray)) if given]):
        from humanoid_mjx.spec import InputError

        raise InputError(f"{odd[0]}: this machine does not train what --slurm hands over; leave one of them out.")
    trackers = [*(["tensorboard"] if tensorboard else []), *(tracker or [])]
    if slurm:
        from humanoid_mjx.commands.slurm import submit_sweep

        submit_sweep(config, out, set_ or [], resume, trackers, slurm)
    else:
        from humanoid_mjx.commands.sweep import run_sweep

        run_sweep(config, out, set_ or [], resume, trackers, view, ray)


for command in (reproduce, bench, evaluate, play, demo, report, runs, plot, export):
    app.command()(command)


@app.command()
def info(
    name: Annotated[
        str | None,
        Argument(
            metavar="[CONFIG|TASK|LEARNER|ROBOT.yaml|ROBOT.xml]",
            help="A config to resolve; a task or learner; a robot, or its MJCF alone.",
            autocompletion=CONFIGS,
        ),
    ] = None,
    set_: Override = None,
    keys: Annotated[bool, Option("--keys", help="Every key: meaning, range, default; without a name of all.")] = False,
    time: Annotated[bool, Option("--time", help="Train a piece of CONFIG to estimate the time.")] = False,
    trust: Trust = False,
) -> None:
    """Show devices, versions and what ships; with CONFIG, the resolved config, its points, and what memory, disk and
    time they take; with ROBOT.xml, its joints, motors, feet and contacts, and all that `physics: tree` cannot represent
    (exit 2 if anything)."""
    from humanoid_mjx.commands.info import check_plain, show_info, show_keys, show_model

    if keys or (name and name.endswith((".xml", ".urdf"))):
        check_plain(set_ or [], time)
    if name and name.endswith((".xml", ".urdf")):
        raise typer.Exit(0 if show_model(name) else 2)
    with trusting(trust or ":" in (name or "")):
        show_keys(name) if keys else show_info(name, set_ or [], time)


def _version(wanted: bool) -> bool:
    if wanted:
        from humanoid_mjx import __version__

        print(f"humanoid-mjx {__version__}")
        raise typer.Exit
    return wanted


@app.callback()
def common(
    version: Annotated[bool, Option("--version", callback=_version, is_eager=True, help="Show the version.")] = False,
) -> None:
    """Options of the program itself."""


FULL = (errno.ENOSPC, errno.EDQUOT, errno.EFBIG, errno.EIO, errno.EROFS)
"""Errors of a disk that is full, read-only or broken."""

LETTERS = 2000
"""Largest length of an error message."""

UsageError: Any = typer.BadParameter.__base__
"""The error that typer raises for words that it does not understand; its module differs between versions of typer."""

INTERRUPTED = 130
"""The exit code after Ctrl-C, by the convention of shells."""


def spelled(words: list[str]) -> list[str]:
    """Return the words of a command, with the address of a `--ray` that has none, which typer cannot leave out."""
    pairs = zip(words, [*words[1:], ""], strict=False)
    return ["--ray=local" if word == "--ray" and ":" not in after != "auto" else word for word, after in pairs]


def main() -> None:
    """Run the command line. Wrong input and failures of files, disks and memory end with one sentence and exit code
    2."""
    for name in ("stdout", "stderr"):
        if getattr(sys, name) is None:  # closed, as some services start programs
            setattr(sys, name, os.fdopen(os.open(os.devnull, os.O_WRONLY), "w"))
    os.environ.pop("MUJOCO_GL", None)  # OpenGL is not used, and an unusable value stops MuJoCo's import
    if not all(word.strip() for word in sys.argv[1:]):
        _end("a word of the command is empty; write a name there, or leave it out.")
    sys.argv[1:] = spelled(sys.argv[1:])
    try:
        sys.exit(app(standalone_mode=False) or 0)
    except UsageError as error:
        if not (words := error.format_message()):  # the help was printed instead
            sys.exit(error.exit_code)
        words = re.sub("^Invalid value for '(.+?)': Input should", r"\1 must", words).rstrip(".?")
        command = f" {error.ctx.info_name}" if error.ctx and error.ctx.parent else ""
        _end(f"{words}; humanoid-mjx{command} --help shows what can be typed.")
    except (KeyboardInterrupt, SystemExit) as error:
        if isinstance(error, SystemExit) and error.code != INTERRUPTED:
            raise
        with suppress(OSError):
            sys.stdout.flush()
        os._exit(INTERRUPTED)  # a thread that compiles cannot be interrupted, and Python would wait for it
    except OSError as error:
        place = error.filename
        from humanoid_mjx.environment import of_system

        sweeps = error.errno in FULL and "sweep" in sys.argv[1:2]
        goes_on = "; what is stored is valid, and the same command with --resume goes on" if sweeps else ""
        _end(f"{f'{place}: ' if place else ''}{of_system(error)}{goes_on}.")
    except Exception as error:
        from humanoid_mjx.environment import unusable

        if words := unusable(error):
            _end(words)
        from humanoid_mjx.compute.limits import out_of_memory
        from humanoid_mjx.spec import InputError
        from humanoid_mjx.user_code import in_words, place

        if out_of_memory(error):
            _end("the memory does not suffice; make the task, the learner or the number of episodes smaller.")
        if isinstance(error, InputError):
            _end(str(error))
        if place(error):
            _end(f"{in_words(error)}.")
        raise


def _end(sentence: str) -> NoReturn:
    """Print an error on one line, control characters escaped, and exit with code 2."""
    for python, flag in (("resume=True", "--resume"), ("out=PATH", "--out"), ("tracker.name:", "--tracker:")):
        sentence = sentence.replace(python, flag)
    plain = "".join(letter if letter.isprintable() else ascii(letter)[1:-1] for letter in sentence)
    print(f"error: {plain if len(plain) <= LETTERS else plain[:LETTERS] + '...'}", file=sys.stderr)
    with suppress(OSError, ValueError):  # what is buffered would fail again at exit
        os.dup2(os.open(os.devnull, os.O_WRONLY), sys.stdout.fileno())
    sys.exit(2)
