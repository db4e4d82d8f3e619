"""A policy as C: the same values to rounding, the same actions where no two choices are as good."""

import ctypes
import subprocess

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from humanoid_mjx import InputError
from humanoid_mjx.commands.play import run_export
from humanoid_mjx.compute import rng
from humanoid_mjx.evaluation.policy import find_policy

FLOATS, INTS = (np.ctypeslib.ndpointer(kind, flags="C") for kind in (np.float32, np.int32))
STATES = 10_000


@pytest.mark.parametrize("name", ["walk", "stand"])
def test_a_shipped_policy_acts_the_same(tmp_path, name):
    source, library = tmp_path / "policy.c", tmp_path / "policy.so"
    run_export(name, source, None)
    flags = "-std=c99", "-Wall", "-Wextra", "-Werror", "-O2", "-shared", "-fPIC"
    subprocess.run(["cc", *flags, str(source), "-o", str(library), "-lm"], check=True)
    compiled = ctypes.CDLL(str(library))
    compiled.q_values.argtypes, compiled.act.argtypes = (FLOATS, FLOATS), (FLOATS, INTS)
    trained = find_policy(name)
    learner, policy = trained.learner, trained.policy
    seen = policy.moments
    draw = jax.random.normal(rng.key(0), (STATES, len(seen.mean)))
    obs = np.asarray(seen.mean + 2.0 * jnp.sqrt(seen.variance) * draw, np.float32)
    q = np.asarray(jax.jit(lambda obs: learner.q_values(policy.value, learner.preprocess(policy, obs)))(obs))
    found, actions = np.empty_like(q), np.empty(q.shape[:2], np.int32)
    for row, values, action in zip(obs, found, actions, strict=True):
        compiled.q_values(row, values)
        compiled.act(row, action)
    # Sums of up to 256 products in another order, through four layers, in single precision.
    tolerance = 2e-4 * q.std()
    np.testing.assert_allclose(found, q, atol=tolerance)
    first, second = np.sort(q, axis=-1)[..., :-3:-1].transpose(2, 0, 1)
    clear = first - second > 2 * tolerance
    assert clear.mean() > 0.99
    np.testing.assert_array_equal(actions[clear], q.argmax(axis=-1)[clear])


def test_only_networks_become_c(tmp_path):
    with pytest.raises(InputError, match="posture_switch: only policies of deep_q can be written as C"):
        run_export("posture_switch", tmp_path / "policy.c", None)
