"""The tree against native MuJoCo with a converged solver, in double precision; and the laws of mechanics."""

import jax
import jax.numpy as jnp
import mujoco
import numpy as np
import pytest
from tree_robots import HOPPER, QUADRUPED, converged, native, states

from humanoid_mjx import runtime
from humanoid_mjx.mechanics.scalars import stack, unstack
from humanoid_mjx.mechanics.tree.kinematics import to_local
from humanoid_mjx.mechanics.tree.reading import read_tree
from humanoid_mjx.mechanics.tree.step import Values, accelerate, make_state, motor_forces
from humanoid_mjx.robot.lower_body import lower_body_model

ROBOTS = {
    "free": lambda: lower_body_model("free", "human"),
    "fixed": lambda: lower_body_model("fixed", "human"),
    "hopper": lambda: mujoco.MjModel.from_xml_string(HOPPER),
    "quadruped": lambda: mujoco.MjModel.from_xml_string(QUADRUPED),
}


def accelerations(model, qpos, qvel, ctrl, values=None):
    """By the tree, from cold."""
    tree = read_tree(model)

    def one(values, qpos, qvel, ctrl):
        state = make_state(tree, values, unstack(qpos), unstack(qvel))
        motor = motor_forces(tree, state, unstack(ctrl))
        _, solution = accelerate(tree, values, state, motor, unstack(jnp.zeros_like(qvel)))
        return stack(to_local(tree, state.kinematics, solution.acceleration), qvel), solution.settled

    batched = jax.jit(jax.vmap(one, in_axes=(None, 0, 0, 0)), compiler_options=runtime.SHARED_KERNELS)
    qacc, settled = batched(values or Values(), *map(jnp.asarray, (qpos, qvel, ctrl)))
    assert settled.all()
    return np.asarray(qacc)


def errors(found, expected):
    """Relative, by state."""
    return np.linalg.norm(found - expected, axis=1) / np.linalg.norm(expected, axis=1)


@pytest.mark.parametrize(("name", "count"), [("free", 10_000), ("fixed", 1000), ("hopper", 1000), ("quadruped", 1000)])
def test_accelerations_agree_with_native(name, count):
    """Rounding, with what stiff contacts of light feet make of it: 1e-13 as a rule."""
    model = converged(ROBOTS[name]())
    at = states(model, count)
    expected = native(model, *at)
    assert errors(accelerations(model, *at), expected).max() < 1e-9
