"""What drives a joint: a permanent-magnet DC motor behind a gear (thesis 5.3 and 5.4).

Motor quantities are those of the actuator's shaft, joint quantities those of the link, which the gear slows down by
`gear_ratio` and strengthens by as much (5.7 to 5.10).
"""

from dataclasses import dataclass
from functools import partial
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float


class MotorState(NamedTuple):
    """What a motor does at one moment."""

    torque: Float[Array, "*joints"]
    """Torque at the joint, less the rotor's friction, N m."""
    current: Float[Array, "*joints"]
    """A"""
    voltage: Float[Array, "*joints"]
    """Voltage at the terminals, V."""


@partial(
    jax.tree_util.register_dataclass,
    data_fields=("torque_constant", "resistance", "gear_ratio", "rotor_inertia", "friction", "max_voltage"),
    meta_fields=(),
)
@dataclass(frozen=True)
class Motor:
    """A geared DC motor for each joint, every value a scalar or an array over joints.

    In SI units the back-emf constant equals the torque constant (otherwise the motor would not conserve power), so
    there is one. The armature's inductance is left out, as in (5.23).
    """

    torque_constant: Any
    """K_T = K_b, N m/A or V s/rad (5.21, 5.22)."""
    resistance: Any
    """R_a, ohm."""
    gear_ratio: Any = 1.0
    """eta, turns of the motor for one of the joint (5.7)."""
    rotor_inertia: Any = 0.0
    """I_a, kg m^2."""
    friction: Any = 0.0
    """B_a, viscous friction at the rotor, N m s/rad."""
    max_voltage: Any = np.inf
    """Largest voltage of the driver, V."""

    @property
    def reflected_inertia(self) -> Any:
        """What the rotor adds to the inertia of the joint: eta^2 I_a (5.14), MuJoCo's `armature`."""
        return self.gear_ratio**2 * self.rotor_inertia

    @property
    def reflected_friction(self) -> Any:
        """What the rotor adds to the viscous friction of the joint: eta^2 B_a (5.14)."""
        return self.gear_ratio**2 * self.friction

    def drive(self, voltage: Float[Array, "*joints"], qvel: Float[Array, "*joints"]) -> MotorState:
        """What the motor does at `voltage` (5.21 to 5.24), while the joint turns at `qvel` rad/s.

        The torque leaves out what accelerates the rotor: add `reflected_inertia` to the mass matrix.
        """
        voltage = jnp.clip(voltage, -self.max_voltage, self.max_voltage)
        speed = self.gear_ratio * qvel
        current = (voltage - self.torque_constant * speed) / self.resistance
        torque = self.gear_ratio * (self.torque_constant * current - self.friction * speed)
        return MotorState(torque, current, voltage)

    def voltage_for(self, torque: Float[Array, "*joints"], qvel: Float[Array, "*joints"]) -> Float[Array, "*joints"]:
        """The voltage that gives `torque` at the joint (5.24), before the driver's limit."""
        speed = self.gear_ratio * qvel
        current = (torque / self.gear_ratio + self.friction * speed) / self.torque_constant
        return self.torque_constant * speed + current * self.resistance

    def actuate(self, torque: Float[Array, "*joints"], qvel: Float[Array, "*joints"]) -> MotorState:
        """What a command of `torque` brings about: the motor's torque-speed line cuts it off where the voltage ends."""
        return self.drive(self.voltage_for(torque, qvel), qvel)

    def stall_torque(self) -> Any:
        """The largest torque at the joint, standing still, N m."""
        return self.gear_ratio * self.torque_constant * self.max_voltage / self.resistance

    def no_load_speed(self) -> Any:
        """The joint's speed at full voltage without a load, rad/s."""
        loss = self.friction * self.resistance / self.torque_constant
        return self.max_voltage / ((self.torque_constant + loss) * self.gear_ratio)
