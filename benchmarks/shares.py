"""Shares of an update's time, of one seed on one device; they add up to one.

share of physics    the physics alone
share of the task   what its decisions take beyond the physics: sensors, rewards, resets
share of learning   the rest: choosing actions, targets, gradients
"""

from collections.abc import Callable
from functools import partial
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
from timing import Subject, time_in_turn

from humanoid_mjx import compute
from humanoid_mjx.compute import rng
from humanoid_mjx.control import at_rest
from humanoid_mjx.learners import Learner
from humanoid_mjx.physics.base import World
from humanoid_mjx.tasks.continuous import State, auto_reset


def shares(learner: Learner) -> dict[str, float]:
    """Shares of an update's time that physics, the rest of the task and learning take, timed in turn on one device."""
    env: Any = learner.env
    options = compute.compiler_options(env.arithmetic, learner.program)
    update = jax.jit(learner.train_step, compiler_options=options)
    carry, _ = update(jax.jit(learner.init)(rng.key(0)))
    state, count = carry.envs.state, len(carry.envs.episode)
    length = round(float(learner.progress(carry)) * float(learner.budget)) // count
    law = env.control.of(env.robot) if hasattr(env, "robot") else env.control
    hold = law.follow(at_rest(jnp.asarray(env.simulator.joint_ranges.mean(axis=1), float)))

    def decide(state: State, key: jax.Array) -> State:
        command = jax.random.uniform(key, (len(env.action_bins),), minval=-1.0)
        return auto_reset(env, env.step_continuous(state, command, key), key)

    def simulate(world: World, _: jax.Array) -> World:
        return env.simulator.run(world, hold, env.simulator.substeps(env.period))

    def repeated(step: Callable[[Any, jax.Array], Any], first: Any) -> Subject:
        def all_of_them(now: Any, key: jax.Array) -> tuple[Any, None]:
            return jax.vmap(step)(now, jax.random.split(key, count)), None

        call = jax.jit(partial(jax.lax.scan, all_of_them), compiler_options=options)
        return Subject(partial(call, first, jax.random.split(rng.key(1), length)), 1.0, count)

    subjects = {"physics": repeated(simulate, state.data.world), "task": repeated(decide, state)}
    subjects["update"] = Subject(partial(update, carry), 1.0, count)
    times = np.array([timing.seconds for timing in time_in_turn(subjects).values()])
    # A part that noise lets seem larger than the whole is all of it.
    physics, task, whole = np.maximum.accumulate(times)
    parts = {"physics": physics, "the task": task - physics, "learning": whole - task}
    return {name: float(seconds / whole) for name, seconds in parts.items()}
