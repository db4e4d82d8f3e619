"""Events of a body: pushes, worlds that differ from episode to episode, and a fall, which ends one."""

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float, Key

from humanoid_mjx.spec import Spec, traced
from humanoid_mjx.tasks.legged.body import Plant
from humanoid_mjx.tasks.legged.view import View
from humanoid_mjx.types import BoolScalar, FloatScalar


class Push(Spec):
    """An impulse on the torso from a random side, over one period between decisions."""

    impulse: float = traced(0.08182, ge=0, description="largest, in units of the robot's momentum at Froude number 1")
    least: float = traced(1.0, ge=0, le=1, description="smallest, as a share of `impulse`")
    every: float = traced(2.0, gt=0, description="time between pushes, s; not read with impulse 0")

    def first(self, key: Key[Array, ""]) -> FloatScalar:
        """Time of the first one, s."""
        return self.every * jax.random.uniform(key)

    def force(self, since: FloatScalar, period: float, key: Key[Array, ""]) -> Float[Array, "3"]:
        """Return the force on the torso during the next period, in units of the impulse per second. `since`: time since
        the first push was due, s."""
        due = (since >= 0) & (jnp.mod(since, self.every) < period)
        side = jax.random.uniform(key, (), maxval=2 * np.pi)
        share = 1.0 - (1.0 - self.least) * jax.random.uniform(jax.random.fold_in(key, 1))
        force = share * self.impulse / period * jnp.stack([jnp.cos(side), jnp.sin(side), 0.0 * side])
        return jnp.where(due, force, 0.0)


class Randomise(Spec):
    """Domain randomisation: in each episode the values differ by at most these shares, uniformly distributed."""

    mass: float = traced(0.1, ge=0, lt=1, description="share of the links' mass")
    friction: float = traced(0.3, ge=0, lt=1, description="share of the feet's friction")
    joint_damping: float = traced(0.3, ge=0, lt=1, description="share of the joints' damping")
    torque_limit: float = traced(0.1, ge=0, lt=1, description="share of the motors' limit")

    def draw(self, plant: Plant, key: Key[Array, ""]) -> Plant:
        """The values of one episode about those of `plant`."""
        names = tuple(type(self).model_fields)
        spread = jnp.stack([jnp.asarray(getattr(self, name), float) for name in names])
        factors = 1.0 + spread * jax.random.uniform(key, (len(names),), minval=-1.0)
        return plant._replace(**{name: getattr(plant, name) * f for name, f in zip(names, factors, strict=True)})


class Fall(Spec):
    """Limits beyond which a body has fallen: it lies, or is about to."""

    tilt: float = traced(45.0, gt=0, le=180, description="lean of the torso, degrees")
    height: float = traced(0.6234, ge=0, le=2, description="of the hips, as a share of that at home")

    def fallen(self, view: View) -> BoolScalar:
        """Return whether the torso leans farther or the hips are lower than these."""
        return (view.up[2] < jnp.cos(jnp.radians(self.tilt))) | (view.height < self.height * view.robot.leg_length)
