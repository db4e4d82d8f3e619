# pyright: reportAttributeAccessIssue=false
"""Sums of a kernel in another order have the same value, and take fewer instructions."""

import operator
from collections.abc import Callable
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from jax.extend.core import JaxprEqn, Literal

from humanoid_mjx.kernels.sums import with_fused_sums

OPERATIONS = {"add": np.add, "mul": np.multiply, "sub": np.subtract}


def traced(function: Callable[..., Any], count: int) -> Any:
    return jax.make_jaxpr(function)(*(jax.ShapeDtypeStruct((3,), jnp.float32),) * count).jaxpr


def evaluate(jaxpr: Any, equations: list[JaxprEqn], args: Any) -> list[Any]:
    values: dict[Any, Any] = dict(zip(jaxpr.invars, args, strict=True))

    def value(x: Any) -> Any:
        return x.val if isinstance(x, Literal) else values[x]

    for eqn in equations:
        values[eqn.outvars[0]] = OPERATIONS[eqn.primitive.name](*map(value, eqn.invars))
    return [value(x) for x in jaxpr.outvars]


def instructions(jaxpr: Any, equations: list[JaxprEqn]) -> int:
    """Those of a GPU, on which a sum with a product that nothing else uses is one."""
    used = [x for eqn in equations for x in eqn.invars] + jaxpr.outvars
    products = {eqn.outvars[0] for eqn in equations if eqn.primitive.name == "mul" and used.count(eqn.outvars[0]) == 1}
    sums = [eqn for eqn in equations if eqn.primitive.name in ("add", "sub")]
    return len(equations) - sum(any(x in products for x in eqn.invars if not isinstance(x, Literal)) for eqn in sums)


@pytest.mark.parametrize(
    ("function", "fewest"),
    [
        (lambda a, b, c, d, e: a + (b * c + d * e), 2),
        (lambda a, b, c, d, e: a - (b * c - d * e), 2),
        (lambda a, b, c, d, e: b * c - (d * e + a), 2),
        (lambda a, b, c, d, e: (a + b) + (c - (d + e)), 4),  # nothing to gain
        (lambda a, b, c, d, e: (a * b + c * d) + (b * d - a * e), 4),
        (lambda a, b, c, d, e: (s := b * c + d * e) * s + (a + s), 4),  # a sum that is used twice stays
        (lambda a, b, c, d, e: ((p := a * b) + c * d) + p * e, 3),
    ],
)
def test_products_are_added_to_something(function: Callable[..., Any], fewest: int) -> None:
    jaxpr = traced(function, 5)
    equations = with_fused_sums(jaxpr)
    assert instructions(jaxpr, equations) == fewest
    args = np.random.default_rng(0).normal(size=(5, 3))
    np.testing.assert_allclose(evaluate(jaxpr, equations, args)[0], function(*args), rtol=1e-12, atol=1e-12)


@pytest.mark.parametrize("seed", range(20))
def test_random_sums(seed: int) -> None:
    rng = np.random.default_rng(seed)

    def function(*args: Any) -> Any:
        shared = args[0] * args[1] + args[2]

        def expression(depth: int) -> Any:
            if not depth:
                return [*args, shared][rng.integers(5)]
            one, two = (expression(depth - 1 - rng.integers(min(depth, 2))) for _ in range(2))
            return [operator.add, operator.sub, operator.mul][rng.integers(3)](one, two)

        return expression(10), expression(10)

    jaxpr = traced(function, 4)
    equations, args = with_fused_sums(jaxpr), rng.uniform(-1.0, 1.0, (4, 3))
    assert instructions(jaxpr, equations) < instructions(jaxpr, jaxpr.eqns)
    for found, exact in zip(evaluate(jaxpr, equations, args), evaluate(jaxpr, jaxpr.eqns, args), strict=True):
        np.testing.assert_allclose(found, exact, rtol=1e-9, atol=1e-9)


def test_integers_keep_their_order() -> None:
    jaxpr = jax.make_jaxpr(lambda a, b: a + (b * a + b * b))(1, 2).jaxpr
    assert with_fused_sums(jaxpr) == jaxpr.eqns
