"""All numbers of a model that the tree reads, and its choices, changed together, against native MuJoCo."""

from functools import cache

import jax
import jax.numpy as jnp
import mujoco
import numpy as np
import pytest
from model_fields import COMPUTED, changed, make, moved, put, worlds

from humanoid_mjx.physics.tree import TreePhysics

STEPS = 3


def numbers(model):
    """Each number a tenth off."""
    rng = np.random.default_rng(1)
    for field in COMPUTED:
        put(model, field, changed(model, field, rng))


def choices(model):
    """Priorities, a contact without friction, one between parent and child, springs of constraints given directly and
    shorter than MuJoCo's safety allows, damping taken at the beginning of a step, no limit and no bound of a joint."""
    off = mujoco.mjtDisableBit
    model.opt.disableflags |= int(off.mjDSBL_REFSAFE | off.mjDSBL_EULERDAMP | off.mjDSBL_FILTERPARENT)
    model.geom("floor").priority, model.geom("floor").condim = 1, 1
    model.geom("ball").solref, model.geom("ball").friction = (-3000.0, -20.0), (0.9, 0.1, 0.1)
    thick = model.geom("upper")
    thick.contype, thick.conaffinity, thick.size[0], thick.solimp = 1, 1, 0.165, (0.5, 0.8, 0.0, 0.5, 1.0)
    model.geom("floor").conaffinity, model.geom("foot").contype = 2, 3
    model.jnt_solref[0], model.dof_solref[0] = (0.005, 1.2), (-400.0, -30.0)
    model.pair_solref[0], model.pair_dim[0] = (0.006, 0.8), 1
    model.jnt_limited[2] = model.jnt_actfrclimited[2] = model.actuator_ctrllimited[0] = 0


def elliptic(model):
    """Elliptic cones of other numbers."""
    numbers(model)
    model.opt.cone = mujoco.mjtCone.mjCONE_ELLIPTIC


@cache
def other(change):
    """The model after a change."""
    model = make()
    {"numbers": numbers, "choices": choices, "elliptic": elliptic}[change](model)
    return model


class Other(TreePhysics):
    """The tree of a changed model."""

    change: str

    @property
    def model(self):
        return other(self.change)


@pytest.mark.parametrize("change", ["numbers", "choices", "elliptic"])
def test_everything_read_acts_as_in_mujoco(change):
    robot = Other(change=change)
    qpos, qvel, torque = map(jnp.asarray, worlds())

    def after(qpos, qvel, torque):
        return robot.run(robot.start(qpos, qvel), lambda stages: torque, STEPS)

    found = jax.jit(jax.vmap(after))(qpos, qvel, torque)
    expected = moved(robot.model, STEPS)
    assert not found.diverged.any()
    np.testing.assert_allclose(jnp.concatenate([found.qpos, found.qvel], axis=1), expected, rtol=1e-9, atol=1e-9)
