"""Control laws on the ground, in batches on MJX: they stand, and take a push."""

import jax
import jax.numpy as jnp
import mujoco
import numpy as np
import pytest

from humanoid_mjx import compute
from humanoid_mjx.control import at_rest, make_law
from humanoid_mjx.physics import make_physics

MJX = make_physics("mjx-jax", robot={"ranges": "human"})
STANDING = at_rest(jnp.zeros(10))
PUSHES = np.array([[0.0, 0.0], [0.2, 0.0], [-0.15, 0.0], [0.0, 0.3]])
"""N s at the hips: none, forwards, backwards, to the left."""

SECONDS = 1.5


@pytest.fixture(scope="module")
def pushed():
    """Worlds whose standing bodies were pushed: the paths of joints, torques, end; the servo's, then computed torque's.

    With their copies they are more than the threads of XLA can take at once.
    """
    data = mujoco.MjData(MJX.model)
    mujoco.mj_forward(MJX.model, data)
    matrix = np.zeros((16, 16))
    mujoco.mj_fullM(MJX.model, data, matrix)
    qvel = np.linalg.solve(matrix, np.pad(PUSHES, ((0, 0), (0, 14))).T).T
    held, exact = (make_law(name) for name in ("pd", "grounded"))

    def simulate(qvel, grounded):
        def controller(stages):
            return jnp.where(grounded, exact(STANDING, stages), held(STANDING, stages))

        def cycle(world, _):
            world, torque = MJX.step(world, controller)
            return world, (world.qpos, torque)

        world = MJX.start(MJX.qpos0, qvel)
        return jax.lax.scan(cycle, world, length=MJX.substeps(SECONDS))[1]

    copies = int(compute.POOL_THREADS) // len(PUSHES) + 2
    velocities = np.tile(qvel, (2 * copies, 1)).astype(np.float32)
    grounded = np.repeat([False, True], copies * len(PUSHES))
    qpos, torque = jax.jit(jax.vmap(simulate))(velocities, grounded)
    shape = 2, copies, len(PUSHES), -1
    return [np.asarray(x).reshape(*shape, x.shape[-1])[:, :: copies - 1] for x in (qpos, torque)]


def test_both_stand_and_take_a_push(pushed):
    qpos, torque = pushed
    assert qpos[..., -1, 2].min() > 0.21 and np.abs(qpos[..., -1, 3] - 1).max() < 1e-3
    np.testing.assert_array_equal(qpos[:, 0], qpos[:, 1])
    assert np.abs(qpos[..., -1, 7:]).max() < 3e-3
    assert np.abs(torque[:, 0, 0, -1]).max() < 0.05
