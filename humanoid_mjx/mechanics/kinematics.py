"""Kinematics of the leg: pure functions of a leg and its joint angles in radians, to be jitted and vmapped.

Poses are 4 x 4 in frame 0, lengths in metres. All but `inverse`, which is the five-joint leg's, take any chain of
revolute joints.

Equations 4.8 to 4.12 of the source, the inverse kinematics, drop two of the five transformations and are never right.
The way here: the toe's pose T = [n o a p] gives the roll from (p - o1).a = l2 S3; the ankle's centre w = p - l5 n - o1
then gives two equations linear in sine and cosine of the hip's pitch,

    ax S1 - ay C1 = S3    and    wx S1 - wy C1 = K(q3),

which have one solution, or, where they say the same (every pose with q2 = q3 = 0), one elbow pair each. T has six
dimensions and the leg five joints: a posture that does not lead back to T is no solution.
"""

from functools import partial

import jax
import jax.numpy as jnp
from jaxtyping import Array, Bool, Float

from humanoid_mjx.robot.chain import Chain, quarter_turns
from humanoid_mjx.robot.leg import Leg
from humanoid_mjx.types import AnyArray, FloatScalar

SOLUTIONS = 4
"""Rows of solutions that `inverse` returns: the elbow pair of a planar pose, for both signs of cos(q3)."""

TOLERANCE = {"float32": 1e-5, "float64": 1e-10}
"""Largest deviation of a solution's pose: entries of the rotation, and metres."""


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


def static_torque(chain: Chain, q: Float[Array, " joints"], wrench: Float[Array, "6"]) -> Float[Array, " joints"]:
    """Joint torques J^T F, N m, of a force and a moment at the toe in frame 0, N and N m (equation 4.25)."""
    return jnp.matmul(jacobian(chain, q).T, wrench, precision=jax.lax.Precision.HIGHEST)


def workspace(chain: Chain, ranges: Float[AnyArray, "joints 2"], key: Array, n: int) -> Float[Array, "{n} 3"]:
    """Toe positions, m, of `n` postures drawn uniformly from the joints' ranges, rad."""
    low, high = jnp.asarray(ranges, chain.d.dtype).T
    postures = jax.random.uniform(key, (n, chain.num_joints), chain.d.dtype, low, high)
    return jax.vmap(lambda q: forward(chain, q)[:3, 3])(postures)


def inverse(leg: Leg, pose: Float[Array, "4 4"]) -> tuple[Float[Array, "solutions 5"], Bool[Array, " solutions"]]:
    """All joint angles, rad in (-pi, pi], that put the toe at `pose`, and which of the rows are solutions.

    The valid rows come first and differ from each other; the most exact is the first. A pose out of reach, or one that
    five joints cannot take, has none. Where the leg is singular (yaw and knee straight) the angles are exact to the
    square root of the precision, the pose to full precision.
    """
    nearest, distinct = _distinct(leg, pose, _candidates(leg, pose))
    first = jnp.argsort(~distinct, stable=True)[:SOLUTIONS]
    solutions = jax.vmap(lambda q: _polish(leg, pose, _polish(leg, pose, q)))(nearest[first])
    solutions, valid = _distinct(leg, pose, solutions)
    off = jnp.abs(jax.vmap(forward, in_axes=(None, 0))(leg, solutions) - pose)
    valid &= jnp.all(off < TOLERANCE[str(pose.dtype)], axis=(1, 2))  # and not max(off): on the CPU it may lose a NaN
    first = jnp.argsort(~valid, stable=True)
    return solutions[first], valid[first]


def wrap(angle: Float[Array, "*shape"]) -> Float[Array, "*shape"]:
    """The same angles in (-pi, pi], rad."""
    return angle - 2 * jnp.pi * jnp.ceil((angle - jnp.pi) / (2 * jnp.pi))


def _candidates(leg: Leg, pose: Float[Array, "4 4"]) -> Float[Array, "candidates 5"]:
    """The solutions, if there are any, among other postures."""
    l1, l2, l3, l4, l5 = leg.lengths
    n, a, p = pose[:3, 0], pose[:3, 2], pose[:3, 3] - l1 * jnp.eye(3, dtype=pose.dtype)[2]
    w = p - l5 * n
    s3 = jnp.clip(jnp.dot(p, a, precision="highest") / l2, -1.0, 1.0)

    def with_sign(sign: Float[Array, ""]) -> Float[Array, "candidates 5"]:
        c3 = sign * jnp.sqrt((1 - s3) * (1 + s3))
        d = (jnp.dot(w, w, precision="highest") + l2**2 + l3**2 + 2 * l2 * l3 * c3 - l4**2) / 2
        k = _ratio(d * c3 + l2 * l3 * s3**2, l2 * c3 + l3)
        q1 = jnp.concatenate([_arcs(a, s3), _arcs(w, k), _crossing(a, s3, w, k)[None]])
        q2 = jnp.arctan2(sign * (a[0] * jnp.cos(q1) + a[1] * jnp.sin(q1)), -sign * a[2])
        q3 = jnp.broadcast_to(jnp.arctan2(s3, c3), q1.shape)
        return jax.vmap(lambda *hip: _knee_and_ankle(leg, pose, jnp.stack(hip), l5))(q1, q2, q3)

    return jax.vmap(with_sign)(jnp.array([1.0, -1.0], pose.dtype)).reshape(-1, 5)


def _distinct(
    leg: Leg, pose: Float[Array, "4 4"], q: Float[Array, "rows 5"]
) -> tuple[Float[Array, "rows 5"], Bool[Array, " rows"]]:
    """The postures, those nearest to the pose first, and which of them repeat none before.

    Errors of a few roundings count as equal. Then the order stays, in which the middle of a double root comes first.
    """
    eps = jnp.finfo(q.dtype).eps
    error = jax.vmap(lambda row: jnp.max(jnp.abs(forward(leg, row) - pose)))(q)
    q = wrap(q[jnp.argsort(jnp.maximum(error, 8 * eps), stable=True)])
    apart = jnp.max(jnp.abs(wrap(q[:, None] - q[None])), axis=-1)
    same = apart < 50 * jnp.sqrt(eps)
    return q, ~jnp.any(jnp.tril(same, -1), axis=1)


def _crossing(u: Float[Array, "3"], b: FloatScalar, v: Float[Array, "3"], c: FloatScalar) -> Float[Array, ""]:
    """The angle whose sine S and cosine C solve `u0 S - u1 C = b` and `v0 S - v1 C = c` together."""
    det = u[1] * v[0] - u[0] * v[1]
    sign = jnp.where(det < 0, -1, 1)
    return jnp.arctan2(sign * (u[1] * c - b * v[1]), sign * (u[0] * c - v[0] * b))


def _arcs(u: Float[Array, "3"], b: FloatScalar) -> Float[Array, "3"]:
    """The angle between the two that solve `u0 S - u1 C = b`, to which both go at a double root, and these two."""
    sine = jnp.clip(_ratio(b, jnp.hypot(u[0], u[1])), -1.0, 1.0)
    arc, middle = jnp.arcsin(sine), jnp.where(sine < 0, -jnp.pi / 2, jnp.pi / 2)
    return jnp.arctan2(u[1], u[0]) + jnp.stack([middle, arc, jnp.pi - arc])


def _knee_and_ankle(leg: Leg, pose: Float[Array, "4 4"], hip: Float[Array, "3"], l5: FloatScalar) -> Float[Array, "5"]:
    """The hip's angles with the knee's and the ankle's that turn and place the toe best."""
    knee = frames(leg, jnp.concatenate([hip, jnp.zeros(2, hip.dtype)]))[3]
    to_knee = partial(jnp.matmul, knee[:3, :3].T, precision="highest")
    n, p = to_knee(pose[:3, 0]), to_knee(pose[:3, 3] - knee[:3, 3])
    q4 = jnp.arctan2(p[1] - l5 * n[1], p[0] - l5 * n[0])
    return jnp.concatenate([hip, jnp.stack([q4, jnp.arctan2(n[1], n[0]) - q4])])


def _polish(leg: Leg, pose: Float[Array, "4 4"], q: Float[Array, "5"]) -> Float[Array, "5"]:
    """One damped Gauss-Newton step towards the pose."""
    now, jac = forward(leg, q), jacobian(leg, q)
    turn = jnp.sum(jnp.cross(now[:3, :3], pose[:3, :3], axis=0), axis=1) / 2
    error = jnp.concatenate([pose[:3, 3] - now[:3, 3], turn])
    normal = jnp.matmul(jac.T, jac, precision="highest")
    damping = 10 * jnp.finfo(q.dtype).eps * jnp.trace(normal) * jnp.eye(5, dtype=q.dtype)
    return q + jnp.linalg.solve(normal + damping, jnp.matmul(jac.T, error, precision="highest"))


def _ratio(a: FloatScalar, b: FloatScalar) -> Float[Array, ""]:
    """a / b, or 0 where b is 0."""
    return jnp.where(b == 0, 0.0, a / jnp.where(b == 0, 1.0, b))


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
