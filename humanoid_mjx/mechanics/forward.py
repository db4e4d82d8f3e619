"""Poses of the links of a chain, and their Jacobian."""

import jax.numpy as jnp
from jaxtyping import Array, Float

from humanoid_mjx.robot.chain import Chain, quarter_turns


def frames(chain: Chain, q: Float[Array, " joints"]) -> Float[Array, "frames 4 4"]:
    """The poses of all frames in frame 0, frame 0 first (equation 4.6, partial products)."""
    structure = chain.structure
    x, y, z = jnp.eye(3, dtype=q.dtype)
    origin = jnp.zeros(3, q.dtype)
    poses = [_pose(x, y, z, origin)]
    for i in range(chain.num_joints):
        cos, sin = _turned(q[i], structure.theta_offset[i])
        x, y = cos * x + sin * y, cos * y - sin * x
        if structure.has_d[i]:
            origin = origin + chain.d[i] * z
        if structure.has_a[i]:
            origin = origin + chain.a[i] * x
        cos, sin = quarter_turns(structure.alpha[i])
        y, z = _sum(cos, y, sin, z), _sum(cos, z, -sin, y)
        poses.append(_pose(x, y, z, origin))
    return jnp.stack(poses)


def forward(chain: Chain, q: Float[Array, " joints"]) -> Float[Array, "4 4"]:
    """The pose of the last frame, the toe, in frame 0: rotation without unit, position in m (equation 4.6)."""
    return frames(chain, q)[-1]


def jacobian(chain: Chain, q: Float[Array, " joints"]) -> Float[Array, "6 joints"]:
    """The geometric Jacobian (equations 4.15 to 4.18): the toe's velocity, then its angular velocity, in frame 0."""
    poses = frames(chain, q)
    axes, origins = poses[:-1, :3, 2], poses[:-1, :3, 3]
    return jnp.concatenate([jnp.cross(axes, poses[-1, :3, 3] - origins), axes], axis=1).T


def _turned(angle: Float[Array, ""], offset: float) -> tuple[Float[Array, ""], Float[Array, ""]]:
    """Cosine and sine of angle + offset, exact for offsets of right angles."""
    cos, sin = jnp.cos(angle), jnp.sin(angle)
    offset_cos, offset_sin = quarter_turns(offset)
    return _sum(offset_cos, cos, -offset_sin, sin), _sum(offset_cos, sin, offset_sin, cos)


def _sum(a: float, u: Array, b: float, v: Array) -> Array:
    """a u + b v, without the terms that vanish."""
    return b * v if a == 0.0 else a * u if b == 0.0 else a * u + b * v


def _pose(x: Array, y: Array, z: Array, origin: Array) -> Float[Array, "4 4"]:
    return jnp.concatenate([jnp.stack([x, y, z, origin], axis=1), jnp.eye(4, dtype=x.dtype)[3:]])
