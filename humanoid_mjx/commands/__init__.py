"""Commands of the command line: a module for each command, or for a few that are alike.

Those that declare their options, and are imported when any command starts, import nothing heavy themselves.
"""

from collections.abc import Sequence

from humanoid_mjx.training.progress import PatientConsole

console = PatientConsole(highlight=False, markup=False, emoji=False)


def start_for(physics: str | None, overrides: Sequence[str]) -> None:
    """Prepare this process for computing, with room for MJX where `--physics` or `--set` names it."""
    from humanoid_mjx import compute

    compute.start(mjx="mjx-jax" in (physics, *(override.partition("=")[2] for override in overrides)))
