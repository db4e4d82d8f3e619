"""Kinematics of the leg: pure functions of a leg and its joint angles in radians, to be jitted and vmapped.

Poses are 4 x 4 in frame 0, lengths in metres. All but `inverse`, which is the five-joint leg's, take any chain of
revolute joints.
"""

import jax
import jax.numpy as jnp
from jaxtyping import Array, Float

from humanoid_mjx.mechanics.forward import forward, frames, jacobian
from humanoid_mjx.mechanics.inverse import inverse
from humanoid_mjx.robot.chain import Chain
from humanoid_mjx.types import AnyArray

__all__ = ["forward", "frames", "inverse", "jacobian", "static_torque", "workspace"]


def static_torque(chain: Chain, q: Float[Array, " joints"], wrench: Float[Array, "6"]) -> Float[Array, " joints"]:
    """Joint torques J^T F, N m, of a force and a moment at the toe in frame 0, N and N m (equation 4.25)."""
    return jnp.matmul(jacobian(chain, q).T, wrench, precision=jax.lax.Precision.HIGHEST)


def workspace(chain: Chain, ranges: Float[AnyArray, "joints 2"], key: Array, n: int) -> Float[Array, "{n} 3"]:
    """Toe positions, m, of `n` postures drawn uniformly from the joints' ranges, rad."""
    low, high = jnp.asarray(ranges, chain.d.dtype).T
    postures = jax.random.uniform(key, (n, chain.num_joints), chain.d.dtype, low, high)
    return jax.vmap(lambda q: forward(chain, q)[:3, 3])(postures)
