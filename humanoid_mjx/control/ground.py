"""Computed torque on the ground: inverse dynamics within what the feet's contacts allow, and a servo for the rest.

The ground is assumed rigid. Then a torque moves the joints by

    qacc = B torque + b,    B = M^-1 - M^-1 J^T (J M^-1 J^T)^-1 J M^-1 (the joints' rows and columns),

with J the Jacobian of the corners that touch (`Contacts`): the projected inverse dynamics of Aghili (IEEE Transactions
on Robotics 21, 2005) and of Mistry, Buchli and Schaal (ICRA 2010). With both feet flat B has rank four only: twelve of
the sixteen degrees of freedom are constrained, and no torque reaches an acceleration that would lift a foot off the
ground. There the torque is that of a plain servo, so that the soft contacts of a real ground meet a spring.

All is one least-squares problem, in the metric of the joints' inertia M_j (Gauss's),

    min |B torque + b - wanted|^2 (in M_j) + share^2 |torque - servo|^2 (in M_j^-1),

which covers every set of corners: flat feet, a foot on its edge or on one corner, flight. The ground is assumed to pull
as well as push; the corners that touch are read anew at every step, so that an error of this lasts one step.
"""

from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
from jaxtyping import Array, Float

from humanoid_mjx.control.gains import check_gains
from humanoid_mjx.control.pd import PD, Gain, Joints, Reference, checked_gains, pd, servo
from humanoid_mjx.mechanics.contacts import Contacts
from humanoid_mjx.spec import InputError
from humanoid_mjx.types import FloatScalar

KP, KD = 400.0, 40.0
"""1/s^2 and 1/s, critically damped: slower than MuJoCo's soft contacts, which answer within 0.02 s. At 225 and 30 a
standing body gives way to a push further than under the servo; at 700 and 53 pushes topple it that it would
otherwise survive."""

SERVO_KP, SERVO_KD = 6.0, 0.2
"""Gains of a servo that keeps the body standing, N m/rad and N m s/rad. It is unstable over a cycle of 0.02 s: call it
at every step."""

SHARE = 0.1
"""Where the contacts leave less than this share of what a torque would do to the joints of a held robot, the servo
takes over. A push sideways needs it: without ankle roll, rigid flat feet let no sway pass, but a real foot's edges
lift. For 0.01 and less such a push ends in torques at their limit and a fall."""

SOFTNESS = 1e-4
"""1/kg, added to the contacts' inverse inertia: the corners of a foot are redundant. The body weighs 1.7 kg."""


class GroundControl(NamedTuple):
    """The parameters of `grounded_torque`. `GroundControl.build` checks them."""

    kp: Gain
    """1/s^2"""
    kd: Gain
    """1/s"""
    servo: PD
    share: FloatScalar
    """Weight of the servo, 0 to 1; at 0 computed torque is as exact as the contacts allow."""

    @classmethod
    def build(
        cls,
        joints: int,
        kp: Any = KP,
        kd: Any = KD,
        servo_kp: Any = SERVO_KP,
        servo_kd: Any = SERVO_KD,
        share: float = SHARE,
    ) -> "GroundControl":
        """Check the gains, each a number or one for each joint, and the share.

        Raises:
          InputError: a gain that is negative, not finite or of another shape; a share outside 0 to 1.
        """
        held = check_gains(joints, servo_kp=servo_kp, servo_kd=servo_kd)
        if not 0 <= share <= 1:
            raise InputError(f"share must be from 0 to 1, got {share}.")
        return cls(*checked_gains(joints, kp, kd), PD.build(joints, *held.values()), jnp.asarray(share, float))


def grounded_torque(
    params: GroundControl,
    reference: Reference,
    qpos: Joints,
    qvel: Joints,
    mass_matrix: Float[Array, "nv nv"],
    bias: Float[Array, " nv"],
    contacts: Contacts,
) -> Joints:
    """Joint torques, N m, from the motion wanted and the state.

    Args:
      reference: motion wanted of the joints.
      qpos: joint angles, rad.
      qvel: joint velocities, rad/s.
      mass_matrix: mass matrix of all degrees of freedom, the joints last.
      bias: what acceleration and velocity add to `mass_matrix @ qacc` in the absence of contacts.
      contacts: the points of the feet.
    """
    joints = len(qpos)
    wanted = servo(params.kp, params.kd, reference, qpos, qvel)
    held = pd(params.servo, reference, qpos, qvel)
    mobility, drift = constrained_dynamics(mass_matrix, bias, contacts)
    inertia, mobility = mass_matrix[-joints:, -joints:], mobility[-joints:, -joints:]
    missing = wanted - drift[-joints:] - mobility @ held
    weighted = mobility @ inertia
    cost = weighted @ mobility + params.share**2 * eliminate(inertia, jnp.eye(joints, dtype=inertia.dtype))
    return held + eliminate(cost, (weighted @ missing)[:, None])[:, 0]


def constrained_dynamics(
    mass_matrix: Float[Array, "nv nv"], bias: Float[Array, " nv"], contacts: Contacts
) -> tuple[Float[Array, "nv nv"], Float[Array, " nv"]]:
    """B and b of `qacc = B force + b`, while the corners that touch stay where they are."""
    nv = len(bias)
    inverse = eliminate(mass_matrix, jnp.eye(nv, dtype=bias.dtype))
    if not len(contacts.touching):
        return inverse, -inverse @ bias
    rows = jnp.repeat(contacts.touching, 3)
    jacobian = jnp.where(rows[:, None], contacts.jacobian.reshape(-1, nv), 0.0)
    across = jacobian @ inverse
    # Corners in the air keep a row of the identity, which no other row sees.
    resistance = across @ jacobian.T + jnp.diag(jnp.where(rows, SOFTNESS, 1.0).astype(bias.dtype))
    forces = eliminate(resistance, across)
    mobility = inverse - across.T @ forces
    return mobility, -mobility @ bias - forces.T @ jnp.where(rows, contacts.drift.reshape(-1), 0.0)


def eliminate(matrix: Float[Array, "n n"], right: Float[Array, "n columns"]) -> Float[Array, "n columns"]:
    """`matrix^-1 right` of a symmetric positive definite matrix, by elimination without pivots.

    LAPACK's routines deadlock in XLA on a CPU when a batch calls several at once (jax 0.10.2).
    """
    table = jnp.concatenate([matrix, right], axis=1)

    def clear(k: Array, table: Float[Array, "n all"]) -> Float[Array, "n all"]:
        row = table[k] / table[k, k]
        return (table - table[:, k, None] * row).at[k].set(row)

    return jax.lax.fori_loop(0, len(matrix), clear, table)[:, len(matrix) :]
