"""Functions of small arrays as programs of single numbers, for XLA.

XLA makes a loop of each operation on small arrays, and multiplies by the zeros in them. Of numbers it makes few loops
over all worlds.
"""

from collections.abc import Callable
from functools import wraps
from typing import Any, TypeVar

import jax
import jax.numpy as jnp
import numpy as np
from jax.core import Tracer

from humanoid_mjx.kernels import fallback
from humanoid_mjx.kernels.arrangements import arranged
from humanoid_mjx.kernels.threads import Threads

Function = TypeVar("Function", bound=Callable[..., Any])


def scalarised(function: Function) -> Function:
    """Return the function of the same values whose program is of single numbers; known 0 and 1 fold away.

    The function takes and returns pytrees of arrays; `docs/kernels.md` says what it may do. It may be mapped and
    differentiated, in any precision. Arguments that jax does not trace are known numbers.
    """

    @wraps(function)
    def written(*args: Any) -> Any:
        leaves, structure = jax.tree.flatten(args)
        places = [place for place, leaf in enumerate(leaves) if isinstance(leaf, Tracer)]
        if not places:
            return function(*args)

        def of_traced(*traced: Any) -> Any:
            every = dict(enumerate(leaves)) | dict(zip(places, traced, strict=True))
            return function(*structure.unflatten(every.values()))

        traced, shapes = jax.make_jaxpr(of_traced, return_shape=True)(*(leaves[place] for place in places))
        given = [arranged(jnp.unstack(leaves[place].reshape(-1)), leaves[place].shape) for place in places]
        try:
            found = Threads().evaluate(traced, given)
        except Exception as error:  # whatever it is, XLA does not need it
            fallback.warn(error)
            return function(*args)
        arrays = [jnp.stack([*map(jnp.asarray, np.asarray(array).flat)]).reshape(array.shape) for array in found]
        return jax.tree.unflatten(jax.tree.structure(shapes), arrays)

    return written  # pyright: ignore[reportReturnType]
