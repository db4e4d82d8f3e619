"""Physics, which move the robots. `make_physics("mjx-jax", timestep=0.002)` builds and checks a physics."""

from typing import Any

from humanoid_mjx.physics.base import Physics
from humanoid_mjx.spec import make

PHYSICS = {
    "chain": "humanoid_mjx.physics.chain:ChainPhysics",
    "mjx-jax": "humanoid_mjx.physics.mjx:MjxJax",
    "mjx-warp": "humanoid_mjx.physics.mjx:MjxWarp",
    "mujoco": "humanoid_mjx.physics.native:Native",
    "tree": "humanoid_mjx.physics.tree:TreePhysics",
}


def make_physics(name: str, base: type[Physics] = Physics, /, **params: Any) -> Any:
    """Build the physics called `name`, or a user's own given as "package.module:Class", which derives from `base`.

    Raises:
      InputError: unknown name or parameter, a value out of range, or a package that is not installed.
    """
    return make("physics", PHYSICS, base, name, **params)
