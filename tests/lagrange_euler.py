"""The Lagrange-Euler equations of section 4.6, corrected: an independent and readable check of `mechanics.dynamics`.

With A_i the transform from frame i to frame i-1, Q the derivative of a turn about z (Q A = dA/dq) and I_p the
pseudo-inertia of link p, the formulas are Uicker's:

    d_pj   = A_1 ... A_(j-1) Q A_j ... A_p        (d T_p / d q_j, zero for j > p)
    M_ij   = sum over p of Tr(d_pj I_p d_pi^T)
    h_ijk  = sum over p of Tr((d d_pj / d q_k) I_p d_pi^T)
    G_i    = -sum over p of g^T d_pi I_p[:, 4]
    tau_i  = sum_j M_ij qdd_j + sum_jk h_ijk qd_j qd_k + G_i

The source prints d(d_pk)/dq_p for d(d_pj)/dq_k in (4.29), (4.32) and appendix G, and qd for qdd in (4.29) and (5.15).
"""

import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from humanoid_mjx.robot.chain import Chain, quarter_turns

Joints = Float[Array, " joints"]

Q = np.array([[0.0, -1, 0, 0], [1, 0, 0, 0], [0, 0, 0, 0], [0, 0, 0, 0]])


def mass_matrix(leg: Chain, qpos: Joints) -> Float[Array, "joints joints"]:
    """M_ij, kg m^2."""
    first = _first_derivatives(leg, qpos)
    return jnp.einsum("jpab,pbc,ipac->ij", first, leg.pseudo_inertia, first)


def velocity_coefficients(leg: Chain, qpos: Joints) -> Float[Array, "joints joints joints"]:
    """h_ijk, kg m^2: symmetric in j and k."""
    first, second = _first_derivatives(leg, qpos), _second_derivatives(leg, qpos)
    return jnp.einsum("jkpab,pbc,ipac->ijk", second, leg.pseudo_inertia, first)


def coriolis(leg: Chain, qpos: Joints, qvel: Joints) -> Joints:
    """The whole velocity term, N m."""
    return jnp.einsum("ijk,j,k->i", velocity_coefficients(leg, qpos), qvel, qvel)


def gravity(leg: Chain, qpos: Joints) -> Joints:
    """G_i, N m."""
    return -jnp.einsum("a,ipab,pb->i", leg.gravity, _first_derivatives(leg, qpos)[:, :, :3], leg.pseudo_inertia[..., 3])


def inverse_dynamics(leg: Chain, qpos: Joints, qvel: Joints, qacc: Joints) -> Joints:
    """tau_i, N m."""
    return mass_matrix(leg, qpos) @ qacc + coriolis(leg, qpos, qvel) + gravity(leg, qpos)


def _transforms(leg: Chain, qpos: Joints) -> list[Float[Array, "4 4"]]:
    """A_i: from frame i to frame i-1."""
    transforms = []
    for i in range(leg.num_joints):
        angle = qpos[i] + leg.structure.theta_offset[i]
        c, s = jnp.cos(angle), jnp.sin(angle)
        turn = jnp.array([[c, -s, 0, 0], [s, c, 0, 0], [0, 0, 1, 0], [0, 0, 0, 1]])
        c, s = quarter_turns(leg.structure.alpha[i])
        rest = jnp.array([[1, 0, 0, leg.a[i]], [0, c, -s, 0], [0, s, c, leg.d[i]], [0, 0, 0, 1]])
        transforms.append(turn @ rest)
    return transforms


def _product(transforms: list[Float[Array, "4 4"]], last: int, turned: tuple[int, ...]) -> Array:
    """A_1 ... A_last with one Q before the A of each joint in `turned`; zero if one of them comes after `last`."""
    if any(joint > last for joint in turned):
        return jnp.zeros_like(transforms[0])
    product = jnp.eye(4, dtype=transforms[0].dtype)
    for joint in range(last + 1):
        for _ in range(turned.count(joint)):
            product = product @ Q
        product = product @ transforms[joint]
    return product


def _first_derivatives(leg: Chain, qpos: Joints) -> Float[Array, "joints joints 4 4"]:
    """d_pj by [j, p]."""
    transforms, joints = _transforms(leg, qpos), range(leg.num_joints)
    return jnp.array([[_product(transforms, p, (j,)) for p in joints] for j in joints])


def _second_derivatives(leg: Chain, qpos: Joints) -> Float[Array, "joints joints joints 4 4"]:
    """d d_pj / d q_k by [j, k, p]."""
    transforms, joints = _transforms(leg, qpos), range(leg.num_joints)
    return jnp.array([[[_product(transforms, p, (j, k)) for p in joints] for k in joints] for j in joints])
