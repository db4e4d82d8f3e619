"""Measure how policies of the lower body walk in worlds that are harder than a plane of friction 1.

    python experiments/walk_worlds.py runs/walk_sturdy walk --episodes 32 --json docs/bench/walk_worlds.json

A run folder stands for all training seeds of its best point. Each policy is played for 20 s under every command of
`evaluate --gait` in each of `WORLDS`. The record has a figure of each seed under each command; `docs/walking_tables.py`
makes the table of it.
"""

import argparse
import json
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float, Key

import humanoid_mjx
from humanoid_mjx import compute
from humanoid_mjx.control.drives import Drive
from humanoid_mjx.control.pd import Joints
from humanoid_mjx.evaluation.gait.scenarios import (
    Scenario,
    gaits_of,
    play_scenarios,
    scenarios_of,
    settings_of,
    trained_seeds,
    walking_task,
)
from humanoid_mjx.evaluation.policy import StoredPolicy, in_world
from humanoid_mjx.physics.base import Readings
from humanoid_mjx.physics.sensors import Sensors, SensorState
from humanoid_mjx.robot import make_robot
from humanoid_mjx.tasks.legged import Walk

PLAIN = {"friction": "1", "torque_limit": "1", "push.least": "1", "push.every": "3", "sensors.jitter": "0"}
"""Values of the task in all worlds that do not change them; the sensors are one control cycle late."""


def pushed(impulse: float) -> dict[str, str]:
    """Values of a world in which impulses of this size, N s, push the torso from a random side every 3 s."""
    return {"push.impulse": f"{impulse / make_robot('lower_body').momentum:.5f}"}


WORLDS: dict[str, dict[str, str]] = {
    "flat ground": {},
    "pushed by 0.5 N s every 3 s": pushed(0.5),
    "pushed by 0.8 N s every 3 s": pushed(0.8),
    "friction 0.3": {"friction": "0.3"},
    "friction 1.2": {"friction": "1.2"},
    "motors of 0.6 N m": {"torque_limit": "0.3"},
    "sensors three cycles late": {"sensors.delay": "3"},
    "a slope of 8 degrees": {"terrain": "{slope: 8}"},
    "waves of 10 mm": {"terrain": "{rough: 0.01}"},
    "stairs of 10 mm": {"terrain": "{stairs: 0.01}"},
}

JOINT = "right_knee_pitch"


class Stuck(Walk):
    """`walk` in which the motor of `JOINT` holds its place."""

    def setpoint(
        self, offsets: Float[Array, " joints"], reference: Float[Array, " joints"] | float = 0.0
    ) -> Float[Array, " joints"]:
        held = np.array([joint == JOINT for joint in self.robot.joints])
        return jnp.where(held, self.robot.posture, super().setpoint(offsets, reference))


class Weak(Drive):
    """The motor of one joint gives little torque, N m."""

    limits: tuple[float, ...] = ()

    def __call__(self, torque: Joints, qvel: Joints) -> Joints:
        return jnp.clip(torque, -np.array(self.limits), np.array(self.limits))


class Gone(Sensors):
    """Sensors of which one reads 0."""

    gone: str = ""

    def read(self, state: SensorState, readings: Readings, key: Key[Array, ""]) -> tuple[SensorState, Readings]:
        state, seen = super().read(state, readings, key)
        return state, seen._replace(**{self.gone: jnp.zeros_like(getattr(seen, self.gone))})


def weak(task: Walk, limit: float) -> Walk:
    """The task in which the motor of `JOINT` gives so much at most, N m."""
    limits = tuple(limit if joint == JOINT else np.inf for joint in task.robot.joints)
    return task.replace(actuator=Weak.model_construct(limits=limits))


def without(task: Walk, sensor: str) -> Walk:
    """The task in which a sensor reads 0."""
    return task.replace(sensors=Gone.model_construct(**dict(task.sensors), gone=sensor))


FAULTS: dict[str, Callable[[Walk], Walk]] = {
    "right knee stuck": lambda task: Stuck.model_construct(**dict(task)),
    "right knee of 0.5 N m": lambda task: weak(task, 0.5),
    "right knee without torque": lambda task: weak(task, 0.0),
    "no gyroscope": lambda task: without(task, "gyroscope"),
    "no accelerometer": lambda task: without(task, "accelerometer"),
    "no sensors of the feet": lambda task: without(task, "foot_contact"),
}
"""Worlds that no value of the task makes: they differ from flat ground by one fault."""

FIGURES = "success", "forward", "speed_error", "slip", "turn_success"
"""The figures of a gait that the record keeps."""


def walked(
    policies: list[StoredPolicy],
    episodes: int,
    names: Sequence[str] = FIGURES,
    scenarios: Sequence[Scenario] | None = None,
) -> dict[str, Any]:
    """Return the figures of policies that differ by their training seed, as lists of commands of lists of seeds."""
    return walked_worlds(policies, [policies[0].learner], episodes, names, scenarios)[0]


def walked_worlds(
    policies: list[StoredPolicy],
    learners: Sequence[Any],
    episodes: int,
    names: Sequence[str] = FIGURES,
    scenarios: Sequence[Scenario] | None = None,
) -> list[dict[str, Any]]:
    """Return the figures of `walked` in each world, which are the tasks of these learners."""
    stacked = jax.tree.map(lambda *leaves: jnp.stack(leaves), *(policy.policy for policy in policies))
    scenarios = scenarios or scenarios_of(walking_task(learners[0].task).robot)
    results: list[dict[str, Any]] = []
    for learner in learners:
        duration = float(walking_task(learner.task).duration)
        found = play_scenarios(learner, stacked, scenarios, episodes, duration)
        gaits = [gait.as_json() for gait in gaits_of(found, scenarios)]
        figures = {name: [_of_seeds(gait, name) for gait in gaits] for name in names}
        results.append({"commands": [gait["scenario"] for gait in gaits], **figures})
    return results


def _of_seeds(gait: dict[str, Any], name: str) -> list[float] | None:
    return [seed[0] for seed in gait["figures"][name]["seeds"]] if name in gait["figures"] else None


def learner_in(policy: StoredPolicy, physics: str | None, world: str, overrides: list[str]) -> Any:
    """Return the learner of a policy whose task is that of a world, or has a fault."""
    learner = in_world(policy, physics, settings_of(overrides)).learner
    faulty: Any = learner.task
    return learner.replace(task=FAULTS[world](faulty)) if world in FAULTS else learner


def main(arguments: Sequence[str] | None = None) -> None:
    """Play all policies in all worlds, and write the record."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("names", nargs="+", metavar="RUN|POLICY")
    parser.add_argument("--episodes", type=int, default=32, help="of each seed under each command")
    parser.add_argument("--physics", help="another physics, such as mujoco")
    parser.add_argument("--worlds", nargs="+", choices=[*WORLDS, *FAULTS], default=[*WORLDS, *FAULTS])
    parser.add_argument("--json", type=Path, required=True, metavar="FILE")
    given = parser.parse_args(arguments)
    humanoid_mjx.start()
    made_by, rows = compute.made_by(), []
    for name in given.names:
        policies = trained_seeds([name])
        values = {
            world: [f"task.{key}={value}" for key, value in (PLAIN | WORLDS.get(world, {})).items()]
            for world in given.worlds
        }
        learners = [learner_in(policies[0], given.physics, *world) for world in values.items()]
        for world, found in zip(values, walked_worlds(policies, learners, given.episodes), strict=True):
            rows.append({"policy": policies[0].name, "world": world, "set": values[world], **found})
            least = min(min(seeds) for seeds in found["success"])
            print(f"{policies[0].name}, {world}: least upright {least:.0%}", flush=True)
    origins = {policy.name: policy.origin["provenance"] for name in given.names for policy in trained_seeds([name])}
    record = made_by | {"episodes": given.episodes, "physics": given.physics, "trained": origins, "rows": rows}
    given.json.write_text(json.dumps(record) + "\n")


if __name__ == "__main__":
    main()
