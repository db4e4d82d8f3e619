# pyright: reportAttributeAccessIssue=false
"""Train the lower body without some of its joints, to test what chapter 8 of the thesis says of its design.

    python experiments/chapter_8.py --runs runs/chapter_8 --json docs/bench/chapter_8.json

`walk` is trained with five seeds on each body of `BODIES`, pushed by up to 0.5 N s from any side. Every policy is then
played for 20 s under every command of `evaluate --gait`, on flat ground and pushed from the left or the right. The
record has a figure of each seed under each command. A second call goes on where the first one ended, and several may
share the bodies: the last one to end writes the whole record.
`experiments/chapter_8_verdicts.py` judges the record and draws it.
"""

import argparse
import json
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import jax
import jax.numpy as jnp
import mujoco
import numpy as np
import pydantic
from jaxtyping import Array, Float, Key
from pydantic import Field
from walk_worlds import PLAIN, walked

import humanoid_mjx
from humanoid_mjx import compute
from humanoid_mjx.config import load
from humanoid_mjx.evaluation.gait.scenarios import settings_of, trained_seeds
from humanoid_mjx.evaluation.gait.tally import heading_of
from humanoid_mjx.evaluation.policy import StoredPolicy, in_world
from humanoid_mjx.mechanics.rotations import rotation_matrix
from humanoid_mjx.robot import Robot, make_robot
from humanoid_mjx.robot.lower_body import HOME, JOINTS, LowerBody
from humanoid_mjx.tasks.legged import Walk
from humanoid_mjx.tasks.legged.episode import Episode
from humanoid_mjx.tasks.legged.gait import Clock, Steps
from humanoid_mjx.thesis.leg import JOINT_NAMES

MOMENTUM = make_robot("lower_body").momentum

TRAINING = (
    f"task.push={{impulse: {0.5 / MOMENTUM:.5f}, least: 0.0, every: 3.0}}",
    "task.gait={name: 'chapter_8:OwnSteps'}",
    "task.rewards.speed=1.0",
    "learner.precision=bfloat16",
    "learner.evaluations=1",
    "total_steps=40_000_000",
    "seeds=5",
)
"""Values of `walk` that differ in all trainings."""

BODIES: dict[str, dict[str, Any]] = {
    "all joints": {"ranges": "human"},
    "no yaw": {"ranges": "human", "locked": ["hip_yaw"]},
    "no roll": {"ranges": "human", "locked": ["hip_roll"]},
    "no yaw, no roll": {"ranges": "human", "locked": ["hip_yaw", "hip_roll"]},
    "proposed ranges": {"ranges": "proposed"},
}
"""Values of `Welded`. `human` and `proposed` are the columns of Table 3.2; `walk` has the human one."""

PUSHES = 0.0, 0.3, 0.5, 0.8
"""Impulses every 3 s from the left or the right, N s."""

FIGURES = (
    "success",
    "forward",
    "speed_error",
    "turn_error",
    "heading_error",
    "drift",
    "slip",
    "turn_success",
    "turn_seconds",
    "cost_of_transport",
)


class Welded(LowerBody):
    """The lower body without some kinds of joints: what they joined is one piece, as at the angle 0."""

    name: str = ""  # pyright: ignore[reportIncompatibleVariableOverride]
    locked: tuple[str, ...] = Field((), strict=False, description="kinds of joints that there are none of")

    @pydantic.model_validator(mode="before")
    @classmethod
    def _values_of_the_joints_left(cls, data: Any) -> Any:
        kept = ~np.isin(JOINT_NAMES, data.get("locked", ()))
        shares = np.array(LowerBody.model_fields["shares"].default)
        return {"home": tuple(np.array(HOME)[np.tile(kept, 2)]), "shares": tuple(shares[kept])} | data

    def spec(self, timestep: float | None = None) -> mujoco.MjSpec:
        spec = super().spec(timestep)
        for joint in (name for name in JOINTS if name.partition("_")[2] in self.locked):
            spec.delete(spec.actuator(joint))
            spec.delete(spec.joint(joint))
        return spec


class OwnSteps(Steps):
    """The steps of the whole body, of which each joint that is left makes its own part."""

    name: str = ""  # pyright: ignore[reportIncompatibleVariableOverride]

    def reference(self, clock: Clock, command: Float[Array, "3"], robot: Robot) -> Float[Array, " joints"]:
        return super().reference(clock, command, make_robot("lower_body"))[np.isin(JOINTS, robot.joints)]


class PushedFrom(Walk):
    """`walk` in which the pushes go this way or its mirror image, by chance, in place of any way."""

    bearing: float = Field(90.0, description="from straight ahead, degrees", json_schema_extra={"traced": True})

    def push_on(self, data: Episode, key: Key[Array, ""]) -> Float[Array, "3"]:
        size = jnp.linalg.norm(super().push_on(data, key))
        side = jax.random.rademacher(jax.random.fold_in(key, 2), ())
        angle = heading_of(rotation_matrix(data.world.qpos[3:7])) + side * jnp.radians(self.bearing)
        return size * jnp.stack([jnp.cos(angle), jnp.sin(angle), jnp.float32(0.0)])


def pushed_from(policy: StoredPolicy, bearing: float, impulse: float) -> StoredPolicy:
    """The policy in a world of pushes of this size, N s, every 3 s, this way from straight ahead, degrees."""
    push = f"task.push.impulse={impulse / MOMENTUM:.5f}"
    plain = settings_of([push, *(f"task.{key}={value}" for key, value in PLAIN.items())])
    there = in_world(policy, None, plain)
    task = PushedFrom.model_construct(**dict(there.learner.task) | {"bearing": jnp.float32(bearing)})
    return there._replace(learner=there.learner.replace(task=task))


def train(place: Path, config: str, overrides: Sequence[str]) -> list[StoredPolicy]:
    """Policies of a training, one for each seed; one that is under way or finished in this run folder goes on."""
    humanoid_mjx.sweep(load(config, overrides), place, resume=place.exists())
    return trained_seeds([str(place)])


def measure(body: str, place: Path, overrides: Sequence[str], episodes: int) -> list[dict[str, Any]]:
    """Train a body in this run folder, play it in all worlds, and leave the rows of the record beside the run."""
    overrides = [*TRAINING, f"task.robot={json.dumps({'name': 'chapter_8:Welded'} | BODIES[body])}", *overrides]
    policies, rows = train(place, "walk", overrides), []
    for impulse in PUSHES:
        found = walked([pushed_from(policy, 90.0, impulse) for policy in policies], episodes, FIGURES)
        rows.append({"body": body, "push": impulse, "set": overrides, "episodes": episodes, **found})
        print(f"{body}, pushed by {impulse} N s: upright {np.nanmean(found['success']):.0%}", flush=True)
    (place / "walked.json").write_text(json.dumps(rows))
    return rows


def main(arguments: Sequence[str] | None = None) -> None:
    """Train and play bodies, and write the record of all that are done."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--runs", type=Path, default=Path("runs/chapter_8"), help="folder of the run folders")
    parser.add_argument("--bodies", nargs="+", choices=BODIES, default=list(BODIES), help="of this process")
    parser.add_argument("--episodes", type=int, default=64, help="of each seed under each command")
    parser.add_argument("--set", action="append", default=[], metavar="KEY=VALUE", help="of all trainings")
    parser.add_argument("--json", type=Path, required=True, metavar="FILE")
    given = parser.parse_args(arguments)
    humanoid_mjx.start()
    given.runs.mkdir(parents=True, exist_ok=True)
    places = {body: given.runs / body.replace(", ", "_").replace(" ", "_") for body in BODIES}
    for body in given.bodies:
        if not (places[body] / "walked.json").exists():
            measure(body, places[body], given.set, given.episodes)
    done = [place / "walked.json" for place in places.values() if (place / "walked.json").exists()]
    rows = [row for file in done for row in json.loads(file.read_text())]
    given.json.write_text(json.dumps(compute.made_by() | {"rows": rows}) + "\n")


if __name__ == "__main__":
    main()
