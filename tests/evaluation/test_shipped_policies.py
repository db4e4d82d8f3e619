"""The shipped policies of the body on the ground do in native MuJoCo what they were trained for in `tree`."""

import pytest

from humanoid_mjx.config import load
from humanoid_mjx.evaluation.evaluate import play_out
from humanoid_mjx.evaluation.policy import find_policy, in_world
from humanoid_mjx.training.plan import resolved

EPISODES = 8
SECONDS = 3.0
"""Long enough for a body without a policy to fall: most of those that hold their posture do within a second."""


SHIPPED = ("stand", "walk", "walk_sturdy", "walk_dog", "walk_humanoid")


def values(config, place=""):
    """The values of a config by their dotted names."""
    for key, value in config.items():
        yield from values(value, f"{place}{key}.") if isinstance(value, dict) else [(place + key, value)]


@pytest.mark.parametrize("name", [*SHIPPED, "posture_switch"])
def test_a_config_sets_what_its_shipped_policy_was_trained_with(name):
    trained, today = dict(values(find_policy(name).config.task)), dict(values(resolved(load(name))["task"]))
    # Newer keys leave older policies as they were; the robot has the shares of joints now, slip costs less, and `walk`
    # has other rewards.
    newer = {"action_shares", "rewards.slip", "rewards.shapes.slip"}
    newer |= {"rewards.turn", "rewards.yawing"} if name == "walk" else set()
    assert {key for key, value in trained.items() if today.get(key) != value} <= newer


WORLDS = [(name, "mujoco", "null", 1.0) for name in SHIPPED if name != "walk_sturdy"]
WORLDS += [("walk_dog", "unmodified", "null", 1.0)]
WORLDS += [("walk_sturdy", "mujoco", "{stairs: 0.0}", 1.0), ("walk_sturdy", "mujoco", "{stairs: 0.01}", 0.75)]
"""Policies, the physics, the ground, and the least share that stays upright: some trip over stairs. Stairs of no height
are level, and a program serves those of any height."""


@pytest.mark.parametrize(("name", "physics", "terrain", "least"), WORLDS)
def test_a_shipped_policy_stays_upright_in_native_mujoco(name, physics, terrain, least):
    world = [f"task.physics={physics}", f"task.duration={SECONDS}", f"task.terrain={terrain}"]
    trained = in_world(find_policy(name), None, world)
    greedy, zero = (play_out(trained, agent, EPISODES) for agent in ("greedy", "zero"))
    assert greedy["success"].mean() >= least
    assert zero["success"].mean() <= 0.5 or name == "walk_dog"  # four legs stand by themselves
    assert greedy["return"].min() > 1.5 * zero["return"].mean()
