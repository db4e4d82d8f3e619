"""From poses of the toe to joint angles, in closed form.

Equations 4.8 to 4.12 of the source drop two of the five transformations and are never right. The way here: the toe's
pose T = [n o a p] gives the roll from (p - o1).a = l2 S3; the ankle's centre w = p - l5 n - o1 then gives two equations
linear in sine and cosine of the hip's pitch,

    ax S1 - ay C1 = S3    and    wx S1 - wy C1 = K(q3),

which have one solution, or, where they say the same (every pose with q2 = q3 = 0), one elbow pair each. T has six
dimensions and the leg five joints: what does not lead back to T is no solution.
"""

from functools import partial

import jax
import jax.numpy as jnp
from jaxtyping import Array, Bool, Float

from humanoid_mjx.mechanics.forward import forward, frames, jacobian
from humanoid_mjx.robot.leg import Leg
from humanoid_mjx.types import FloatScalar

SOLUTIONS = 4
"""Rows of solutions that `inverse` returns: the elbow pair of a planar pose, for both signs of cos(q3)."""

TOLERANCE = {"float32": 1e-5, "float64": 1e-10}
"""Largest deviation of a solution's pose: entries of the rotation, and metres."""


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
    q = wrap(q[jnp.argsort(jnp.maximum(_error(leg, pose, q), 8 * eps), stable=True)])
    apart = jnp.max(jnp.abs(wrap(q[:, None] - q[None])), axis=-1)
    same = apart < 50 * jnp.sqrt(eps)
    return q, ~jnp.any(jnp.tril(same, -1), axis=1)


def _error(leg: Leg, pose: Float[Array, "4 4"], q: Float[Array, "rows 5"]) -> Float[Array, " rows"]:
    return jax.vmap(lambda row: jnp.max(jnp.abs(forward(leg, row) - pose)))(q)


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
