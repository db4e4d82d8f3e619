"""Actuator models: from the torque that a control law requests to the torque that acts on a joint.

    ideal      the requested torque, up to the limit of the robot's motor
    dc_motor   the torque that a geared DC motor can give at the speed of the joint (thesis 5.3 and 5.4)

Both are functions of torque and speed alone, so they work with every physics. Friction that does not grow with speed is
the joint's: `frictionloss` in the robot's model.
"""

from collections.abc import Iterable
from functools import partial
from typing import Annotated, Any, Literal

import jax.numpy as jnp
import numpy as np
import pydantic
from jaxtyping import Array, Float

from humanoid_mjx.control.pd import Joints
from humanoid_mjx.robot.description import Robot
from humanoid_mjx.spec import InputError, Named, make, traced, written


def limited(torque: Iterable[Any], limits: Iterable[Any]) -> Joints:
    """Clip the torque of each joint to the limit of its motor, N m, as every physics does at the end.

    It clips joint by joint: a bound on the whole array would be a kernel of its own between those of its elements.
    """
    parts = [jnp.clip(part, -limit, limit) for part, limit in zip(torque, limits, strict=True)]
    return jnp.stack(parts) if parts else jnp.zeros(0)


class Drive(Named):
    """Base of drives: derive from it, declare values with `traced`, implement `__call__`."""

    def __call__(self, torque: Joints, qvel: Joints) -> Joints:
        """Return the torques, N m, that act on the joints, from the requested ones and the joint velocities, rad/s."""
        raise NotImplementedError

    def check(self, robot: Robot, timestep: float) -> None:
        """Raise an InputError for a robot that this model does not fit, at time steps of `timestep` seconds."""


class Ideal(Drive):
    """Every requested torque acts in full, at any speed."""

    name: Literal["ideal"] = "ideal"

    def __call__(self, torque: Joints, qvel: Joints) -> Joints:
        return torque


Gear = float | Annotated[tuple[float, ...], pydantic.Field(strict=False)]


class DcMotor(Drive):
    """A geared DC motor at each joint: its torque falls with speed and is limited by voltage and current.

    By default a motor of 25 mm that stalls at 2.3 N m and turns at 8.8 rad/s without a load. The gear slows the joint
    down by `gear` and strengthens it by as much (5.7 to 5.10). In SI units the back-emf constant equals the torque
    constant: otherwise the motor would not conserve power. The armature's inductance is left out, as in (5.23); the
    rotor's inertia is MuJoCo's `armature`.
    """

    name: Literal["dc_motor"] = "dc_motor"
    gear: Gear = traced(100.0, description="gear ratio, motor turns per joint turn; one number, or one for each joint")
    voltage: float = traced(12.0, gt=0, description="largest voltage of the driver, V")
    current: float = traced(1e3, gt=0, description="largest current of the driver, A")
    torque_constant: float = traced(0.0136, gt=0, description="N m/A, and as much V s/rad")
    resistance: float = traced(7.0, gt=0, description="ohm")
    friction: float = traced(1e-6, ge=0, description="viscous friction of the rotor, N m s/rad")

    @property
    def gears(self) -> Float[Array, "*joints"]:
        """The gear of all joints, or that of each."""
        return jnp.asarray(self.gear, float)

    def __call__(self, torque: Joints, qvel: Joints) -> Joints:
        """The torques within the driver's current and voltage (5.21 to 5.24)."""
        limit, speed = self.gears * self.torque_constant * self.current, self.gears * qvel
        needed = (jnp.clip(torque, -limit, limit) / self.gears + self.friction * speed) / self.torque_constant
        voltage = self.torque_constant * speed + needed * self.resistance
        current = (jnp.clip(voltage, -self.voltage, self.voltage) - self.torque_constant * speed) / self.resistance
        return self.gears * (self.torque_constant * current - self.friction * speed)

    def check(self, robot: Robot, timestep: float) -> None:
        gear, joints = np.asarray(self.gear, float), len(robot.joints)
        if gear.shape not in ((), (joints,)) or not (np.isfinite(gear) & (gear > 0)).all():
            raise InputError(f"actuator.gear must be positive, one number or {joints}, got {self.gear}.")
        model = robot.model
        inertia = model.dof_armature[model.jnt_dofadr[robot.driven]]
        slope = gear**2 * (self.torque_constant**2 / self.resistance + self.friction)
        if (slope * timestep > 2.0 * inertia).any():
            raise InputError(
                f"actuator: at the voltage limit the torque falls by {slope.max():.3g} N m per rad/s, too fast for an "
                f"armature of {inertia.min():.3g} kg m^2 in steps of {timestep:g} s; lower the gear."
            )


DRIVES = {"ideal": "humanoid_mjx.control.drives:Ideal", "dc_motor": "humanoid_mjx.control.drives:DcMotor"}

Drives = Annotated[pydantic.SerializeAsAny[Drive], written("actuator", partial(make, "actuator", DRIVES, Drive))]
"""The type of a task's field `actuator`."""
