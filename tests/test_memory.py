"""The estimate of what training takes, against what XLA says of the compiled programs."""

import jax
import jax.numpy as jnp
import pytest

from humanoid_mjx import InputError
from humanoid_mjx.config import load
from humanoid_mjx.training.memory import runs_that_fit, training_bytes
from humanoid_mjx.training.plan import make_plan
from humanoid_mjx.training.programs import programs_of

SMALL = ["learner.evaluation_envs=32"]


@pytest.mark.parametrize(
    "config", [("leg_reach", "learner.envs=1024", *SMALL), ("leg_reach_linear", "learner.envs=1024", *SMALL)]
)
def test_the_estimate_is_what_xla_takes_within_a_factor_of_two(config):
    name, *overrides = config
    (group,) = make_plan(load(name, overrides)).groups
    runs = 2
    learners = jax.tree.map(lambda x: jax.ShapeDtypeStruct((runs, *x.shape[1:]), x.dtype), group.learners)
    training = jax.tree.map(lambda x: jax.ShapeDtypeStruct((runs, *x.shape), x.dtype), group.one_run)
    train = programs_of(group.learners, jax.local_devices()[:1]).advance
    memory = train.lower(learners, training, jax.ShapeDtypeStruct((), jnp.int32)).compile().memory_analysis()
    peak = memory.argument_size_in_bytes + memory.output_size_in_bytes - memory.alias_size_in_bytes
    ratio = runs * training_bytes(group) / (peak + memory.temp_size_in_bytes)
    assert 0.5 < ratio < 2.0, ratio


def test_what_is_too_large_for_memory_is_refused():
    overrides = ["learner.envs=65536", "learner.rollout=128", "learner.width=1024", "learner.minibatches=1"]
    (group,) = make_plan(load("leg_reach", overrides)).groups
    with pytest.raises(InputError, match=r"one run needs about .* MiB are free; make the task or the learner smaller"):
        runs_that_fit(group, jax.local_devices()[0])
