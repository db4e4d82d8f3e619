"""Records of docs/bench that are older than what they measure, by the paths that each depends on, and records
of commits that are not in the history.

python docs/stale.py          # in a clone with its history; a line for each record, the stalest first
"""

import fnmatch
import math
import re
import subprocess
from collections.abc import Mapping, Sequence
from pathlib import Path

ROOT = Path(__file__).parent.parent

LEARNING = "learners", "training/program.py", "training/programs.py", "tasks/base.py"
BODIES = *LEARNING, "tasks/continuous.py", "tasks/legged", "physics", "control", "mechanics", "robot", "kernels"
TABLES = *LEARNING, "tasks/finite.py", "tasks/joint_reach.py", "kernels", "compute/rng.py"
DEPENDS: dict[str, Sequence[str]] = {
    "mutants_*": (),  # of a folder as it was
    "faults": ("runs", "training", "config", "spec.py", "files.py"),
    "cpu_2_cores_reproduce": ("reproduction", "thesis", "control", "mechanics", "robot/leg.py"),
    "c_policy": ("evaluation/c_source.py", "tasks/legged"),
    "*robot*": ("physics", "mechanics/tree", "robot", "kernels"),
    "*leg_reach*": (*LEARNING, "tasks/leg_reach.py", "physics/chain.py", "mechanics"),
    "*posture_switch*": (*LEARNING, "tasks/posture_switch.py", "physics", "mechanics"),
    "relearning_legs": (*LEARNING, "tasks/leg_reach.py", "physics/chain.py", "mechanics"),
    "halving_*": (*TABLES, "tasks/navigate.py", "runs/ranking.py", "training/session.py"),
    "relearning": (*TABLES, "tasks/navigate.py"),
    "speed_*": (*BODIES, *TABLES, "tasks/leg_reach.py"),
    "h200_one_kernel": TABLES,
    "parity": LEARNING,
    "methods": TABLES,
    "*": BODIES,
}
"""Paths below `humanoid_mjx/` by the name of a record; the first pattern that fits counts."""


def paths_of(name: str) -> list[str]:
    """Return the paths that a record depends on."""
    found = next(paths for pattern, paths in DEPENDS.items() if fnmatch.fnmatch(name, pattern))
    return [f"humanoid_mjx/{path}" for path in dict.fromkeys(found)]


def commits_of(text: str) -> set[str]:
    """Return the commits at which the rows of a record were measured."""
    return set(re.findall(r'"commit": "([0-9a-f]{7,40})', text))


def changes(root: Path, commit: str, paths: Sequence[str]) -> float:
    """Return how many commits after one changed the paths; infinitely many where HEAD does not come after it."""

    def git(*words: str) -> subprocess.CompletedProcess[str]:
        return subprocess.run(["git", *words], cwd=root, capture_output=True, text=True, check=False)

    if git("merge-base", "--is-ancestor", commit, "HEAD").returncode:
        return math.inf
    return int(git("rev-list", "--count", f"{commit}..HEAD", "--", *paths).stdout)


def stale(root: Path, records: Mapping[str, str]) -> dict[str, tuple[str, float]]:
    """Return of each record that is older than what it measures its oldest commit, and how many changed that since."""
    found = {}
    for name, text in records.items():
        paths = paths_of(name)
        ages = {commit: changes(root, commit, paths) for commit in commits_of(text) if paths}
        if any(ages.values()):
            found[name] = max(ages.items(), key=lambda each: each[1])
    return dict(sorted(found.items(), key=lambda each: -each[1][1]))


def main() -> None:
    """Print the records that are older than what they measure."""
    records = {path.stem: path.read_text(encoding="utf-8") for path in (ROOT / "docs" / "bench").glob("*.json")}
    for name, (commit, count) in stale(ROOT, records).items():
        lost = f"{commit[:7]}, at which it was measured, is not in this history"
        print(f"{name}: {lost if count == math.inf else f'{count} commits since {commit[:7]} change what it measures'}")


if __name__ == "__main__":
    main()
