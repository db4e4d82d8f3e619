"""Axes of a sweep: expand the axes of a config to the values of each point."""

import math
from collections.abc import Iterable
from itertools import product
from typing import Any, Literal

import numpy as np
import pydantic

from humanoid_mjx.spec import LARGEST, InputError, shown

MAX_POINTS = 100_000
"""Largest number of points of a sweep. Each point is checked, which takes time and kilobytes of memory."""

Axis = list | dict[str, list]


HALVING = {"eta": 3, "rungs": 4}
"""Keys of mode halving, and their defaults."""


class Sweep(pydantic.BaseModel):
    """Axes of a sweep. `mode` makes points of them: all combinations (grid), row by row (zip), or random draws.

    Mode halving takes random draws where `points` says how many, else all combinations. They train with a small budget,
    and the best of them again with a greater one (`training.plan.Rung`).
    """

    model_config = pydantic.ConfigDict(frozen=True, extra="forbid", strict=True, allow_inf_nan=False)

    mode: Literal["grid", "zip", "random", "halving"] = "grid"
    points: int | None = pydantic.Field(None, ge=1, le=MAX_POINTS, description="draws, in mode random or halving")
    eta: int | None = pydantic.Field(None, ge=2, le=100, description="1 of eta points goes on, in mode halving")
    rungs: int | None = pydantic.Field(None, ge=2, le=20, description="trainings of the best, in mode halving")
    axes: dict[str, Axis] = pydantic.Field(min_length=1)

    @pydantic.model_validator(mode="before")
    @classmethod
    def _halving_has_defaults(cls, data: Any) -> Any:
        return HALVING | data if isinstance(data, dict) and data.get("mode") == "halving" else data

    @pydantic.model_validator(mode="after")
    def _keys_belong_to_their_mode(self) -> "Sweep":
        if self.mode != "halving" and (self.mode == "random") != (self.points is not None):
            raise ValueError("points is required in mode random and has no meaning in the modes grid and zip")
        if odd := [key for key in HALVING if (self.mode == "halving") != (getattr(self, key) is not None)]:
            raise ValueError(f"{odd[0]} belongs to mode halving and has no meaning in the others")
        return self

    @property
    def factors(self) -> list[int]:
        """By rung the divisor of the number of points; in reverse that of the budget."""
        return [(self.eta or 1) ** rung for rung in range(self.rungs or 1)]


def sweep_points(sweep: Sweep, seed: int) -> list[dict[str, Any]]:
    """Return the values of the swept keys at each point, by dotted name. Random draws depend on `seed`.

    Raises:
      InputError: an axis that is empty or unusable, one with a value twice in mode grid, axes of unequal length in mode
        zip.
    """
    combined = sweep.mode in ("grid", "halving") and sweep.points is None
    if sweep.points:
        rng = np.random.default_rng(seed)
        columns = [_draw(rng, name, axis, sweep.points) for name, axis in sweep.axes.items()]
    else:
        columns = [axis_values(name, axis) for name, axis in sweep.axes.items()]
    lengths = [len(column) for column in columns]
    for name, column in zip(sweep.axes, columns, strict=True):
        if combined and len({(isinstance(value, bool), value) for value in column}) < len(column):
            twice = next(value for place, value in enumerate(column) if value in column[:place])
            raise InputError(f"sweep.axes.{name}: the axis holds {twice!r} twice.")
    if sweep.mode == "zip" and len(set(lengths)) != 1:
        pairs = ", ".join(f"{name}: {length}" for name, length in zip(sweep.axes, lengths, strict=True))
        raise InputError(f"sweep.axes must be equally long in mode zip, got {pairs}.")
    if combined and math.prod(lengths) > MAX_POINTS:
        instead = "draw some of them: mode: random with points: 200"
        raise InputError(f"sweep.axes: {math.prod(lengths):,} points are more than {MAX_POINTS:,}; {instead}.")
    rows: Iterable[tuple] = product(*columns) if combined else zip(*columns, strict=True)
    return [dict(zip(sweep.axes, row, strict=True)) for row in rows]


def axis_values(name: str, axis: Axis) -> list:
    """Return the values of one axis of a grid or zip: a list, `{linspace: [first, last, count]}` or `{logspace: ...}`.

    Raises:
      InputError: an empty list, another form, or ends and counts that make no axis.
    """
    if isinstance(axis, list):
        if not axis:
            raise InputError(f"sweep.axes.{name}: the list is empty.")
        if odd := [v for v in axis if isinstance(v, (dict, list)) or v is None]:
            raise InputError(f"sweep.axes.{name}: a list of values cannot hold {shown(odd[0])}.")
        return axis
    kind, (low, high, count) = _entries(name, axis, ("linspace", "logspace"), 3)
    if not isinstance(count, int) or not 1 <= count <= MAX_POINTS:
        raise InputError(
            f"sweep.axes.{name}: the third entry is the number of values, from 1 to {MAX_POINTS:,}, got {shown(count)}."
        )
    if kind == "logspace" and not (low > 0 and high > 0):
        raise InputError(f"sweep.axes.{name}: logspace needs ends above 0, got {shown(low)} and {shown(high)}.")
    values = (np.linspace if kind == "linspace" else np.geomspace)(low, high, count)
    whole = np.isclose(values, np.rint(values), rtol=1e-12, atol=0) & isinstance(low, int) & isinstance(high, int)
    return [round(v) if is_whole else v for v, is_whole in zip(values.tolist(), whole, strict=True)]  # keys of integers


def _draw(rng: np.random.Generator, name: str, axis: Axis, count: int) -> list:
    """Draw values of one axis: from a list, `{uniform: [low, high]}`, `{loguniform: ...}` or `{integers: ...}`."""
    if isinstance(axis, list):
        values = axis_values(name, axis)
        return [values[i] for i in rng.integers(len(values), size=count)]
    kind, (low, high) = _entries(name, axis, ("uniform", "loguniform", "integers"), 2)
    if low > high or (kind == "loguniform" and low <= 0):
        got = shown(axis)
        raise InputError(f"sweep.axes.{name}: low must not exceed high, and loguniform needs low above 0, got {got}.")
    if kind == "integers":
        if not all(isinstance(end, int) and abs(end) < 2**31 for end in (low, high)):
            raise InputError(f"sweep.axes.{name}: the ends of integers must be whole numbers, got {shown(axis)}.")
        return [int(v) for v in rng.integers(low, high, size=count, endpoint=True)]
    if kind == "loguniform":
        return [float(v) for v in np.exp(rng.uniform(np.log(low), np.log(high), count))]
    return [float(v) for v in rng.uniform(low, high, count)]


def _entries(name: str, axis: dict[str, list], kinds: tuple[str, ...], size: int) -> tuple[str, list]:
    if len(axis) != 1 or (kind := next(iter(axis))) not in kinds:
        forms = ", ".join(f"{{{kind}: [...]}}" for kind in kinds)
        raise InputError(f"sweep.axes.{name}: write a list of values or one of {forms}, got {shown(axis)}.")
    numbers = [v for v in axis[kind] if isinstance(v, (int, float)) and not isinstance(v, bool)]
    if len(axis[kind]) != size or len(numbers) != size or not all(abs(v) <= LARGEST for v in numbers):
        raise InputError(f"sweep.axes.{name}: {kind} takes {size} finite numbers, got {shown(axis[kind])}.")
    return kind, numbers
