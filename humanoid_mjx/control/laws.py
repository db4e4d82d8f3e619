"""Control laws as robot tasks choose them: `control: {name: servo, stiffness: 3.0}`, or the name alone.

A law turns the motion wanted and the state of a robot into the torque of each joint. Its gains are traced. Where it
computes with a model of the robot, `mass` is the mass of that model's links as a multiple of the robot's own: the
plant's mass is a value of the physics, and the two may differ.

    servo            stiffness (q_d - q) - damping qd
    robot_servo      the same, with gains for each joint that are the robot's own
    pd               stiffness (q_d - q) + damping (qd_d - qd)
    partitioned_pd   diag(M) a,            a = qdd_d + kp (q_d - q) + kd (qd_d - qd)     (5.26 to 5.30)
    computed_torque  M a + bias            of the joints; treats a free torso as fixed and ignores the ground (5.40)
    grounded         inverse dynamics within what the contacts of the feet allow (`control.ground`)

with kp = natural_frequency^2 and kd = damping_ratio 2 natural_frequency (5.33, 5.34).
"""

from collections.abc import Callable
from functools import partial
from typing import Annotated, Literal

import jax.numpy as jnp
import numpy as np
import pydantic
from jax.tree_util import Partial

from humanoid_mjx.control.ground import NATURAL_FREQUENCY, SERVO_KD, SERVO_KP, SHARE, grounded_torque
from humanoid_mjx.control.pd import Gain, Joints, Reference, pd, servo
from humanoid_mjx.control.stages import Stages
from humanoid_mjx.robot.description import Robot
from humanoid_mjx.spec import InputError, Named, make, traced, written


class Law(Named):
    """Base of control laws: derive from it, declare gains with `traced`, implement `__call__`."""

    def __call__(self, reference: Reference, state: Stages) -> Joints:
        """The torque of each joint, N m, before the motors' limit."""
        raise NotImplementedError

    def of(self, robot: Robot) -> "Law":
        """Return the law with the robot's own gains filled in; `self` if the law uses none."""
        return self

    def follow(self, reference: Reference) -> Callable[[Stages], Joints]:
        """Return the controller that follows one reference, as `Physics.step` takes it: a pytree."""
        return Partial(_torque, self, reference)


def _torque(law: Law, reference: Reference, state: Stages) -> Joints:
    """The torques that a law asks for, one for each joint."""
    torque = law(reference, state)
    if (shape := jnp.shape(torque)) != (wanted := jnp.shape(state.qpos)):
        raise InputError(f"control: {type(law).__name__} must return torques of shape {wanted}, got {shape}.")
    return torque


class ServoLaw(Law):
    """A position servo: it takes set-points only, and damps every motion of its joint."""

    name: Literal["servo"] = "servo"
    stiffness: float = traced(SERVO_KP, gt=0, le=200, description="torque per error of the angle, N m/rad")
    damping: float = traced(SERVO_KD, ge=0, le=10, description="torque per velocity, N m s/rad")

    def __call__(self, reference: Reference, state: Stages) -> Joints:
        still = reference._replace(qvel=jnp.zeros_like(reference.qpos))
        return pd(self.stiffness, self.damping, still, state.qpos, state.qvel)


class RobotServoLaw(Law):
    """The servo that a robot's own description gives, joint by joint."""

    name: Literal["robot_servo"] = "robot_servo"
    stiffness: float = traced(1.0, gt=0, le=100, description="factor on that of the robot's servo")
    damping: float = traced(1.0, ge=0, le=100, description="factor on that of the robot's servo")

    def of(self, robot: Robot) -> ServoLaw:
        if robot.servo is None:
            raise InputError(f"control: the robot {robot.name} has no servo of its own; take servo, and its gains.")
        stiffness, damping = (np.asarray(gain, np.float32) for gain in robot.servo)
        return ServoLaw().replace(stiffness=self.stiffness * stiffness, damping=self.damping * damping)

    def __call__(self, reference: Reference, state: Stages) -> Joints:
        raise InputError("control: this task's robot has no servo of its own; take servo, and its gains.")


class PDLaw(ServoLaw):
    """A servo that also follows a wanted velocity: it damps the velocity error, not the velocity."""

    name: Literal["pd"] = "pd"  # pyright: ignore[reportIncompatibleVariableOverride]

    def __call__(self, reference: Reference, state: Stages) -> Joints:
        return pd(self.stiffness, self.damping, reference, state.qpos, state.qvel)


class ModelLaw(Law):
    """Base of model-based laws: each joint's error obeys a second-order equation with this frequency and damping."""

    natural_frequency: float = traced(12.0, gt=0, le=200, description="of the error, rad/s")
    damping_ratio: float = traced(1.0, gt=0, le=10, description="of the error; 1 is critical")
    mass: float = traced(1.0, gt=0, le=10, description="of the model's links, as a multiple of the robot's own")

    @property
    def gains(self) -> tuple[Gain, Gain]:
        """kp, 1/s^2, and kd, 1/s."""
        return self.natural_frequency**2, 2.0 * self.damping_ratio * self.natural_frequency

    def acceleration(self, reference: Reference, state: Stages) -> Joints:
        """Joint accelerations to ask for, rad/s^2: the torques of a robot of unit inertias."""
        return servo(*self.gains, reference, state.qpos, state.qvel)


class PartitionedPDLaw(ModelLaw):
    """Each joint through its own inertia (5.26 to 5.30): couplings, velocity terms and gravity remain as errors."""

    name: Literal["partitioned_pd"] = "partitioned_pd"

    def __call__(self, reference: Reference, state: Stages) -> Joints:
        matrix, _ = state.model_for(self.mass)
        return jnp.diagonal(matrix)[state.joints] * self.acceleration(reference, state)


class ComputedTorqueLaw(ModelLaw):
    """All of the joints' dynamics (5.40 to 5.49), with the torso treated as fixed."""

    name: Literal["computed_torque"] = "computed_torque"

    def __call__(self, reference: Reference, state: Stages) -> Joints:
        return state.torque_for(self.acceleration(reference, state), self.mass)


class GroundedLaw(ModelLaw):
    """Computed torque within what the feet's contacts allow, a servo for the rest (`control.ground`)."""

    name: Literal["grounded"] = "grounded"
    natural_frequency: float = traced(NATURAL_FREQUENCY, gt=0, le=200, description="of the error, rad/s")
    stiffness: float = traced(SERVO_KP, gt=0, le=200, description="of the servo, N m/rad")
    damping: float = traced(SERVO_KD, ge=0, le=10, description="of the servo, N m s/rad")
    share: float = traced(SHARE, ge=0, le=1, description="weight of the servo against the wanted accelerations")

    def __call__(self, reference: Reference, state: Stages) -> Joints:
        held = pd(self.stiffness, self.damping, reference, state.qpos, state.qvel)
        matrix, bias = state.model_for(self.mass)
        wanted, contacts = self.acceleration(reference, state), state.contacts()
        return grounded_torque(wanted, held, self.share, matrix, bias, contacts, state.joints)


LAWS = {
    law.model_fields["name"].default: f"{__name__}:{law.__name__}"
    for law in (ServoLaw, RobotServoLaw, PDLaw, PartitionedPDLaw, ComputedTorqueLaw, GroundedLaw)
}

make_law = partial(make, "control", LAWS, Law)
"""Build the law of a name, or a user's own given as "package.module:Class", with its parameters: see `make`."""

Control = Annotated[pydantic.SerializeAsAny[Law], written("control", make_law)]
"""The type of a task's field `control`."""
