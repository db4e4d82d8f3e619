"""Held-out episodes of a body under commands that stay: what `evaluate --gait` measures, of which policies, and the
world that it asks them in.

Every episode is one of the held-out ones (`evaluation.evaluate`), under one of the robot's scenarios for its whole
length. Of the motion only the sums of `gait.tally` are stored.
"""

import json
from collections.abc import Callable, Sequence
from functools import lru_cache, partial
from pathlib import Path
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float, Key

from humanoid_mjx.compute import Arithmetic, jitted
from humanoid_mjx.evaluation.evaluate import held_out_keys
from humanoid_mjx.evaluation.gait import tally as sums
from humanoid_mjx.evaluation.gait.figures import FIGURES, Gait, figures, summarised
from humanoid_mjx.evaluation.gait.tally import Asked, Tally, heading_of, sample_of, wrapped
from humanoid_mjx.evaluation.policy import StoredPolicy, find_policy, policies_of_best
from humanoid_mjx.learners import Learner
from humanoid_mjx.learners.rollout import AGENTS, Choose, agent, decision_keys, start
from humanoid_mjx.physics.base import World, where
from humanoid_mjx.robot import Robot
from humanoid_mjx.spec import InputError
from humanoid_mjx.tasks import name_of
from humanoid_mjx.tasks.base import Task
from humanoid_mjx.tasks.continuous import State
from humanoid_mjx.tasks.legged.commands import Velocity
from humanoid_mjx.tasks.legged.task import LeggedTask
from humanoid_mjx.tasks.legged.view import View
from humanoid_mjx.training.plan import resolved
from humanoid_mjx.types import BoolScalar, FloatScalar, IntScalar

TURN_GAIN, TURN_RATE = 4.0, 1.0
"""A sudden turn is commanded as a turn rate: so much of the heading's error, 1/s, at most so much, rad/s. It begins to
slow down 14 degrees before its goal, a fourth of a second that a gait has to stop turning in."""


class Scenario(NamedTuple):
    """A command that stays."""

    name: str
    command: tuple[float, float, float]
    """Velocity forward and to the left, m/s, and turn rate to the left, rad/s."""
    turn_at: float = np.inf
    """Time at which a sudden turn is commanded, s."""
    turn_by: float = 0.0
    """The change of heading that a sudden turn is to make, rad, to the left."""


STROLL, WALK, FAST, FASTEST = 0.105, 0.21, 0.35, 0.56
"""Speeds as shares of a robot's pace: a stroll, two walks, and the speed at which running begins to pay (Froude numbers
v^2 / (g l) of 0.01, 0.05, 0.13 and 0.33)."""


def scenarios_of(robot: Robot) -> tuple[Scenario, ...]:
    """Standing; four speeds ahead; both ways round on the spot, slowly and fast; curves; sidesteps; a turn of 45
    degrees at once, in mid-walk. Both sides are asked for the same, to show one that is worse."""
    stroll, walk, fast, fastest = map(robot.speed, (STROLL, WALK, FAST, FASTEST))
    return (
        Scenario("stand", (0.0, 0.0, 0.0)),
        *(Scenario(f"forward {speed}", (speed, 0.0, 0.0)) for speed in (stroll, walk, fast, fastest)),
        *(Scenario(f"turn {rate:+}", (0.0, 0.0, rate)) for rate in (0.5, -0.5, 1.0, -1.0)),
        *(Scenario(f"curve {walk} {rate:+}", (walk, 0.0, rate)) for rate in (0.5, -0.5)),
        *(Scenario(f"sideways {speed:+}", (0.0, speed, 0.0)) for speed in (stroll, -stroll)),
        Scenario("sudden turn", (walk, 0.0, 0.0), turn_at=5.0, turn_by=float(np.radians(45.0))),
    )


Turning = tuple[Float[Array, "3"], FloatScalar, FloatScalar]
"""`command`, `turn_at` and `turn_by` of a `Scenario`."""


class _Loop(NamedTuple):
    state: State
    view: View
    tally: Tally
    goal: FloatScalar
    """Heading that a sudden turn is to reach, against that of the start, rad; NaN before it."""
    fallen: BoolScalar
    first: World


def walking_task(task: Task) -> LeggedTask:
    """Return a task as a legged task; raise an InputError if it moves no body by commands, or one without pairs of
    feet."""
    if not isinstance(task, LeggedTask) or task.command is None:
        raise InputError(
            f"evaluate --gait: the task {name_of(task)} gives no commands to a body on legs, as walk does."
        )
    if not task.robot.feet or 2 * len(task.robot.foot_pairs) != len(task.robot.feet):
        raise InputError(f"evaluate --gait: a gait needs right and left feet; give {task.robot.name} the key mirror.")
    return task


def play_scenarios(
    learner: Learner,
    policies: Any,
    scenarios: Sequence[Scenario],
    episodes: int,
    seconds: float,
    agents: Sequence[str] = ("greedy",),
    tell: Callable[[int, int], None] = lambda done, total: None,
) -> dict[str, dict[str, np.ndarray]]:
    """The figures of every held-out episode under every scenario, by agent and name of the figure: for "greedy" arrays
    of shape (seeds, scenarios, episodes), for the others (1, scenarios, episodes). Raises as `walking_task`.

    Args:
      learner: whose task is played, with its pushes.
      policies: what was learned, a pytree whose leaves lead with an axis of training seeds.
      seconds: length of an episode, s.
      agents: some of `AGENTS`.
      tell: called with how many of all episodes have been played, once some have.
    """
    task: Any = walking_task(learner.task)
    # No task gives another command before an episode ends.
    learner = learner.replace(task=task.replace(command=task.command.replace(every=jnp.float32(jnp.inf))))
    seeds = len(jax.tree.leaves(policies)[0])
    chosen = [(name, seed) for name in agents for seed in (range(seeds) if name == "greedy" else (0,))]
    rows = np.array([seed for _, seed in chosen])
    policies = jax.tree.map(lambda leaf: jnp.asarray(leaf)[rows], policies)
    numbers = jnp.array([AGENTS.index(name) for name, _ in chosen], jnp.int32)
    commands = tuple(jnp.array(column, float) for column in list(zip(*scenarios, strict=True))[1:])
    side_by_side = len(chosen) * len(scenarios)
    block = min(episodes, max(task.simulator.batch // side_by_side, 1))
    keys = held_out_keys(-(-episodes // block) * block)
    run, decisions = _program(task.arithmetic), jnp.int32(round(seconds / task.period))
    parts = []
    for first in range(0, len(keys), block):
        parts.append(jax.device_get(run(learner, policies, numbers, commands, keys[first : first + block], decisions)))
        tell(side_by_side * min(first + block, episodes), side_by_side * episodes)
    found = {name: np.concatenate([part[name] for part in parts], axis=-1)[..., :episodes] for name in parts[0]}
    of = {name: np.array([index for index, (one, _) in enumerate(chosen) if one == name]) for name in agents}
    return {name: {key: found[key][of[name]] for key in FIGURES} for name in agents}


def gaits_of(found: dict[str, dict[str, np.ndarray]], scenarios: Sequence[Scenario]) -> list[Gait]:
    """The result of `play_scenarios` with intervals, of each agent under each scenario."""
    return [
        Gait(name, scenario.name, scenario.command, summarised({key: x[:, row] for key, x in of_agent.items()}))
        for name, of_agent in found.items()
        for row, scenario in enumerate(scenarios)
    ]


@lru_cache
def _program(arithmetic: Arithmetic) -> Callable[..., dict[str, Array]]:
    """(learner, policies, agents' numbers, commands, keys, decisions) -> figures by name, (agents, commands, keys)."""

    def episode(
        learner: Learner, policy: Any, number: IntScalar, command: Turning, key: Key[Array, ""], decisions: IntScalar
    ) -> dict[str, FloatScalar]:
        task = walking_task(learner.task)
        decide = partial(_decide, task, agent(learner, policy, number), command, key)
        loop = jax.lax.fori_loop(0, decisions, decide, _begin(task, key))
        turns, mass = jnp.isfinite(command[1]), (loop.state.data.plant or task.plant).mass
        found = figures(loop.tally, command[0], turns, loop.fallen, task.robot, mass, task.simulator.step_s)
        return {name: jnp.asarray(value, jnp.float32) for name, value in found.items()}

    for mapped in ([4], [3], [1, 2]):
        episode = jax.vmap(episode, in_axes=tuple(0 if place in mapped else None for place in range(6)))
    return jitted(episode, arithmetic)


def _begin(task: LeggedTask, key: Key[Array, ""]) -> _Loop:
    state = start(task, key)
    view = task.view(state.data, None, jnp.zeros_like(state.data.offsets))
    sensed = jax.eval_shape(lambda: task.simulator.sense(state.data.world, jnp.zeros_like(state.data.offsets)))
    blank = jax.tree.map(lambda x: jnp.zeros(x.shape, x.dtype), sensed)
    world = state.data.world
    first = sample_of(blank, task.simulator.body_names, task.robot)._replace(
        place=world.qpos[:2], heading=heading_of(view.rotation), angles=world.qpos[task.simulator.joint_qpos]
    )
    return _Loop(state, view, sums.begin(first, task.robot), jnp.float32(jnp.nan), jnp.bool_(False), world)


def _decide(
    task: LeggedTask, choose: Choose, command: Turning, key: Key[Array, ""], index: IntScalar, loop: _Loop
) -> _Loop:
    """Decision number `index` of one episode."""
    seconds, (staying, turn_at, turn_by) = index * task.period, command
    heading = loop.tally.turned + wrapped(heading_of(loop.view.rotation) - loop.tally.last.heading)
    begun = jnp.asarray(seconds > turn_at - task.period / 2)
    goal = jnp.where(begun & jnp.isnan(loop.goal), heading + turn_by, loop.goal)
    rate = jnp.clip(TURN_GAIN * (goal - heading), -TURN_RATE, TURN_RATE)
    asked = staying.at[2].set(jnp.where(begun, rate, staying[2]))
    state = task.commanded(loop.state, loop.view, asked)
    act_key, step_key = decision_keys(key, index)
    state, view, sensed = task.step_watched(state, task.as_numbers(choose(state, act_key)), step_key)
    fallen = loop.fallen | state.terminated
    interval = task.simulator.step_s
    window = sums.window_samples(task.gait.period if task.gait else None, interval)

    def add(tally: Tally, sensed: Any) -> tuple[Tally, None]:
        since = (tally.samples * interval - turn_at).astype(jnp.float32)
        sample = sample_of(sensed, task.simulator.body_names, task.robot, loop.state.data.terrain)
        return sums.add(tally, sample, Asked(asked, goal, since), window, interval, task.robot), None

    tally, _ = jax.lax.scan(add, loop.tally, sensed)
    tally = where(fallen, loop.tally, tally)
    # A fallen body is the most expensive to simulate, so it is reset; its further motion does not count.
    state = state._replace(data=state.data._replace(world=where(fallen, loop.first, state.data.world)))
    return _Loop(state, view, tally, goal, fallen, loop.first)


WORLD = {"task.duration": "20", "task.push.impulse": "0", "task.randomise": "null", "task.terrain": "null"}
"""Values of the task unless others are asked for: 20 s in which nothing pushes the body, all on the same plane."""


class Measured(NamedTuple):
    """Policies of one task that differ by their training seed alone, and what they do."""

    policies: list[StoredPolicy]
    gaits: list[Gait]
    beyond: list[str]
    """Scenarios whose commands lie outside the ranges of the task's own."""

    def as_json(self) -> dict[str, Any]:
        """The gaits as plain values, with what they are of."""
        policies, gaits = [policy.as_json() for policy in self.policies], [gait.as_json() for gait in self.gaits]
        return {"policies": policies, "beyond_training": self.beyond, "gaits": gaits}


def trained_seeds(names: Sequence[str], point: int | None = None, overrides: Sequence[str] = ()) -> list[StoredPolicy]:
    """All runs of the best point of each run folder named, or of the point of this number, and the policies that are
    named themselves. Raises as `find_policy` and `walking_task`."""
    found: list[StoredPolicy] = []
    for name in names:
        folder = Path(name).is_dir()
        found += (
            policies_of_best(Path(name), point, None, overrides) if folder else [find_policy(name, point, overrides)]
        )
    for policy in found:
        walking_task(policy.learner.task)
    return found


def settings_of(overrides: Sequence[str]) -> list[str]:
    """`WORLD` and the overrides, which take the place of what they concern."""
    keys = [override.partition("=")[0] for override in overrides]
    ours = {
        key: value
        for key, value in WORLD.items()
        if not any(other == key or other.startswith(f"{key}.") or key.startswith(f"{other}.") for other in keys)
    }
    return [*(f"{key}={value}" for key, value in ours.items()), *overrides]


def measure(policies: Sequence[StoredPolicy], episodes: int, tell: Callable[[int, int], None]) -> list[Measured]:
    """Measure the gaits of all agents, for each group of policies of the same task and the same kind of learner.

    `tell` is called with how many of a group's episodes have been played.
    """
    groups: dict[Any, list[StoredPolicy]] = {}
    for policy in policies:
        task = json.dumps(resolved(policy.config)["task"], sort_keys=True)
        groups.setdefault((task, jax.tree.structure((policy.learner, policy.policy))), []).append(policy)
    found = []
    for group in groups.values():
        learner, task = group[0].learner, walking_task(group[0].learner.task)
        stacked = jax.tree.map(lambda *leaves: jnp.stack(leaves), *(policy.policy for policy in group))
        scenarios = scenarios_of(task.robot)
        played = play_scenarios(learner, stacked, scenarios, episodes, float(task.duration), AGENTS, tell)
        ranges = task.command.ranges if isinstance(task.command, Velocity) else [[-np.inf, np.inf]] * 3
        (low, high), asked = np.asarray(ranges).T, {each.name: np.array(each.command) for each in scenarios}
        beyond = [name for name, x in asked.items() if ((x < low - 1e-6) | (x > high + 1e-6)).any()]
        found.append(Measured(group, gaits_of(played, scenarios), beyond))
    return found
