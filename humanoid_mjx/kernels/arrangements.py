"""Operations of a traced function that move the elements of arrays and make none."""

from collections.abc import Callable, Sequence
from typing import Any

import numpy as np


def arranged(elements: Sequence[Any], shape: tuple[int, ...]) -> np.ndarray:
    """A numpy array of elements."""
    found = np.empty(len(elements), object)
    for place, element in enumerate(elements):
        found[place] = element
    return found.reshape(shape)


def constant(value: Any) -> np.ndarray:
    """An array of numbers as one of elements."""
    value = np.asarray(value)
    return arranged(list(value.reshape(-1)), value.shape)


def _broadcast_in_dim(params: dict[str, Any], array: np.ndarray) -> list[np.ndarray]:
    shape, places = params["shape"], params["broadcast_dimensions"]
    new = [axis for axis in range(len(shape)) if axis not in places]
    return [np.broadcast_to(np.expand_dims(array, new), shape)]


def _slice(params: dict[str, Any], array: np.ndarray) -> list[np.ndarray]:
    """Slice the first axes; random keys have one more, of their words."""
    steps = params["strides"] or [1] * len(params["start_indices"])
    places = zip(params["start_indices"], params["limit_indices"], steps, strict=True)
    return [array[tuple(slice(*place) for place in places)]]


def _place(array: np.ndarray, sizes: Sequence[int], starts: Sequence[np.ndarray]) -> tuple[slice, ...]:
    """The place in an array of a part of these sizes; starts beyond the ends are clamped, as jax does."""
    if not all(isinstance(start.item(), np.generic) for start in starts):
        raise NotImplementedError("threads index only by what is known while tracing")
    limits = [full - size for full, size in zip(array.shape, sizes, strict=True)]
    firsts = [min(max(int(start.item()), 0), limit) for start, limit in zip(starts, limits, strict=True)]
    return tuple(slice(first, first + size) for first, size in zip(firsts, sizes, strict=True))


def _dynamic_update_slice(
    params: dict[str, Any], array: np.ndarray, part: np.ndarray, *starts: np.ndarray
) -> list[np.ndarray]:
    found = array.copy()
    found[_place(array, part.shape, starts)] = part
    return [found]


def _iota(params: dict[str, Any]) -> list[np.ndarray]:
    shape, axis = params["shape"], params["dimension"]
    along = np.arange(shape[axis], dtype=params["dtype"]).reshape([-1 if i == axis else 1 for i in range(len(shape))])
    return [constant(np.broadcast_to(along, shape))]


def _unstack(params: dict[str, Any], array: np.ndarray) -> list[np.ndarray]:
    rows = np.moveaxis(array, params["axis"], 0)
    return [rows[row, ...] for row in range(len(rows))]


ARRANGEMENTS: dict[str, Callable[..., list[np.ndarray]]] = {
    "broadcast_in_dim": _broadcast_in_dim,
    "concatenate": lambda params, *arrays: [np.concatenate(arrays, axis=params["dimension"])],
    "copy": lambda params, array: [array],
    "dynamic_slice": lambda params, array, *starts: [array[_place(array, params["slice_sizes"], starts)]],
    "dynamic_update_slice": _dynamic_update_slice,
    "iota": _iota,
    "reshape": lambda params, array: [array.reshape(params["new_sizes"])],
    "slice": _slice,
    "split": lambda params, array: np.split(array, np.cumsum(params["sizes"])[:-1], axis=params["axis"]),
    "squeeze": lambda params, array: [array.squeeze(tuple(params["dimensions"]))],
    "stack": lambda params, *arrays: [np.stack(arrays, axis=params["axis"])],
    "transpose": lambda params, array: [array.transpose(params["permutation"])],
    "unstack": _unstack,
}
"""By primitive: from its parameters and arrays of elements to those that it gives."""
