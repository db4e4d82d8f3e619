"""Evaluate policies on every physics that their task offers: the one that they were trained on, and the others.

    python experiments/other_physics.py        # writes docs/bench/cpu_2_cores_other_physics.json, in minutes
    python experiments/other_physics.py --episodes 8 --out /tmp/found.json posture_switch

A policy that ships is taken as it is; `leg_reach`, of which none does, is first trained as its config says.
"""

import argparse
import json
import sys
import tempfile
from importlib.util import find_spec
from pathlib import Path
from typing import Any

from humanoid_mjx import compute
from humanoid_mjx.config import load
from humanoid_mjx.evaluation.evaluate import HELD_OUT_WORDS, evaluate_all
from humanoid_mjx.evaluation.policy import StoredPolicy, find_policy, in_world
from humanoid_mjx.files import names
from humanoid_mjx.training.sweep import sweep

RECORD = Path(__file__).parent.parent / "docs" / "bench" / "cpu_2_cores_other_physics.json"
OFFERED = {
    "posture_switch": ("chain", "mjx-jax", "mjx-warp", "mujoco"),
    "leg_reach": ("chain", "mjx-jax", "mujoco"),
    "stand": ("tree", "mjx-jax", "mjx-warp", "mujoco"),
}
"""The physics of each task whose policy is tried."""


def policy_for(task: str) -> StoredPolicy:
    """The policy that ships, or else the one that the config of this name trains."""
    if task in names("policies", ".npz"):
        return find_policy(task)
    with tempfile.TemporaryDirectory() as folder:
        return find_policy(sweep(load(task), Path(folder) / task).path)


def on_each_physics(trained: StoredPolicy, episodes: int) -> list[dict[str, Any]]:
    """Results of the policy, the zero and the random agent on each physics, that of the training first."""
    own, offered = trained.config.task["physics"], OFFERED[trained.config.task["name"]]
    found = []
    for physics in (own, *(name for name in offered if name != own)):
        place = {"policy": trained.config.name, "trained_on": own, "physics": physics}
        if physics == "mjx-warp" and find_spec("warp") is None:
            found.append(place | {"not_measured": "the package warp-lang is not installed"})
            continue
        evaluations = evaluate_all([in_world(trained, physics)], episodes)
        found.append(place | {"agents": {each.agent: each.as_json() for each in evaluations}})
        print(f"{trained.config.name} on {physics}: {evaluations[0].success.value:.1%}", flush=True)
    return found


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("tasks", nargs="*", default=list(OFFERED), help=f"some of {', '.join(OFFERED)}")
    parser.add_argument("--episodes", type=int, default=128, help="of each agent on each physics")
    parser.add_argument("--out", type=Path, default=RECORD, help="the record")
    asked = parser.parse_args()
    compute.start(mjx=True)
    command = " ".join(["python", "experiments/other_physics.py", *sys.argv[1:]])
    made_by = compute.made_by() | {"command": command, "episodes": asked.episodes, "held_out": HELD_OUT_WORDS}
    results = [row for task in asked.tasks for row in on_each_physics(policy_for(task), asked.episodes)]
    asked.out.write_text(json.dumps(made_by | {"results": results}, indent=1) + "\n")
    print(asked.out)


if __name__ == "__main__":
    main()
