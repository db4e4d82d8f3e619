# pyright: reportAttributeAccessIssue=false
"""Live robots that are seen together: their clock, and their physics."""

import time
from collections.abc import Callable
from functools import lru_cache
from typing import Any, ClassVar

import jax
import jax.numpy as jnp
import mujoco
import numpy as np
from jax.custom_batching import custom_vmap
from jax.experimental import io_callback
from jaxtyping import Float

from humanoid_mjx.evaluation.live.body import WARMSTART, Body, Hands
from humanoid_mjx.physics.native import Native
from humanoid_mjx.physics.unmodified import REST, Unmodified

FRAME_S = 1 / 40
"""Time between two frames that are shown, s."""

LATEST_S = 0.25
"""Largest delay behind real time that is caught up, s; a slower machine shows slow motion."""


class Stage:
    """Robots that are seen together, the forces of the user on them, and the clock."""

    def __init__(self, base: mujoco.MjModel, rest: int = WARMSTART):
        self.bodies = [Body(base, rest)]
        self.hands = Hands()
        self.shown: Callable[[], None] = lambda: None
        """Called for each frame."""
        self.playing = True
        """False: episodes begin, which nobody sees."""
        self.time = 0.0
        self._wanted, self._rise = 0.0, np.zeros(2)
        self._zero, self._next = time.monotonic(), 0.0

    def fill(self, robots: int) -> None:
        """Let so many robots stand here."""
        first = self.bodies[0]
        more = (Body(first.model, first.rest) for _ in range(robots - len(self.bodies)))
        self.bodies = [*self.bodies, *more][:robots]

    def advance(self, *rows: Float[np.ndarray, "robots _"]) -> list[np.ndarray]:
        """Move every robot by a time step, as `Body.advance` does; those whose episode has ended rest."""
        if self.hands.slope != self._wanted:
            self._wanted = self.hands.slope
            self._rise = np.tan(np.radians(self._wanted)) * self.bodies[0].turn @ self.bodies[0].ahead
        moved = []
        for body, *state in zip(self.bodies, *rows, strict=True):
            resting = *state[:3], body.data.sensordata
            moved.append(resting if body.ended is not None else body.advance(self.hands, self._rise, *state))
        self.wait(self.bodies[0].model.opt.timestep)
        return [np.stack(each) for each in zip(*moved, strict=True)]

    def wait(self, seconds: float) -> None:
        """Wait until the robots' moment so many seconds later has come, and show it where a frame is due."""
        self.time += seconds
        self._zero += seconds * (1.0 / self.hands.pace - 1.0)
        ahead = self.time - (time.monotonic() - self._zero)
        if ahead < -LATEST_S:
            self._zero -= ahead
        if self.time >= self._next:
            self._next = max(self._next + FRAME_S, self.time)
            self.shown()
        if ahead > 1e-3:
            time.sleep(ahead)

    def level(self) -> None:
        """Let the ground be level until a slope is asked for anew."""
        self._wanted, self._rise = 0.0, np.zeros(2)


class LiveMujoco(Native):
    """Native MuJoCo for the robots of a `Stage`, in the order of a batch."""

    rest: ClassVar[int] = WARMSTART

    @property
    def stage(self) -> Stage:
        """Stage of the robots on this physics; cached by the model."""
        return _stage(self._team.base, self.rest)

    @staticmethod
    def host_call(function: Callable[..., Any], shapes: Any, *vectors: Any) -> Any:
        """Call the host once and in the program's order: it moves robots that are seen."""
        call = custom_vmap(lambda *vectors: io_callback(function, shapes, *vectors, ordered=True))

        @call.def_vmap
        def _(robots: int, batched: Any, *vectors: Any) -> Any:
            rows = [x if of_each else jnp.stack([x] * robots) for x, of_each in zip(vectors, batched, strict=True)]
            wider = [jax.ShapeDtypeStruct((robots, *shape.shape), shape.dtype) for shape in shapes]
            return LiveMujoco.host_call(function, wider, *rows), [True] * len(shapes)

        return call(*vectors)

    def _advance(self, sensed: bool, values: Any, *state: Any) -> tuple[np.ndarray, ...]:
        stage = self.stage
        if not stage.playing:
            return super()._advance(sensed, values, *state)
        for body, row in zip(stage.bodies, values, strict=True):
            self._team.tune(body.model, row)
        *moved, read = stage.advance(*state)
        return *moved, read[:, : read.shape[1] * sensed]


class LiveUnmodified(LiveMujoco, Unmodified):
    """The same for robots as their files have them."""

    rest: ClassVar[int] = REST


_stage = lru_cache(Stage)
