"""The command `reproduce`."""

from collections import Counter
from collections.abc import Sequence
from pathlib import Path
from typing import Any

from humanoid_mjx import compute
from humanoid_mjx.commands import console


def run_reproduce(names: Sequence[str], list_names: bool, overrides: Sequence[str], out: Path) -> None:
    """`humanoid-mjx reproduce`."""
    compute.start(mjx=True)
    from humanoid_mjx.reproduction import Experiment, Finding, load_experiments, reproduce

    if list_names:
        for experiment in load_experiments().values():
            console.print(f"{experiment.name:24} {experiment.title}")
        return

    def say(experiment: Experiment, findings: list[Finding], seconds: float) -> None:
        console.print(f"\n{experiment.name}: {experiment.title} ({seconds:.1f} s)")
        for finding in findings:
            console.print(f"  {finding.verdict:16} {finding.quantity}")
            console.print(f"  {'':16} printed {_shown(finding.printed)}, reproduced {_shown(finding.reproduced)}")
            console.print(f"  {'':16} {finding.why}")

    with console.status("reproducing") as status:
        findings = reproduce(names, out, overrides, say, status.update)
    counts = Counter(finding.verdict for finding in findings)
    console.print(f"\n{', '.join(f'{count} {verdict}' for verdict, count in counts.items())}\n{out / 'reproduce.json'}")


def _shown(value: Any) -> str:
    if isinstance(value, dict):
        return ", ".join(f"{name} {_shown(inner)}" for name, inner in value.items() if inner != "")
    if isinstance(value, (list, tuple)):
        return ", ".join(map(_shown, value))
    return "nothing" if value is None else str(value)
