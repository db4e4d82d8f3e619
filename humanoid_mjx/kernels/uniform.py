"""Values of a traced function that are uniform: the same in all worlds of a kernel."""

from collections.abc import Sequence
from typing import Any

from jax.extend.core import ClosedJaxpr

from humanoid_mjx.kernels.primitives import CALLS, evaluated


def uniform_results(closed: ClosedJaxpr, given: Sequence[bool], of_one: bool = False) -> list[bool]:
    """Return which results of a traced function are uniform; `given`: which arguments are. `of_one`: the function is of
    one world, and its reductions are over a world's own numbers."""

    def uniform(eqn: Any, flags: list[bool]) -> Sequence[bool]:
        name, params = eqn.primitive.name, eqn.params
        if name in CALLS:
            return uniform_results(params[CALLS[name]], flags, of_one)
        if name == "while":
            return uniform_carry(eqn, flags, of_one)
        if name == "cond":
            each = (uniform_results(branch, flags[1:], of_one) for branch in params["branches"])
            return [flags[0] and all(same) for same in zip(*each, strict=True)]
        of_all = name == "reduce_or" and not of_one
        own = name == "read_words" and not isinstance(params["region"], tuple)  # those are words of all worlds
        return [of_all or (not own and all(flags))] * len(eqn.outvars)

    return evaluated(closed, given, lambda _: True, uniform)


def uniform_carry(eqn: Any, given: Sequence[bool], of_one: bool = False) -> list[bool]:
    """Return which values that a loop carries stay uniform; `given`: which arguments of the loop are."""
    params = eqn.params
    first, last = params["cond_nconsts"], params["cond_nconsts"] + params["body_nconsts"]
    carry = list(given[last:])
    while True:
        found = uniform_results(params["body_jaxpr"], [*given[first:last], *carry], of_one)
        both = [one and two for one, two in zip(carry, found, strict=True)]
        if both == carry:
            return carry
        carry = both
