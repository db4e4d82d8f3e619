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

from typing import Any

import jax
import jax.numpy as jnp
from jaxtyping import Array, Float

from humanoid_mjx.control.pd import Joints
from humanoid_mjx.control.stages import Contacts
from humanoid_mjx.types import FloatScalar

NATURAL_FREQUENCY = 20.0
"""rad/s, of errors that are critically damped: slower than MuJoCo's soft contacts, which answer within 0.02 s. At 15 a
standing body gives way to a push further than under the servo; at 26 pushes topple it that it would otherwise
survive."""

SERVO_KP, SERVO_KD = 6.0, 0.2
"""Gains of a servo that keeps the body standing, N m/rad and N m s/rad. It is unstable over a cycle of 0.02 s: call it
at every step."""

SHARE = 0.1
"""Default weight of the servo: it takes over where contacts reduce a torque's effect on the joints below this share. A
sideways push needs it: without ankle roll, rigid flat feet allow no sway, but a real foot's edges lift. At 0.01 and
below such a push drives the torques to their limits and the body falls."""

SOFTNESS = 1.7e-4
"""Regularisation of the contacts' inverse inertia as a share of that of the whole body, since the corners of a foot are
redundant."""


def grounded_torque(
    wanted: Joints,
    held: Joints,
    share: FloatScalar,
    mass_matrix: Float[Array, "nv nv"],
    bias: Float[Array, " nv"],
    contacts: Contacts,
    joints: Any,
) -> Joints:
    """Return the joint torques, N m, that bring the accelerations wanted as near as the contacts and the servo allow.

    Args:
      wanted: accelerations wanted of the joints, rad/s^2.
      held: torques of the servo, N m.
      share: weight of the servo, 0 to 1; at 0 the accelerations are as near as the contacts allow.
      mass_matrix, bias, contacts, joints: see `Stages`.
    """
    mobility, drift = constrained_dynamics(mass_matrix, bias, contacts)
    inertia, mobility = mass_matrix[joints][:, joints], mobility[joints][:, joints]
    missing = wanted - drift[joints] - mobility @ held
    weighted = mobility @ inertia
    cost = weighted @ mobility + share**2 * eliminate(inertia, jnp.eye(len(wanted), dtype=inertia.dtype))
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
    # The body moves freely, along x first. Corners in the air keep a row of the identity, which no other row sees.
    resistance = across @ jacobian.T + jnp.diag(jnp.where(rows, SOFTNESS / mass_matrix[0, 0], 1.0).astype(bias.dtype))
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
