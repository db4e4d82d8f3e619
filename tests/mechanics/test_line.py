# pyright: reportAttributeAccessIssue=false
"""The lowest point along a line, in single precision, where forces are large and little is gained."""

import jax
import jax.numpy as jnp
import mujoco
import numpy as np

from humanoid_mjx.kernels.worlds import one_world
from humanoid_mjx.mechanics.tree.contacts import Slip
from humanoid_mjx.mechanics.tree.kinematics import make_kinematics
from humanoid_mjx.mechanics.tree.line import lowest_share
from humanoid_mjx.mechanics.tree.problem import Problem, active_at
from humanoid_mjx.mechanics.tree.reading import read_tree

TWO_HINGES = """<mujoco><worldbody>
  <body><joint/><geom size="0.1"/><body pos="1 0 0"><joint/><geom size="0.1"/></body></body>
</worldbody></mujoco>"""

MASS = np.array([[1.0, 0.999], [0.999, 1.0]])
"""Equal and opposite accelerations meet a thousandth of the inertia of others."""
WEIGHT, MOST = 0.002, 0.0001


def test_a_joint_that_begins_to_slip_is_found_although_large_forces_cancel():
    """Dry friction at its largest at the end of the way, not yet at its beginning. Forces of 1,000 N m cancel but for
    rounding, 6e-5 N m, a sizeable part of what they differ by along the way."""
    rng = np.random.default_rng(0)
    ends = np.stack([rng.uniform(-0.04, 0.04, 500), rng.choice([-1.0, 1.0], 500) * rng.uniform(0.06, 0.2, 500)], 1)
    common = rng.uniform(500.0, 1500.0, 500)
    before, after = ([common - slip, slip] for slip in ends.T)
    # The force for which `after` is the minimum as long as nothing slips.
    force = MASS @ np.array(after) + [np.zeros(500), WEIGHT * after[1]]
    tree = read_tree(mujoco.MjModel.from_xml_string(TWO_HINGES))

    def found(before, after, force):
        before, after, force = (list(part[:, None]) for part in (before, after, force))
        matrix = [np.float32(row[: i + 1, None, None]) for i, row in enumerate(MASS)]
        slip = Slip(*(np.full((1, 1), x, np.float32) for x in (WEIGHT, 0.0, MOST)))
        at_rest = [np.zeros((1, 1))] * 2
        problem = Problem(matrix, force, make_kinematics(tree, at_rest), at_rest, [], [], {}, {1: slip})
        active = active_at(tree, problem, before)
        return lowest_share(tree, problem, active, active, before, after, jnp.zeros(1, bool))

    share = jax.jit(jax.vmap(one_world(found), -1))(*(np.asarray(part, np.float32) for part in (before, after, force)))

    way = np.array(after) - before
    curve, low, high = np.einsum("iw,ij,jw->w", way, MASS, way), np.zeros(500), np.full(500, 10.0)
    for _ in range(60):
        middle = 0.5 * (low + high)
        change = np.clip(WEIGHT * (before[1] + middle * way[1]), -MOST, MOST) - WEIGHT * (before[1] + middle * way[1])
        slope = (middle - 1.0) * (curve + WEIGHT * way[1] ** 2) + change * way[1]
        low, high = np.where(slope < 0.0, middle, low), np.where(slope < 0.0, high, middle)
    np.testing.assert_allclose(share, low, rtol=0.05)  # a few steps along a line; a sum of all forces is wrong by 86 %
