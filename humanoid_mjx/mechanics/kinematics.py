"""Kinematics of the leg: pure functions of a leg and its joint angles in radians, to be jitted and vmapped.

Poses are 4 x 4 in frame 0, lengths in metres. `forward`, `frames`, `jacobian`, `manipulability`, `singular_values`,
`static_torque` and `workspace` take any chain of revolute joints; the others are the five-joint leg's.
"""

import jax
import jax.numpy as jnp
from jaxtyping import Array, Float

from humanoid_mjx.mechanics.forward import forward, frames, jacobian
from humanoid_mjx.mechanics.inverse import follow, inverse, within, wrap
from humanoid_mjx.robot.chain import Chain
from humanoid_mjx.robot.leg import Leg
from humanoid_mjx.types import AnyArray

__all__ = [
    "follow",
    "forward",
    "frames",
    "inverse",
    "jacobian",
    "manipulability",
    "singular_values",
    "singularity_distance",
    "static_torque",
    "within",
    "workspace",
    "wrap",
]


def singular_values(chain: Chain, q: Float[Array, " joints"]) -> Float[Array, " joints"]:
    """The singular values of the Jacobian in m and rad, largest first. The last is 0 where the leg is singular."""
    return jnp.linalg.svd(jacobian(chain, q), compute_uv=False)


def manipulability(chain: Chain, q: Float[Array, " joints"]) -> Float[Array, ""]:
    """Yoshikawa's measure sqrt(det(J^T J)), the product of the singular values."""
    return jnp.prod(singular_values(chain, q))


def static_torque(chain: Chain, q: Float[Array, " joints"], wrench: Float[Array, "6"]) -> Float[Array, " joints"]:
    """Joint torques J^T F, N m, of a force and a moment at the toe in frame 0, N and N m (equation 4.25)."""
    return jnp.matmul(jacobian(chain, q).T, wrench, precision=jax.lax.Precision.HIGHEST)


def singularity_distance(leg: Leg, q: Float[Array, "5"]) -> Float[Array, ""]:
    """How far the joints would have to turn, rad, until the 6 x 5 Jacobian loses rank.

    The Jacobian is singular exactly where one of four pairs of conditions holds: yaw and knee straight (`S2 = S4 = 0`,
    the only one in the joint ranges), `S2 = 0` and `C3 = -l3/l2`, `C3 = S4 = 0`, or `C3 = C2 = 0`. Each fixes two of
    the angles q2, q3 and q4; the distance is the Euclidean one to the nearest such place. The determinants of equations
    4.20 and 4.21 do not tell: both vanish on the whole straight walk.
    """
    _, q2, q3, q4, _ = q
    l2, l3 = leg.d[1], leg.a[2]
    knee_straight = jnp.abs(_to_multiple_of_pi(q4))
    yaw_straight = jnp.abs(_to_multiple_of_pi(q2))
    yaw_square = jnp.abs(_to_multiple_of_pi(q2 - jnp.pi / 2))
    roll_square = jnp.abs(_to_multiple_of_pi(q3 - jnp.pi / 2))
    folded = jnp.abs(jnp.abs(wrap(q3)) - jnp.arccos(jnp.clip(-l3 / l2, -1.0, 1.0)))
    pairs = jnp.stack(
        [
            jnp.hypot(yaw_straight, knee_straight),
            jnp.where(l3 <= l2, jnp.hypot(yaw_straight, folded), jnp.inf),
            jnp.hypot(roll_square, knee_straight),
            jnp.hypot(roll_square, yaw_square),
        ]
    )
    return jnp.min(pairs)


def workspace(chain: Chain, ranges: Float[AnyArray, "joints 2"], key: Array, n: int) -> Float[Array, "{n} 3"]:
    """Toe positions, m, of `n` postures drawn uniformly from the joints' ranges, rad."""
    low, high = jnp.asarray(ranges, chain.d.dtype).T
    postures = jax.random.uniform(key, (n, chain.num_joints), chain.d.dtype, low, high)
    return jax.vmap(lambda q: forward(chain, q)[:3, 3])(postures)


def _to_multiple_of_pi(angle: Float[Array, ""]) -> Float[Array, ""]:
    return angle - jnp.pi * jnp.round(angle / jnp.pi)
