"""Commands of the command line: a module for each command, or for a few that are alike; here what they share.

Those that declare their options, and are imported when any command starts, import nothing heavy themselves.
"""

from collections.abc import Callable, Sequence
from contextlib import AbstractContextManager, nullcontext
from pathlib import Path
from typing import Annotated

from typer import Argument, Option

from humanoid_mjx.training.progress import PatientConsole

console = PatientConsole(highlight=False, markup=False, emoji=False)


def start_for(physics: str | None, overrides: Sequence[str]) -> None:
    """Prepare this process for computing, with room for MJX where `--physics` or `--set` names it."""
    from humanoid_mjx import compute

    compute.start(mjx="mjx-jax" in (physics, *(override.partition("=")[2] for override in overrides)))


def _shipped(kind: str, ending: str) -> Callable[[str], list[str]]:
    """Return a function that completes the name of a shipped file; without a match, shells complete paths."""

    def complete(incomplete: str) -> list[str]:
        from humanoid_mjx.files import names

        return [name for name in names(kind, ending) if name.startswith(incomplete)]

    return complete


CONFIGS, POLICIES = _shipped("configs", ".yaml"), _shipped("policies", ".npz")

Override = Annotated[list[str] | None, Option("--set", metavar="KEY=VALUE", help="Change one value of the config.")]

Trust = Annotated[bool, Option("--trust", help="Also run named code from outside the working directory.")]


def trusting(trust: bool, *names: str | Path | None) -> AbstractContextManager[None]:
    """Allow the code that configs and policies name: all of it if `trust`, else only modules of the user."""
    from humanoid_mjx.spec import own_modules_only

    return nullcontext() if trust else own_modules_only(*(Path(name) for name in names if name and Path(name).is_dir()))


Physics = Annotated[str | None, Option(metavar="NAME", help="Another physics than in training, such as mujoco.")]

Unmodified = Annotated[bool, Option("--unmodified", help="In native MuJoCo, on the robot's file as it is.")]

Policy = Annotated[
    str,
    Argument(metavar="RUN|POLICY", help="A run folder, a policy file, or a shipped policy.", autocompletion=POLICIES),
]

Point = Annotated[int | None, Option(min=0, metavar="N", help="A point of a sweep by its number; by default the best.")]

World = Annotated[
    list[str] | None,
    Option("--set", metavar="task.KEY=VALUE", help="Change a value of the task, such as task.friction=0.5."),
]
