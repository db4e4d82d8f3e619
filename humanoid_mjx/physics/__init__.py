"""Physics, which move the robots. `make_physics("mjx-jax", timestep=0.002)` builds and checks a physics."""

from functools import lru_cache
from typing import TYPE_CHECKING, Any, Literal, TypeVar, overload

from humanoid_mjx.physics.base import Physics
from humanoid_mjx.spec import InputError, make, shown

if TYPE_CHECKING:
    from humanoid_mjx.physics.chain import ChainPhysics
    from humanoid_mjx.physics.mjx import MjxJax, MjxWarp
    from humanoid_mjx.physics.native import Native
    from humanoid_mjx.physics.tree import TreePhysics

SomePhysics = TypeVar("SomePhysics", bound=Physics)

PHYSICS = {
    "chain": "humanoid_mjx.physics.chain:ChainPhysics",
    "mjx-jax": "humanoid_mjx.physics.mjx:MjxJax",
    "mjx-warp": "humanoid_mjx.physics.mjx:MjxWarp",
    "mujoco": "humanoid_mjx.physics.native:Native",
    "tree": "humanoid_mjx.physics.tree:TreePhysics",
    "unmodified": "humanoid_mjx.physics.unmodified:Unmodified",
}


@overload
def make_physics(name: Literal["chain"], /, **params: Any) -> "ChainPhysics": ...
@overload
def make_physics(name: Literal["mjx-jax"], /, **params: Any) -> "MjxJax": ...
@overload
def make_physics(name: Literal["mjx-warp"], /, **params: Any) -> "MjxWarp": ...
@overload
def make_physics(name: Literal["mujoco"], /, **params: Any) -> "Native": ...
@overload
def make_physics(name: Literal["tree"], /, **params: Any) -> "TreePhysics": ...
@overload
def make_physics(name: str, /, **params: Any) -> Physics: ...
@overload
def make_physics(name: str, base: type[SomePhysics], /, **params: Any) -> SomePhysics: ...
def make_physics(name: str, base: type[Physics] = Physics, /, **params: Any) -> Physics:
    """Build the physics called `name`, or a user's own given as "package.module:Class", which derives from `base`.

    Raises:
      InputError: unknown name or parameter, a value out of range, or a package that is not installed.
    """
    if not isinstance(base, type):
        raise InputError(f"make_physics: name the values, as in make_physics({name!r}, robot=...); got {shown(base)}.")
    return make("physics", PHYSICS, base, name, **params)


kept_physics: Any = lru_cache(make_physics)
"""`make_physics` for tasks, which ask for their physics often: the same object for the same values."""
