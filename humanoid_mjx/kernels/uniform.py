"""Values of a traced function that are uniform: the same in all worlds of a kernel."""

from collections.abc import Sequence
from typing import Any

from jax.extend.core import Literal

from humanoid_mjx.kernels.primitives import CALLS


def uniform_results(jaxpr: Any, given: Sequence[bool], of_one: bool = False) -> list[bool]:
    """Return which results of a traced function are uniform; `given`: which arguments are. `of_one`: the function is of
    one world, and its reductions are over a world's own numbers."""
    known = dict.fromkeys(jaxpr.constvars, True) | dict(zip(jaxpr.invars, given, strict=True))

    def uniform(x: Any) -> bool:
        return isinstance(x, Literal) or known[x]

    for eqn in jaxpr.eqns:
        name, params, flags = eqn.primitive.name, eqn.params, [uniform(x) for x in eqn.invars]
        if name in CALLS:
            found = uniform_results(params[CALLS[name]].jaxpr, flags, of_one)
        elif name == "while":
            found = uniform_carry(eqn, flags, of_one)
        elif name == "cond":
            each = (uniform_results(branch.jaxpr, flags[1:], of_one) for branch in params["branches"])
            found = [flags[0] and all(same) for same in zip(*each, strict=True)]
        else:
            of_all = name == "reduce_or" and not of_one
            found = [of_all or (name != "read_words" and all(flags))] * len(eqn.outvars)
        known |= zip(eqn.outvars, found, strict=True)
    return [uniform(x) for x in jaxpr.outvars]


def uniform_carry(eqn: Any, given: Sequence[bool], of_one: bool = False) -> list[bool]:
    """Return which values that a loop carries stay uniform; `given`: which arguments of the loop are."""
    params = eqn.params
    first, last = params["cond_nconsts"], params["cond_nconsts"] + params["body_nconsts"]
    carry = list(given[last:])
    while True:
        found = uniform_results(params["body_jaxpr"].jaxpr, [*given[first:last], *carry], of_one)
        both = [one and two for one, two in zip(carry, found, strict=True)]
        if both == carry:
            return carry
        carry = both
