"""Ground that is not a level plane: a slope, waves, stairs. Heights are arithmetic, without a table.

The z axis of the world is normal to the slope, and gravity leans instead: the same mechanics, at no cost. Waves and
stairs are heights above the plane z = 0.
"""

import math
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float, Key
from pydantic import model_validator

from humanoid_mjx.spec import Spec, traced
from humanoid_mjx.types import AnyArray

WAVES = (0.0, 1.0), (2.0, 0.8), (4.1, 1.3)
"""Direction, rad, and length, as a share of `wavelength`, of the waves that add up to rough ground. No two are
parallel and no lengths have a common multiple, so the ground repeats nowhere."""


class Terrain(Spec):
    """The shape of the ground. It is the same in all episodes, but for the amplitudes; each begins elsewhere on it."""

    slope: float = traced(0.0, ge=0, le=45, description="inclination of the ground, degrees")
    direction: float = traced(0.0, description="of the slope and the stairs upwards, degrees from the x axis")
    rough: float | None = traced(None, ge=0, description="largest height and depth of waves, m; none: no waves")
    wavelength: float = traced(0.3, gt=0, description="of the waves, m")
    stairs: float | None = traced(None, ge=0, description="height of a step, m; none: no steps")
    width: float = traced(0.25, gt=0, description="of a step, m")
    least: float = traced(
        1.0, ge=0, le=1, description="the least slope, waves and step of an episode, as shares of these, the largest"
    )
    alone: tuple[float, ...] = traced(
        (),
        strict=False,
        description="probabilities that an episode has the slope, the waves or the steps alone; none of them in the "
        "rest of the episodes; empty: all of them in each episode",
    )

    @model_validator(mode="after")
    def _keys_fit_together(self) -> "Terrain":
        if self.alone and (len(self.alone) != 3 or min(self.alone) < 0 or math.fsum(self.alone) > 1):
            raise ValueError(f"alone must hold three probabilities whose sum is at most 1, got {self.alone}")
        for name, share in zip(("rough", "stairs"), self.alone[1:], strict=False):
            if share and getattr(self, name) is None:
                raise ValueError(f"alone has a probability of {name}, of which there is no height")
        for name, key in (("rough", "wavelength"), ("stairs", "width")):
            if getattr(self, name) is None and getattr(self, key) != type(self).model_fields[key].default:
                raise ValueError(f"{key} is not read without {name}; leave it out, or set task.terrain.{name}")
        return self

    @property
    def shaped(self) -> bool:
        """True if the ground has waves or steps."""
        return self.rough is not None or self.stairs is not None

    def up(self, lib: Any = jnp) -> Float[AnyArray, "3"]:
        """The direction against gravity; `lib` is jnp or np."""
        (x, y), slope = self._rising(lib), lib.radians(self.slope)
        return lib.stack([lib.sin(slope) * x, lib.sin(slope) * y, lib.cos(slope)])

    def draw(self, key: Key[Array, ""]) -> "Terrain":
        """The ground of one episode."""
        shares = 1.0 - (1.0 - self.least) * jax.random.uniform(key, (3,))
        if self.alone:
            chosen, ends = jax.random.uniform(jax.random.fold_in(key, 1)), jnp.cumsum(jnp.asarray(self.alone))
            shares *= jnp.arange(3) == jnp.searchsorted(ends, chosen, side="right")
        drawn = {
            name: share * value
            for name, share in zip(("slope", "rough", "stairs"), shares, strict=True)
            if (value := getattr(self, name)) is not None
        }
        return jax.tree.map(lambda value: jnp.asarray(value, float), self.replace(**drawn, alone=()))

    def height(self, x: Any, y: Any, lib: Any = jnp) -> Any:
        """Height of the ground, m; `lib` is jnp or np."""
        steps = 0.0 if self.stairs is None else self.step(x, y, lib) * self.stairs
        return steps + self.waves(x, y, lib)[0]

    def step(self, x: Any, y: Any, lib: Any = jnp) -> Any:
        """Number of the step."""
        toward_x, toward_y = self._rising(lib)
        return lib.floor((toward_x * x + toward_y * y) / self.width)

    def level(self, x: Any, y: Any) -> Any:
        """Height of the ground, m, at places of a world whose z axis points against gravity."""
        (east, north), slope = self._rising(np), np.radians(self.slope)
        along, over = east * x + north * y, np.zeros_like(x)
        for _ in range(3):  # the place on the slope depends on the height above it
            moved = (along + over * np.sin(slope)) / np.cos(slope) - along
            over = self.height(x + moved * east, y + moved * north, np)
        return along * np.tan(slope) + over / np.cos(slope)

    @property
    def bounds(self) -> tuple[Float[np.ndarray, "2"], float]:
        """Slope of the mean of `level` along x and y, and the largest distance from that plane, m."""
        step, slope = self.stairs or 0.0, np.radians(self.slope)
        rise = np.tan(slope + np.arctan(step / self.width))
        return rise * np.array(self._rising(np)), (step + (self.rough or 0.0)) / np.cos(slope)

    def above(self, place: Float[Array, "*places 3"]) -> Float[Array, "*places"]:
        """Height of a place above the ground below it, m."""
        return place[..., 2] - self.height(place[..., 0], place[..., 1])

    def nearest(
        self, place: Float[Array, "*places 3 lanes world"], upper: bool
    ) -> tuple[Float[Array, "*places lanes world"], Float[Array, "*places 3 lanes world"]]:
        """The distance of a place from the ground, m, and the normal there.

        Stairs are exact: `upper` chooses which of the two boxes counts that meet at the riser nearest to the place.
        Waves are exact to first order: the ground's tangent plane below the place counts.
        """
        x, y, z = (place[..., axis, :, :] for axis in range(3))
        height, along_x, along_y = self.waves(x, y, jnp)
        z, (toward_x, toward_y) = z - height, self._rising(jnp)
        distance, level, steep = z, 0.0, 1.0
        if self.stairs is not None:
            along = toward_x * x + toward_y * y
            riser = jnp.floor(along / self.width + 0.5)
            over = z - (riser if upper else riser - 1.0) * self.stairs
            beside = (riser * self.width - along) if upper else (along - riser * self.width)
            inside = (over <= 0.0) & (beside <= 0.0)
            p, q = jnp.maximum(beside, 0.0), jnp.maximum(over, 0.0)
            away = jnp.sqrt(jnp.where(inside, 1.0, p * p + q * q))
            # Inside of a box its nearest face counts.
            distance = jnp.where(inside, jnp.maximum(over, beside), away)
            level = jnp.where(inside, jnp.where(over >= beside, 0.0, 1.0), p / away)
            steep = jnp.where(inside, jnp.where(over >= beside, 1.0, 0.0), q / away)
            level = -level if upper else level
        normal = toward_x * level - steep * along_x, toward_y * level - steep * along_y, steep
        if self.rough is not None:
            length = jnp.sqrt(sum(part * part for part in normal))
            distance, normal = distance / length, tuple(part / length for part in normal)
        return distance, jnp.stack(jnp.broadcast_arrays(*normal), axis=-3)

    def _rising(self, lib: Any) -> tuple[Any, Any]:
        return lib.cos(lib.radians(self.direction)), lib.sin(lib.radians(self.direction))

    def waves(self, x: Any, y: Any, lib: Any) -> tuple[Any, Any, Any]:
        """Height of the waves, and its derivatives by x and y."""
        if self.rough is None:
            return 0.0, 0.0, 0.0
        height = along_x = along_y = 0.0
        for direction, length in WAVES:
            number = 2.0 * math.pi / (length * self.wavelength)
            phase = number * (math.cos(direction) * x + math.sin(direction) * y)
            height = height + self.rough / len(WAVES) * lib.sin(phase)
            rate = self.rough / len(WAVES) * number * lib.cos(phase)
            along_x, along_y = along_x + math.cos(direction) * rate, along_y + math.sin(direction) * rate
        return height, along_x, along_y
