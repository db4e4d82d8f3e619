"""The command `reproduce`."""

from collections import Counter
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

from typer import Argument, Option

from humanoid_mjx.commands import Override, console

if TYPE_CHECKING:
    from humanoid_mjx.reproduction import Experiment, Finding


def reproduce(
    names: Annotated[list[str] | None, Argument(metavar="[NAME]...", help="Such as table-7.1; all by default.")] = None,
    list_: Annotated[bool, Option("--list", help="Show the names.")] = False,
    set_: Override = None,
    out: Annotated[Path, Option(help="The folder of reproduce.json and the figures.")] = Path("reproduced"),
) -> None:
    """Reproduce tables and figures of the thesis, each with a computed verdict."""
    from humanoid_mjx import compute, reproduction
    from humanoid_mjx.reproduction.findings import as_text

    compute.start()
    if list_:
        for experiment in reproduction.load_experiments().values():
            console.print(f"{experiment.name:24} {experiment.title}")
        return

    def say(experiment: "Experiment", findings: "list[Finding]", seconds: float) -> None:
        console.print(f"\n{experiment.name}: {experiment.title} ({seconds:.1f} s)")
        for finding in findings:
            console.print(f"  {finding.verdict:16} {finding.quantity}")
            console.print(f"  {'':16} printed {as_text(finding.printed)}, reproduced {as_text(finding.reproduced)}")
            console.print(f"  {'':16} {finding.why}")

    with console.status("reproducing") as status:
        findings = reproduction.reproduce(names or [], out, set_ or [], say, status.update)
    counts = Counter(finding.verdict for finding in findings)
    console.print(f"\n{', '.join(f'{count} {verdict}' for verdict, count in counts.items())}\n{out / 'reproduce.json'}")
